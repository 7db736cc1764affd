"""Held controls: no emulator runs away under controls that stay, nor creeps away from rest."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator.emulator.departures import (
    departures_in_words,
    find_departures,
    held_controls,
)
from neuroanimator.emulator.emulator import Emulator, load_emulator
from neuroanimator.emulator.super_step import step
from neuroanimator.files.zoo import LARGE, SHIPPED, SOFT, emulator_name
from neuroanimator.state.layout import Bounds

NAMES = [
    *(emulator_name(system, substeps) for system, substeps in [*SHIPPED, *SOFT]),
    *(emulator_name(system, substeps, "large") for system, substeps in LARGE),
]

QUICK_STEPS = 1000
LONG_STEPS = 100_000


def test_all_that_ship_are_held():
    assert len(NAMES) == 30


@pytest.mark.parametrize("name", NAMES)
def test_no_shipped_emulator_leaves_training_while_controls_are_held(name: str):
    assert find_departures(load_emulator(name), QUICK_STEPS) == []


@pytest.mark.endurance
@pytest.mark.parametrize("name", NAMES)
def test_none_leaves_training_in_a_hundred_thousand_super_steps(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    """As users run it: in C where there is a compiler, which takes a fifth of the time of JAX."""
    monkeypatch.setenv("NEUROANIMATOR_BACKEND", "auto")
    assert find_departures(load_emulator(name), LONG_STEPS) == []


@pytest.mark.parametrize("size", [0, 1, 2, 6, 7, 12])
def test_held_controls_are_the_corners_and_at_last_idle(size: int):
    bounds = Bounds(low=(-1.0,) * size, high=(2.0,) * size)
    held = held_controls(bounds)
    np.testing.assert_array_equal(held[-1], bounds.idle)
    assert np.isin(held[:-1], [-1, 2, 0]).all()
    rows = {tuple(row) for row in held.tolist()}
    assert bounds.low in rows
    assert bounds.high in rows
    if size and size <= 6:
        assert len(rows) == 2**size + 1


def pushed(emulator: Emulator, entry: int, size: float) -> Emulator:
    """Return an emulator whose change of number `entry` is too large by `size` in every super step."""
    mean = jnp.asarray(emulator.normaliser.change_mean).at[entry].add(size)
    return replace(emulator, normaliser=replace(emulator.normaliser, change_mean=mean))


def test_an_emulator_that_does_not_keep_still_is_told():
    base = load_emulator("truck-50")
    unit = np.asarray(base.normaliser.unit)
    wheel = int(np.argmax(unit))
    creeping = pushed(base, wheel, 9e-4 * unit[wheel])
    found = find_departures(creeping, 2000)
    assert "the state of rest" in [departure.quantity for departure in found]
    assert "leaves training after" in departures_in_words(found)


@pytest.mark.parametrize("name", ["truck-50", "lander-50"])
def test_a_root_from_outside_comes_back_without_a_jump(name: str):
    emulator = load_emulator(name)
    velocity = [i for i, told in enumerate(emulator.state.names) if "root.velocity" in told]
    max_speed = float(np.asarray(emulator.max_speed()))
    start = emulator.rest
    start[velocity[0]] = 3 * max_speed
    idle = np.repeat(emulator.bounds.idle[None], 100, axis=0)
    path = emulator.rollout(start, idle)
    speeds = np.linalg.norm(path[:, velocity], axis=1)
    assert speeds[1] > 2 * max_speed
    assert (speeds[1:20] < speeds[:19]).all()
    assert speeds[-1] < 1.3 * max_speed


@pytest.mark.parametrize("name", ["truck-50", "lander-50"])
def test_gradients_stay_finite_where_bounds_act(name: str):
    emulator = load_emulator(name)
    state = jnp.asarray(emulator.rest, jnp.float32)
    velocity = [i for i, told in enumerate(emulator.state.names) if "root.velocity" in told]
    fast = state.at[jnp.asarray(velocity)].set(100.0)
    tilted = state.at[3:7].set(jnp.asarray([0.5, 0.5, 0.5, 0.5]))
    idle = jnp.asarray(emulator.bounds.idle, jnp.float32)
    slope = jax.jit(jax.jacrev(lambda state: step(emulator, state, idle)))
    for begin in (state, fast, tilted):
        assert np.isfinite(np.asarray(slope(begin))).all()


@pytest.mark.parametrize("name", ["truck-50", "lander-50", "pendulum-50"])
def test_bounds_change_nothing_within_training(name: str):
    emulator = load_emulator(name)
    rest = jnp.asarray(emulator.rest, jnp.float32)
    rng = np.random.default_rng(0)
    controls = rng.uniform(-1, 1, (20, emulator.control.size)) * emulator.bounds.half
    controls = jnp.asarray(controls + emulator.bounds.middle, jnp.float32)
    latent = rest
    make_step = jax.jit(type(emulator).step_latent)
    make_free = jax.jit(type(emulator).step_latent_unbounded)
    for control in controls:
        features = np.asarray(emulator.raw_features(latent, control))
        following = make_step(emulator, latent, control)
        free = make_free(emulator, latent, control)
        after = np.asarray(emulator.raw_features(free, control))
        low, high = emulator.domain.low, emulator.domain.high
        if ((after >= low) & (after <= high) & (features >= low) & (features <= high)).all():
            np.testing.assert_array_equal(np.asarray(following), np.asarray(free))
        latent = following
