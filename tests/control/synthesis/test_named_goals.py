"""What `control SYSTEM --goal NAME` finds if nothing else is said: every named goal is reached on the physics."""

from __future__ import annotations

import pytest

from neuroanimator import load_emulator, load_system
from neuroanimator.control.synthesis.synthesise import synthesise_goal


@pytest.mark.parametrize(
    "name", ["pendulum", pytest.param("truck", marks=pytest.mark.endurance), "lander"]
)
def test_every_named_goal_is_reached_from_its_own_start(name: str):
    emulator = load_emulator(name)
    goals = load_system(name).goals
    assert goals
    for goal in goals:
        found = synthesise_goal(emulator, goal)
        assert found.is_reached, goal
