"""A body that settles must settle: rest stays rest, and what an emulator knows is said."""

from __future__ import annotations

import numpy as np
import pytest

from neuroanimator import Emulator, load_emulator, load_system
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.sampling import with_idle_runs
from neuroanimator.state.layout import Bounds
from neuroanimator.systems.random_controls import sample_control_runs

SECONDS = 60.0
STILL = 1e-3
"""[m, rad, m/s or rad/s] A body at rest keeps its place to a millimetre in a minute."""
RADIUS = 0.338
"""Of the truck's wheels [m]: their place is that of the rim."""
RESTING = ("dolphin-50", "fish-50", "lander-50", "pendulum-50", "truck-50")
OF_OTHER_STEPS = ("dolphin-100", "fish-100", "lander-25", "lander-100")


def emulator_called(name: str) -> Emulator:
    return load_emulator(name)


def idle(emulator: Emulator, seconds: float = SECONDS) -> np.ndarray:
    return np.tile(emulator.bounds.idle, (round(seconds / emulator.dt), 1))


@pytest.mark.parametrize("name", ["cube", "dolphin", "fish", "lander", "pendulum", "truck"])
def test_the_physics_stays_at_rest(name: str):
    system = load_system(name)
    dt = 50 * system.physics_dt
    controls = np.tile(system.bounds.idle, (1, round(10 / dt), 1))
    states = system.simulate(system.rest[None], controls, dt, scheme=system.scheme).states[0]
    assert np.abs(states - states[0]).max() < 1e-4


@pytest.mark.parametrize(
    "name",
    [*RESTING, *(pytest.param(name, marks=pytest.mark.endurance) for name in OF_OTHER_STEPS)],
)
def test_an_emulated_body_stays_at_rest(name: str):
    emulator = emulator_called(name)
    states = np.asarray(emulator.rollout(emulator.rest, idle(emulator)), float)
    is_wheel = [
        entry.startswith("wheel_") and "rad/s" not in entry for entry in emulator.state.names
    ]
    lengths = np.where(is_wheel, RADIUS, 1.0)
    assert (lengths * np.abs(states[1:] - states[1])).max() < STILL
    start = (
        states[1] - states[0]
    )  # shapes that an emulator of few numbers cannot tell apart may differ at first
    assert np.abs(start).max() < 5e-3 * max(1.0, np.abs(states).max())


@pytest.mark.parametrize("name", ["lander-50", "truck-50"])
def test_a_body_that_was_driven_comes_to_rest(name: str):
    emulator = emulator_called(name)
    system = load_system(emulator.system)
    driven = round(2 / emulator.dt)
    controls = np.tile(idle(emulator), (8, 1, 1))
    controls[:, :driven] = sample_control_runs(
        np.random.default_rng(0), 8, driven, emulator.dt, system
    )
    starts = np.tile(emulator.rest, (8, 1))
    states = np.asarray(emulator.rollout(starts, controls), float)
    last = states[:, -round(10 / emulator.dt) :, :3]
    assert np.linalg.norm(last[:, -1] - last[:, 0], axis=-1).max() < 0.02


def test_a_body_that_crashes_stays_on_the_ground():
    emulator = emulator_called("lander-50")
    rng = np.random.default_rng(0)
    starts = np.tile(emulator.rest, (64, 1))
    starts[:, 2] = rng.uniform(5, 20, 64)
    starts[:, 4:7] = rng.normal(0, 0.15, (64, 3))
    starts[:, 3:7] /= np.linalg.norm(starts[:, 3:7], axis=1, keepdims=True)
    falling = emulator.state.index("root.velocity").start + 2
    starts[:, falling] = -rng.uniform(10, 20, 64)
    controls = np.tile(idle(emulator), (64, 60, 1))
    states = np.asarray(emulator.rollout(starts, controls), float)
    resting = emulator.rest[2]
    assert states[:, :, 2].min() > resting - 0.3
    assert np.median(np.abs(states[:, -1, 2] - resting)) < 0.02


def test_some_runs_cease_to_be_controlled():
    bounds = Bounds((1.0, -2.0), (3.0, 2.0))
    controls = np.full((1000, 40, 2), 2.0)
    found = with_idle_runs(np.random.default_rng(0), controls, bounds, 0.25)
    is_idle = (found == bounds.idle).all(axis=2)
    assert np.array_equal(bounds.idle, [1.0, 0.0])
    assert 0.2 < is_idle.any(axis=1).mean() < 0.3
    assert np.array_equal(np.sort(is_idle, axis=1), is_idle)
    assert np.array_equal(with_idle_runs(np.random.default_rng(0), controls, bounds, 0.0), controls)


@pytest.mark.parametrize("name", ["fish-50", "lander-50"])
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e300])
def test_what_is_not_finite_or_huge_is_covered_nowhere_and_refused_by_name(name: str, wrong: float):
    emulator = emulator_called(name)
    rest = emulator.rest
    control = emulator.bounds.idle
    assert emulator.covers(rest, control)
    for entry in range(len(rest)):
        state = rest.copy()
        state[entry] = wrong
        assert not emulator.covers(state, control)
    named = emulator.state.names[len(rest) - 1]
    with pytest.raises(ArgumentError) as caught:
        emulator.rollout(state, control[None])
    assert named in str(caught.value)
    control = control.copy()
    control[0] = wrong
    assert not emulator.covers(rest, control)


def test_controls_are_covered_up_to_their_own_bounds_and_no_further():
    emulator = emulator_called("lander-50")
    rest = emulator.rest
    bounds = emulator.bounds
    assert emulator.covers(rest, np.array(bounds.low))
    assert emulator.covers(rest, np.array(bounds.high))
    assert not emulator.covers(rest, np.array(bounds.high) * 1.01)


def test_a_state_no_motion_follows_from_is_refused():
    emulator = emulator_called("fish-50")
    control = emulator.bounds.idle[None]
    with pytest.raises(ArgumentError, match="after one super step from it"):
        emulator.rollout(np.zeros(emulator.state.size), control)


@pytest.mark.parametrize("name", ["fish-50", "pendulum-50"])
def test_no_controls_leave_the_start_alone(name: str):
    emulator = emulator_called(name)
    rest = emulator.rest
    assert np.array_equal(emulator.rollout(rest, np.zeros((0, emulator.control.size))), rest[None])


def test_what_a_network_sees_stays_within_the_range_of_training():
    emulator = emulator_called("truck-50")
    seen = emulator.features.plain
    low, high = (np.asarray(end) for end in emulator.domain.widened(0.1, slice(len(seen))))
    state = emulator.rest
    state[2] += 5.0  # five metres over the ground
    after = np.asarray(emulator.rollout(state, emulator.bounds.idle[None]))[-1]
    assert ((after[list(seen)] >= low - 1e-5) & (after[list(seen)] <= high + 1e-5)).all()
