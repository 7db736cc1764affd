"""In closed loop a goal is reached and kept, whatever the emulator gets wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Cli
from swing_up import PENDULUM, is_upright

from neuroanimator import Emulator, NeuroAnimatorError
from neuroanimator.control import pursue_goal
from neuroanimator.control.objective.goals import find_goal, state_goal
from neuroanimator.learn.planning.plants import ControlledMotion
from neuroanimator.learn.planning.pursue import Pursuit, pursuit_rows
from neuroanimator.learn.planning.regulator import Regulator, regulator_of
from neuroanimator.systems.plants import EmulatorPlant, PhysicsPlant, Plant

OFF = np.array([0.006, -0.004, 0.002, 0.02, 0.04, -0.06])
"""A small difference from upright [rad, rad/s]."""


def test_a_goal_is_reached_and_kept_on_the_physics(shipped: Emulator):
    told: list[int] = []
    pursuit = pursue_goal(shipped, PENDULUM, "upright", 2.0, on_step=told.append)
    assert pursuit.is_reached
    assert told == [*range(1, 41)]
    since = round(pursuit.seconds_to_goal / shipped.dt)
    assert 0 < since < 30
    assert all(is_upright(state) for state in pursuit.motion.states[since:])
    assert not is_upright(pursuit.motion.states[since - 1])
    driven = PENDULUM.simulate(PENDULUM.rest[None], pursuit.motion.controls[None], shipped.dt)
    np.testing.assert_allclose(driven.states[0], pursuit.motion.states, atol=1e-3)


def test_the_command_line_writes_what_was_done(cli: Cli, tmp_path: Path):
    table, scene = tmp_path / "hold.csv", tmp_path / "hold.glb"
    words = ("control", "pendulum", "--closed-loop", "--seconds", "1.5", "--out", table)
    done = cli(*words, "--glb", scene)
    assert done.returncode == 0, done.stderr
    assert "goal reached on the true physics  yes, from" in done.stdout
    assert len(table.read_text().splitlines()) == 1 + 30
    assert scene.read_bytes()[:4] == b"glTF"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--closed-loop", "--log", "x"), "log: does not go with --closed-loop"),
        (("--horizon", "1"), "horizon: applies to --closed-loop only"),
        (("--closed-loop", "--horizon", "99"), "horizon: wanted between 0.1 and 20 s, got 99"),
        (("--closed-loop", "--seconds", "0.01"), "seconds: wanted between 0.05 and 600, got 0.01"),
    ],
)
def test_what_does_not_go_together_is_refused_and_nothing_written(
    words: tuple[str, ...], message: str, cli: Cli, tmp_path: Path
):
    done = cli("control", "pendulum", *words, "--out", tmp_path / "no.csv")
    assert done.returncode == 2
    assert message in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_weight_that_is_no_number_is_refused(shipped: Emulator):
    with pytest.raises(NeuroAnimatorError, match="effort_weight: wanted a finite number"):
        pursue_goal(shipped, PENDULUM, "upright", effort_weight=float("nan"))


@pytest.mark.parametrize("dt", [0.01, 0.05, 2.0])
@pytest.mark.parametrize("share", [0.02, 0.9, 1.1, 40.0])
def test_planning_that_takes_longer_than_a_super_step_is_told(dt: float, share: float):
    seconds = np.full(9, share * dt)
    seconds[0] = 100 * dt  # a single slow plan is told as such
    motion = ControlledMotion(np.zeros((10, 6)), np.zeros((9, 3)), seconds)
    rows = dict(pursuit_rows(Pursuit(motion, np.ones(10, bool), dt, is_on_physics=True)))
    told = f"slower than real time, as a super step lasts {1e3 * dt:.3g} ms"
    assert (told in str(rows["a plan takes"])) == (share > 1)


def upright(emulator: Emulator, plant: Plant) -> Regulator:
    goal = find_goal(PENDULUM, "upright")
    found = regulator_of(plant, PENDULUM, goal, emulator.bounds, emulator.dt, 1.0)
    assert found is not None
    return found


def test_the_cost_to_go_is_what_the_regulated_motion_costs(shipped: Emulator):
    plant = EmulatorPlant(shipped)
    regulator = upright(shipped, plant)
    reach = regulator.reach
    goal = np.asarray(reach.goal, float)

    def off(state: np.ndarray) -> np.ndarray:
        return reach.frame.difference(goal, state)

    state = goal + OFF
    start = off(state) - off(goal)
    spent = 0.0
    for _ in range(200):
        control = regulator(state)
        pull = (control - regulator.control) / shipped.bounds.half
        spent += shipped.dt / 2 * (np.sum((reach.judged @ off(state)) ** 2) + np.sum(pull**2))
        state = plant(state, control)
    assert spent == pytest.approx(start @ regulator.cost_matrix @ start / 2, rel=0.1)


def test_the_physics_is_held_upright_by_the_gain_of_its_emulator(shipped: Emulator):
    regulator = upright(shipped, PhysicsPlant(PENDULUM, shipped.dt))
    goal = np.asarray(regulator.reach.goal, float)
    assert regulator.holds(goal + 5 * OFF)


def test_what_leaves_part_free_or_cannot_stand_still_has_no_regulator(shipped: Emulator):
    free = state_goal(PENDULUM, {"angle": [np.pi, 0.0, 0.0]}, {})
    moving = {"angle": [0.0] * 3, "velocity": [9.0, 0.0, 0.0]}
    for goal in (free, state_goal(PENDULUM, moving, {})):
        plant = PhysicsPlant(PENDULUM, shipped.dt)
        assert regulator_of(plant, PENDULUM, goal, shipped.bounds, shipped.dt, 1.0) is None
