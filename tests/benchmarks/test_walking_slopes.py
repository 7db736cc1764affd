"""Slopes of a return by an emulator, by differences and under noise are those of the same return."""

from __future__ import annotations

import numpy as np
import pytest
import slope_descents
from walking_slopes import (
    Case,
    cosine,
    differences,
    emulator_slope,
    goes_on,
    rolled_out,
    smoothed,
    summed,
)

from neuroanimator import load_emulator, load_system
from neuroanimator.gym import EpisodeRules
from neuroanimator.gym.learner import Learner, PolicyLearning
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem

STEPS = 4


def cost(states, controls, following, dt):
    return -(following**2).sum(axis=-1) - 0.01 * (controls**2).sum(axis=-1)


@pytest.fixture(scope="module")
def case() -> Case:
    system = load_system("pendulum")
    assert isinstance(system, MujocoSystem)
    start = np.array([0.3, 0.1, -0.2, 0.0, 0.0, 0.0])
    rules = EpisodeRules(cost, draw_start=lambda rng: start)
    learning = PolicyLearning(bodies=16, policy_widths=(8,), critic_widths=(8,))
    policy = Learner(system, load_emulator("pendulum"), rules, learning).policy
    return Case("pendulum", "at first", system, rules, policy, 0.1, start[None])


def test_the_emulators_slope_is_that_of_its_own_return(case: Case):
    controls, states = rolled_out(case, case.starts[0], STEPS)
    emulator = case.policy.emulator

    def earned(controls: np.ndarray) -> float:
        way = np.asarray(emulator.rollout(states[0], controls), float)
        return float(cost(way[:-1], controls, way[1:], emulator.dt).sum())

    slope = emulator_slope(case, is_true=False)(controls, states, goes_on(case, states))
    step = 0.01 * np.sign(slope)
    change = (earned(controls + step) - earned(controls - step)) / 2
    np.testing.assert_allclose((slope * step).sum(), change, rtol=0.01)


def test_slopes_of_smooth_physics_agree(case: Case):
    controls, states = rolled_out(case, case.starts[0], STEPS)
    noise = np.random.default_rng(0).normal(size=(256, *controls.shape))
    (halves,) = smoothed(case, controls, states[0], [STEPS], noise)
    moved = summed(differences(case, controls, states), STEPS)
    assert cosine(halves.mean(axis=0), moved) > 0.95
    weights = goes_on(case, states)
    for is_true in (True, False):
        slope = emulator_slope(case, is_true=is_true)(controls, states, weights)
        assert cosine(slope, moved) > 0.98


def test_a_descent_gains_on_the_physics(case: Case, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(slope_descents, "SECONDS", 0.2)
    monkeypatch.setattr(slope_descents, "RATES", (1.0,))
    rows = {row["slope"]: row for row in slope_descents.measured(case)}
    assert set(rows) == {"decoupled", "differences", "random"}
    assert rows["decoupled"]["gain"] > 0
