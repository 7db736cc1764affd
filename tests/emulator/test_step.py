"""`Emulator.step` as the first thing anybody calls: from Python, and inside jit, grad and vmap."""

from __future__ import annotations

import gc
import logging

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import Emulator, NeuroAnimatorError, load_emulator, set_backend
from neuroanimator.emulator import compiled
from neuroanimator.emulator.checks import MAX_MAGNITUDE
from neuroanimator.emulator.super_step import step as plain_step
from neuroanimator.errors import ArgumentError, DivergedError

SYSTEMS = ("fish", "lander", "pendulum", "truck")

STEPS = 30


@pytest.fixture(scope="module")
def emulators() -> dict[str, Emulator]:
    return {name: Emulator.load(name) for name in SYSTEMS}


def inputs(emulator: Emulator) -> tuple[np.ndarray, np.ndarray]:
    bounds = emulator.bounds
    return emulator.rest, bounds.middle + 0.3 * bounds.half


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_step_from_python_is_the_definition_and_the_same_inside_jit(
    emulators: dict[str, Emulator], name: str
):
    emulator = emulators[name]
    state, control = inputs(emulator)
    called = emulator.step(state, control)
    defined = eqx.filter_jit(plain_step)(
        emulator, jnp.asarray(state, jnp.float32), jnp.asarray(control, jnp.float32)
    )
    scale = np.abs(defined).max()
    np.testing.assert_allclose(called, defined, rtol=1e-5, atol=1e-5 * scale)
    np.testing.assert_allclose(
        jax.jit(emulator.step)(state, control), called, rtol=1e-6, atol=1e-6 * scale
    )
    assert isinstance(called, np.ndarray)
    assert isinstance(emulator.step(jnp.asarray(state), jnp.asarray(control)), jax.Array)
    # As precise as the state given: far away float32 would lose digits.
    assert called.dtype == np.float64
    assert emulator.step(np.float32(state), control).dtype == np.float32


def test_steps_after_the_first_compile_nothing(
    emulators: dict[str, Emulator], caplog: pytest.LogCaptureFixture
):
    emulator = emulators["truck"]
    state, control = inputs(emulator)
    emulator.step(state, control)
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        for _ in range(5):
            state = np.asarray(emulator.step(state, control))
        assert not caplog.records
        jax.jit(lambda x: x + 1)(state)
        assert caplog.records  # the log does say when something is compiled


def test_two_emulators_of_one_structure_share_a_program(caplog: pytest.LogCaptureFixture):
    first, second = Emulator.load("pendulum-50"), Emulator.load("pendulum-50")
    state, control = inputs(first)
    expected = first.step(state, control)
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(second.step(state, control), expected)
    assert not caplog.records


def test_the_gradient_of_a_step_equals_finite_differences(emulators: dict[str, Emulator]):
    emulator = emulators["pendulum"]
    state = jnp.array([0.3, -0.2, 0.1, 0.5, -0.4, 0.2])
    control, weights = jnp.array([3.0, -2.0, 1.0]), jnp.arange(1.0, 7.0)

    def cost(control):
        return weights @ emulator.step(state, control)

    slope = jax.grad(cost)(control)
    shift = 0.3
    differences = [
        (cost(control + shift * e) - cost(control - shift * e)) / (2 * shift) for e in jnp.eye(3)
    ]
    np.testing.assert_allclose(slope, differences, rtol=2e-2, atol=1e-3)


def test_an_emulator_first_used_inside_jit_can_be_used_elsewhere():
    emulator = Emulator.load("pendulum-50")
    state, control = inputs(emulator)
    first = jax.jit(emulator.step)(state, control)
    again = jax.jit(lambda state: emulator.step(state, control))(state)
    np.testing.assert_allclose(again, first, atol=1e-6)
    np.testing.assert_allclose(emulator.step(state, control), first, atol=1e-6)


def test_vmap_of_step_is_every_step(emulators: dict[str, Emulator]):
    emulator = emulators["lander"]
    state, control = inputs(emulator)
    states = jnp.asarray(state + np.array([0.0, 0.5, 1.0])[:, None] * np.eye(13)[2], jnp.float32)
    many = jax.vmap(emulator.step, (0, None))(states, jnp.asarray(control, jnp.float32))
    one_by_one = [emulator.step(each, control) for each in states]
    np.testing.assert_allclose(many, one_by_one, rtol=1e-4, atol=1e-5)


def test_a_step_of_a_traced_emulator_has_a_gradient_with_respect_to_its_weights(
    emulators: dict[str, Emulator],
):
    emulator = emulators["pendulum"]
    state, control = inputs(emulator)
    slope = jax.grad(lambda emulator: jnp.sum(emulator.step(state, control) ** 2))(emulator)
    assert float(jnp.abs(slope.normaliser.change_scale).max()) > 0


@pytest.mark.parametrize("name", ["pendulum", "truck"])
def test_a_rollout_is_the_same_inside_jit_and_has_a_gradient(
    emulators: dict[str, Emulator], name: str
):
    emulator = emulators[name]
    state, control = (np.asarray(part, np.float32) for part in inputs(emulator))
    controls = np.tile(control, (3, 1))
    called = emulator.rollout(state, controls)
    compiled = jax.jit(emulator.rollout)(state, controls)
    np.testing.assert_allclose(compiled, called, atol=1e-5 * np.abs(called).max())

    def height(scale: jax.Array) -> jax.Array:
        return jnp.sum(emulator.rollout(state, scale * controls)[-1])

    def stepped(scale: jax.Array) -> jax.Array:
        after = jnp.asarray(state)
        for held in controls:
            after = emulator.step(after, scale * held)
        return jnp.sum(after)

    slope = jax.jit(jax.grad(height))(1.0)
    assert slope != 0
    np.testing.assert_allclose(slope, jax.jit(jax.grad(stepped))(1.0), rtol=1e-3)


@pytest.mark.parametrize("shape", [(2,), (3, 99)], ids=["one control", "other size"])
def test_a_rollout_of_a_wrong_shape_is_refused_inside_jit_too(
    emulators: dict[str, Emulator], shape: tuple[int, ...]
):
    with pytest.raises(NeuroAnimatorError, match="state and controls: wanted"):
        jax.jit(emulators["pendulum"].rollout)(emulators["pendulum"].rest, np.zeros(shape))


@pytest.mark.parametrize(
    ("state", "control", "message"),
    [
        (np.zeros(5), np.zeros(3), "state: wanted 6 numbers, got shape (5,)"),
        (np.zeros((2, 6)), np.zeros((2, 3)), "jax.vmap(emulator.step)"),
        (jnp.zeros(6), jnp.zeros(4), "control: wanted 3 numbers, got shape (4,)"),
        (0.0, np.zeros(3), "state: wanted 6 numbers, got shape ()"),
        ([0, 0, 0, 0, 0, np.nan], np.zeros(3), "velocity[2] rad/s is not finite"),
    ],
)
def test_a_step_of_a_wrong_shape_says_what_was_wanted(
    emulators: dict[str, Emulator], state, control, message: str
):
    with pytest.raises(NeuroAnimatorError) as caught:
        emulators["pendulum"].step(state, control)
    assert message in str(caught.value)


def test_a_wrong_shape_is_said_inside_jit_too(emulators: dict[str, Emulator]):
    with pytest.raises(NeuroAnimatorError, match="wanted 6 numbers"):
        jax.jit(emulators["pendulum"].step)(jnp.zeros(7), jnp.zeros(3))


def test_an_emulator_that_is_gone_is_forgotten():
    emulator = Emulator.load("pendulum-25")
    emulator.step(*inputs(emulator))
    gc.collect()  # others that are gone
    known = len(compiled._taken_apart)
    del emulator
    gc.collect()
    assert len(compiled._taken_apart) == known - 1


@pytest.fixture(params=["c", "jax"])
def backend(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr("neuroanimator.codegen.backend._chosen", [])
    set_backend(request.param)
    return request.param


def starts_near_the_end(emulator: Emulator, count: int) -> np.ndarray:
    """Return states whose places or angles are at, or a little within, the largest that is accepted, and which move."""
    rng = np.random.default_rng(0)
    starts = np.repeat(emulator.rest[None], count, axis=0)
    movable = [0, 1] if emulator.frame.segments else [0, 1, 2]
    rates = dict(emulator.rates)
    first_velocity = next(i for i, name in enumerate(emulator.state.names) if "velocity" in name)
    for row, start in enumerate(starts):
        entry = movable[row % len(movable)]
        sign = rng.choice([-1, 1])
        start[entry] = sign * (MAX_MAGNITUDE - rng.choice([0, 0.0625, 0.5, 3]))
        rate = rates.get(entry, first_velocity)
        start[rate] += sign * rng.uniform(0, 3)
    return starts


@pytest.mark.parametrize("name", ["pendulum-50", "truck-50", "lander-50"])
def test_a_returned_state_is_accepted_by_the_next_call(name: str, backend: str):
    emulator = load_emulator(name)
    idle = np.repeat(emulator.bounds.idle[None], STEPS, axis=0)
    told = []
    for start in starts_near_the_end(emulator, 12):
        try:
            path = np.asarray(emulator.rollout(start, idle))
            scored, _ = emulator.rollout_trusted(start, idle)
            rows = np.asarray(emulator.rollout(start[None], idle[None]))[0]
            single = np.asarray(emulator.step(start, idle[0]))
        except (ArgumentError, DivergedError) as error:
            told.append(str(error))
            continue
        for states in (path, scored, rows, single[None]):
            assert (np.abs(states) <= MAX_MAGNITUDE).all()
        emulator.step(path[-1], idle[0])
    assert told
    assert all("beyond 1e+06" in error for error in told)
