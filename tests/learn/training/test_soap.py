"""SOAP: its laws, and what it is for."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from neuroanimator import TrainingConfig
from neuroanimator.emulator.networks import make_network
from neuroanimator.learn.training.optimizer import make_optimizer
from neuroanimator.learn.training.soap import DECAY, REFRESH, scale_by_soap

SIZE = (12, 7)


def steps_of(
    optimizer: optax.GradientTransformation, gradients: list[Any]
) -> tuple[list[Any], Any]:
    """Return (the update for each of the `gradients`, the state after them)."""
    state = jax.jit(optimizer.init)(gradients[0])
    update = jax.jit(optimizer.update)
    steps = []
    for gradient in gradients:
        step, state = update(gradient, state)
        steps.append(step)
    return steps, state


def random_gradients(count: int, shape: tuple[int, ...]) -> list[Any]:
    rng = np.random.default_rng(0)
    return [jnp.asarray(rng.normal(size=shape), jnp.float32) for _ in range(count)]


def test_a_vector_has_adams_updates():
    gradients = random_gradients(3 * REFRESH, (9,))
    ours, _ = steps_of(scale_by_soap(), gradients)
    adams, _ = steps_of(optax.scale_by_adam(b1=DECAY, b2=DECAY), gradients)
    np.testing.assert_allclose(ours, adams, rtol=1e-5)


def test_bases_are_orthonormal_and_make_the_factors_more_diagonal():
    # The gradients of a matrix whose rows and columns are mixed, as features of a body are.
    rng = np.random.default_rng(1)
    rows, columns = (rng.normal(size=(size, size)) for size in SIZE)
    mixed = [jnp.asarray(rows @ g @ columns, jnp.float32) for g in random_gradients(300, SIZE)]
    _, state = steps_of(scale_by_soap(), mixed)
    for basis in state.moments[0].bases:
        vectors = np.asarray(basis.vectors)
        np.testing.assert_allclose(vectors.T @ vectors, np.eye(len(vectors)), rtol=0, atol=1e-5)
        factor = np.asarray(basis.factor)
        assert off_diagonal(vectors.T @ factor @ vectors) < 0.5 * off_diagonal(factor)


def off_diagonal(matrix: Any) -> float:
    """Return the norm of what is not on the diagonal."""
    return float(np.linalg.norm(matrix - np.diag(np.diag(matrix))))


def test_the_mean_gradient_survives_a_change_of_bases():
    gradients = random_gradients(2 * REFRESH + 1, SIZE)
    _, state = steps_of(scale_by_soap(), gradients)
    expected = np.zeros(SIZE)
    for gradient in gradients:
        expected = DECAY * expected + (1 - DECAY) * np.asarray(gradient)
    moments = state.moments[0]
    np.testing.assert_allclose(moments.without(moments.mean), expected, rtol=0, atol=1e-6)


def test_a_matrix_without_rows_is_left_alone():
    """Networks without a mirror have no even inputs, whose weights are a matrix without rows."""
    network: Any = make_network("classic", 12, 0, 6, (5,), jax.random.key(0))
    optimizer = make_optimizer(TrainingConfig(network="classic", widths=(5,)))
    steps, _ = steps_of(optimizer, [jax.tree.map(jnp.ones_like, network)] * 2)
    step = steps[-1]
    assert step.even_in.shape == (0, 5)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(step))
    assert np.abs(step.odd_in).max() > 0


def test_where_inputs_are_mixed_it_learns_faster_than_adam():
    """Least squares on minibatches whose inputs spread a hundred times further along some axes, which mix all weights."""
    rng = np.random.default_rng(2)
    axes = np.linalg.qr(rng.normal(size=(16, 16)))[0]
    inputs = jnp.asarray(rng.normal(size=(4096, 16)) * np.logspace(-2, 0, 16) @ axes, jnp.float32)
    truth = jnp.asarray(rng.normal(size=(16, 5)), jnp.float32)
    answers = inputs @ truth + 0.1 * jnp.asarray(rng.normal(size=(4096, 5)), jnp.float32)
    minibatches = jnp.asarray(rng.integers(0, 4096, (1000, 64)))

    def loss(weights: Any, rows: Any) -> Any:
        return jnp.mean((inputs[rows] @ weights - answers[rows]) ** 2)

    def excess_after(optimizer: optax.GradientTransformation) -> float:
        schedule = optax.cosine_decay_schedule(3e-2, len(minibatches))
        chain = optax.chain(optimizer, optax.scale_by_learning_rate(schedule))

        def update(carry: Any, rows: Any) -> Any:
            weights, state = carry
            step, state = chain.update(jax.grad(loss)(weights, rows), state)
            return (weights + step, state), None

        start = jnp.zeros((16, 5))
        (weights, _), _ = jax.lax.scan(update, (start, chain.init(start)), minibatches)
        return float(jnp.mean((inputs @ (weights - truth)) ** 2))

    adams = excess_after(optax.scale_by_adam(b1=DECAY, b2=DECAY))
    assert excess_after(scale_by_soap()) < 0.3 * adams
