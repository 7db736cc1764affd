"""The table of a TOML file that says what a policy is to do."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from neuroanimator.files.tables import Finite, Table

Limits = tuple[Finite, Finite]
"""Least and largest value."""

FARTHEST = 1e6
"""Where a limit is that there is none."""

ANY = (-FARTHEST, FARTHEST)

Weight = Annotated[float, Field(ge=0, le=1e6)]


class TaskTable(Table):
    """Going forward along X without falling, in the terms of Gymnasium's MuJoCo environments."""

    environment: Annotated[str, Field(max_length=100)] = ""
    """Id of Gymnasium's environment that policies are judged in; if empty, the physics by the rules below."""
    hold: Annotated[int, Field(ge=1, le=1000)]
    """Number of physics steps a control is held."""
    steps: Annotated[int, Field(ge=1, le=100_000)] = 1000
    """Maximum number of controls in an episode."""
    forward_reward: Finite = 1.0
    """Reward of a step for each metre a second along X."""
    control_cost: Weight = 0.0
    """Cost of a step over the sum of squared controls."""
    healthy_reward: Finite = 0.0
    """Reward of a step after which the body is healthy."""
    healthy_height: Limits = ANY
    """Heights of the root between which it is [m]; beyond them the episode ends."""
    healthy_angle: Limits = ANY
    """Pitch of a planar root, likewise [rad]."""
    reset_noise: Weight = 0.0
    """Episodes begin off rest by up to this in every number."""
