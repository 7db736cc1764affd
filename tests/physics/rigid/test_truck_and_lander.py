"""Truck and lander obey the laws of their physics."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import load_system
from neuroanimator.control.objective.goals import goal_state, is_reached
from neuroanimator.learn.training.batches import turned_windows
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.rotation import heading_of, upward
from neuroanimator.systems.system import System


def drive(
    system: System, control: list[float], seconds: float, start: np.ndarray | None = None
) -> np.ndarray:
    """Return the trajectory under a constant control, from rest if no start is given."""
    controls = np.tile(control, (1, round(seconds / 0.1), 1))
    runs = system.simulate((system.rest if start is None else start)[None], controls, 0.1)
    assert not runs.has_diverged.any()
    return runs.states[0]


@pytest.mark.parametrize("name", ["truck", "lander"])
def test_what_rests_stays_at_rest(name: str):
    system = load_system(name)
    path = drive(system, [0.0] * system.control.size, 2.0)
    assert np.abs(path - system.rest).max() < 1e-3


def test_the_truck_drives_forward_and_back_and_steers_to_the_left():
    truck = load_system("truck")
    velocity = truck.state.index("root.velocity")
    ahead, back = drive(truck, [2500, 0], 2.0)[-1], drive(truck, [-2500, 0], 2.0)[-1]
    assert ahead[0] > 3
    assert back[0] < -3
    assert ahead[velocity][0] == pytest.approx(-back[velocity][0], rel=0.1)
    left, right = (drive(truck, [1000, angle], 3.0)[-1] for angle in (0.4, -0.4))
    assert heading_of(left[3:7]) > 0.3
    assert heading_of(left[3:7]) == pytest.approx(-heading_of(right[3:7]), abs=0.02)


def test_the_truck_keeps_its_wheels_on_the_ground_at_full_speed_and_lock():
    truck = load_system("truck")
    fast = drive(truck, [2500, 0], 8.0)[-1]
    path = drive(truck, [2500, 0.6], 4.0, fast)
    assert upward(path[:, 3:7])[:, 2].min() > np.cos(np.deg2rad(8))


def test_a_rolling_truck_loses_energy_and_comes_to_rest():
    truck = load_system("truck")
    fast = drive(truck, [2500, 0], 4.0)[-1]
    velocities = np.abs(
        drive(truck, [0, 0], 20.0, fast)[:, truck.state.index("root.velocity")][:, 0]
    )
    assert (np.diff(velocities) < 1e-3).all()
    assert velocities[-1] < 0.01


def test_the_lander_falls_as_everything_falls_on_the_moon():
    lander = load_system("lander")
    start = lander.rest.copy()
    start[2] += 50
    path = drive(lander, [0, 0, 0, 0], 3.0, start)
    np.testing.assert_allclose(
        path[:, 2] - start[2], -0.5 * 1.62 * (np.arange(31) * 0.1) ** 2, atol=0.01
    )


def test_the_main_engine_holds_the_lander_and_jets_turn_it_about_their_own_axis():
    lander = load_system("lander")
    start = lander.rest.copy()
    start[2] += 50
    hover = drive(lander, [2000 * 1.62, 0, 0, 0], 2.0, start)
    assert abs(hover[-1, 2] - start[2]) < 0.01
    for axis in range(3):
        control = [2000 * 1.62, 0, 0, 0]
        control[1 + axis] = 500
        angular_velocity = drive(lander, control, 1.0, start)[-1, 10:]
        assert angular_velocity[axis] > 0.05
        assert np.abs(np.delete(angular_velocity, axis)).max() < 1e-3


def test_a_gentle_touchdown_ends_standing():
    lander = load_system("lander")
    start = lander.rest.copy()
    start[2] += 1.0
    start[9] = -0.5
    path = drive(lander, [0, 0, 0, 0], 6.0, start)
    np.testing.assert_allclose(path[-1, :3], lander.rest[:3], atol=0.01)
    assert path[:, 2].min() > lander.rest[2] - 0.25


def test_a_quarter_turn_of_the_lander_changes_nothing_but_the_names_of_its_axes():
    lander, rng = load_system("lander"), np.random.default_rng(0)
    starts = lander.sample_starts(rng, 30)
    controls = lander.bounds.middle + rng.uniform(-1, 1, (30, 20, 4)) * lander.bounds.half
    path = lander.simulate(starts, controls, 0.1).states
    with jax.enable_x64(True):
        quarters = jnp.asarray(np.pi / 2 * rng.integers(1, 4, (30, 1)))
        frame = Frame.of(lander.structure, 0.1)
        turned, held = turned_windows(
            lander.structure, frame, quarters, jnp.asarray(path), jnp.asarray(controls)
        )
    again = lander.simulate(
        np.asarray(turned[:, 0]), lander.bounds.clip(np.asarray(held)), 0.1
    ).states
    np.testing.assert_allclose(again, turned, atol=1e-9)
    assert np.abs(np.asarray(turned) - path).max() > 0.1


@pytest.mark.parametrize("name", ["truck", "lander"])
def test_each_goal_is_a_state_that_stays(name: str):
    system = load_system(name)
    assert set(system.goals) >= ({f"bay_{i}" for i in range(1, 7)} if name == "truck" else {"pad"})
    for goal in system.goals.values():
        state = goal_state(system, goal)
        path = drive(system, [0.0] * system.control.size, 1.0, state)
        assert is_reached(system, goal, path[-1])
        assert not is_reached(system, goal, system.rest + np.eye(system.state.size)[0])


@pytest.mark.parametrize("name", ["truck", "lander"])
def test_the_truth_is_close_to_the_fine_reference(name: str):
    system, rng = load_system(name), np.random.default_rng(1)
    starts = system.sample_starts(rng, 30)
    controls = (
        system.bounds.middle + rng.uniform(-1, 1, (30, 5, system.control.size)) * system.bounds.half
    )
    settled = system.simulate(starts, controls, 0.1).states[:, -1]
    frame = Frame.of(system.structure, 0.1)
    exact, found = (
        system.simulate(settled, controls[:, :1], 0.1, scheme=scheme).states[:, 1]
        for scheme in (system.fine, system.truth)
    )
    unit = frame.difference(settled, exact).std(axis=0)
    assert np.sqrt(np.mean((frame.difference(exact, found) / unit) ** 2)) < 0.01
