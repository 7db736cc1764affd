"""Batches: what updates are made of."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator import Emulator
from neuroanimator.learn.training.batches import draw_first_steps, parts_of
from neuroanimator.learn.training.loss import calm_weights, squared_error

WINDOWS = 5
STEPS = 7


def test_parts_of_windows_are_some_of_their_super_steps_in_order_and_all_are_drawn():
    states = jnp.arange(WINDOWS * (STEPS + 1), dtype=jnp.float32).reshape(WINDOWS, STEPS + 1, 1)
    rows = jnp.arange(400) % WINDOWS
    for unroll in (1, 3, STEPS):
        first = draw_first_steps(jax.random.key(unroll), (1, len(rows)), STEPS, unroll)[0]
        parts, controls = parts_of(states, states[:, :-1], rows, first, unroll)
        assert np.all(np.diff(parts[..., 0], axis=1) == 1)
        assert np.all(parts[:, :-1] == controls)
        window, begun = np.divmod(np.asarray(parts[:, 0, 0]), STEPS + 1)
        assert np.all(window == rows)
        assert np.all(begun == first)
        assert set(begun) == set(range(STEPS - unroll + 1))


def test_errors_of_calm_windows_count_beside_what_happens_in_them(shipped: Emulator):
    rest = np.asarray(shipped.encode(shipped.rest[None].astype(float)))
    way = np.random.default_rng(0).normal(size=rest.shape)
    shares = np.array([0.0, 1e-4, 0.3, 1.0, 3.0])
    states = jnp.asarray(np.stack([rest + np.zeros_like(way), rest + way], axis=1), jnp.float32)
    windows = states[:, :1] + shares[:, None, None] * (states - states[:, :1])
    calm = 0.01
    weights = np.asarray(calm_weights(shipped, windows, calm))
    assert np.mean(weights) == np.float32(1)
    unit = np.asarray(shipped.normaliser.unit)
    change = np.asarray(shipped.frame.difference(windows[:, 1], windows[:, 0]))
    moved = np.mean((change / np.where(unit > 0, unit, np.inf)) ** 2, axis=1)
    np.testing.assert_allclose(weights * (calm + moved), weights[0] * calm, rtol=1e-4)
    assert weights[0] > 0.99 * weights[1] > weights[2] > weights[3] > weights[4]
    # What is all of the loss without them: the window that moves most.
    controls = jnp.zeros((len(shares), 1, shipped.control.size))
    one_by_one = [
        float(squared_error(shipped, windows[i : i + 1], controls[:1]).mean()) for i in range(5)
    ]
    together = float(squared_error(shipped, windows, controls, jnp.asarray(weights)).mean())
    np.testing.assert_allclose(together, np.mean(weights * one_by_one), rtol=1e-4)
