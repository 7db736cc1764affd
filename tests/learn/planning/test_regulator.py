"""What holds a body is the optimum of the J that plans have, as far as the emulator is linear."""

from __future__ import annotations

import numpy as np
import pytest
from swing_up import PENDULUM

from neuroanimator import Emulator
from neuroanimator.control.objective.goals import find_goal, state_goal
from neuroanimator.learn.planning.plants import EmulatorPlant, PhysicsPlant, Plant
from neuroanimator.learn.planning.regulator import Regulator, regulator_of

OFF = np.array([0.006, -0.004, 0.002, 0.02, 0.04, -0.06])
"""A small difference from upright [rad, rad/s]."""


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
