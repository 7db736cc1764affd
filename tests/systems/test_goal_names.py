"""The names of goals that are listed without physics are those of the systems."""

from __future__ import annotations

import pytest

from neuroanimator import load_system
from neuroanimator.files.zoo import SHIPPED_SYSTEMS
from neuroanimator.systems import goal_names


@pytest.mark.parametrize("name", sorted(SHIPPED_SYSTEMS))
def test_goals_are_listed_as_the_system_has_them(name: str):
    assert goal_names(name) == tuple(load_system(name).goals)
