"""What `control SYSTEM --goal NAME` finds if nothing else is said: every named goal is reached on the physics."""

from __future__ import annotations

import pytest

from neuroanimator import control, load_emulator, load_system
from neuroanimator.files.zoo import SHIPPED_SYSTEMS
from neuroanimator.systems import goal_names


@pytest.mark.parametrize(
    "name",
    [
        "pendulum",
        *(pytest.param(name, marks=pytest.mark.endurance) for name in ("truck", "lander")),
    ],
)
def test_every_named_goal_is_reached_from_its_own_start(name: str):
    emulator = load_emulator(name)
    system = load_system(name)
    assert system.goals
    for goal in system.goals:
        found = control.synthesise_goal(emulator, system, goal)
        assert found.is_reached, goal


@pytest.mark.parametrize("name", sorted(SHIPPED_SYSTEMS))
def test_goals_are_listed_as_the_system_has_them(name: str):
    assert goal_names(name) == tuple(load_system(name).goals)
