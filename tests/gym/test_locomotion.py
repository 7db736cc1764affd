"""Tasks of going forward: what they pay and end is what Gymnasium's environments pay and end."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from neuroanimator import NeuroAnimatorError
from neuroanimator.gym.locomotion import gymnasium_task, locomotion_rules
from neuroanimator.learn.planning.environments import mujoco_state
from neuroanimator.state.parameters import Parameter
from neuroanimator.state.segments import Position, Quaternion
from neuroanimator.state.structure import Structure

STEPS = 40

SEGMENTS = {"Ant-v5": (Position(rate=7), Quaternion(rate=10))}
"""Of a free root; those of the others are planar."""


@pytest.mark.parametrize("env_id", ["Hopper-v5", "Walker2d-v5", "HalfCheetah-v5", "Ant-v5"])
def test_a_task_pays_and_ends_what_its_environment_does(env_id: str):
    # What it pays for contact forces is no function of states.
    changes = {"contact_cost_weight": 0.0} if env_id == "Ant-v5" else {}
    environment: Any = gymnasium.make(env_id, **changes)
    task = gymnasium_task(env_id)
    model = environment.unwrapped.model
    structure = Structure((), (), (), segments=SEGMENTS.get(env_id, ()))
    rules = locomotion_rules(task, structure, np.zeros(model.nq + model.nv))
    assert task.hold * model.opt.timestep == pytest.approx(environment.unwrapped.dt)
    environment.action_space.seed(0)
    observation, _ = environment.reset(seed=0)
    before = mujoco_state(environment, observation)
    differences = []
    for _ in range(STEPS):
        action = environment.action_space.sample()
        observation, reward, is_over, _, _ = environment.step(action)
        after = mujoco_state(environment, observation)
        earned = rules.reward(before[None], action[None], after[None], environment.unwrapped.dt)
        differences.append(earned[0] - reward)
        assert rules.is_over(after[None])[0] == is_over
        before = after
        if is_over:
            observation, _ = environment.reset()
            before = mujoco_state(environment, observation)
    environment.close()
    if env_id == "Ant-v5":
        # Its velocity is by where its body was one physics step earlier: that evens out.
        assert abs(np.mean(differences)) < 0.01
    else:
        np.testing.assert_allclose(differences, 0, atol=1e-5)


def test_an_environment_that_pays_for_something_else_is_refused():
    with pytest.raises(NeuroAnimatorError, match="EpisodeRules"):
        gymnasium_task("Reacher-v5")


def test_episodes_of_a_family_begin_with_bodies_of_it():
    task = gymnasium_task("Hopper-v5")
    mass = Parameter(name="mass", unit="kg", low=2.0, high=4.0, nominal=3.0)
    rest = np.append(np.zeros(12), 3.0)
    rules = locomotion_rules(task, Structure((), (), ()), rest, (mass,))
    assert rules.draw_start is not None
    rng = np.random.default_rng(0)
    starts = np.stack([rules.draw_start(rng) for _ in range(200)])
    assert starts[:, -1].min() < 2.1
    assert starts[:, -1].max() > 3.9
    assert np.abs(starts[:, :-1]).max() <= task.reset_noise
