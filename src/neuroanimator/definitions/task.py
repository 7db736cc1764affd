"""The TOML table of a policy's task."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from neuroanimator.files.tables import Finite, Table

Limits = tuple[Finite, Finite]
"""Minimum and maximum value."""

FARTHEST = 1e6
"""Magnitude of a limit that does not limit."""

ANY = (-FARTHEST, FARTHEST)

Weight = Annotated[float, Field(ge=0, le=1e6)]


class TaskTable(Table):
    """Moving forward along X without falling, in the terms of Gymnasium's MuJoCo environments."""

    environment: Annotated[str, Field(max_length=100)] = ""
    """Id of the Gymnasium environment in which policies are judged; if empty, the physics by the rules below."""
    hold: Annotated[int, Field(ge=1, le=1000)]
    """Number of physics steps for which a control is held."""
    steps: Annotated[int, Field(ge=1, le=100_000)] = 1000
    """Maximum number of controls in an episode."""
    forward_reward: Finite = 1.0
    """Reward of a step per metre a second along X."""
    control_cost: Weight = 0.0
    """Cost of a step per unit of the sum of squared controls."""
    healthy_reward: Finite = 0.0
    """Reward of a step after which the body is healthy."""
    healthy_height: Limits = ANY
    """Minimum and maximum height of the root of a healthy body [m]; beyond them the episode ends."""
    healthy_angle: Limits = ANY
    """Minimum and maximum pitch of a planar root [rad]; beyond them the episode ends."""
    reset_noise: Weight = 0.0
    """Maximum random deviation of every number from rest at the start of an episode."""
