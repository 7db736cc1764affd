"""The TOML table of a control goal."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from neuroanimator.files.tables import Finite, Positive, Table

MAX_SECONDS = 1e6
"""Maximum duration of a motion to a goal [s]: twelve days, for something slow."""


class GoalTable(Table):
    """A state, or part of one, worth reaching."""

    seconds: Annotated[float, Field(gt=0, le=MAX_SECONDS)] = 2.0
    """Time in which to get there [s]; its maximum depends on the super step."""
    site: str = ""
    """Site of the model whose position and orientation a free root should reach, at rest."""
    reach: dict[str, tuple[Finite, ...]] = Field(default={})
    """Parts of the state and their values at the end."""
    start: dict[str, tuple[Finite, ...]] = Field(default={})
    """Parts of the default start of a motion to this goal; all others are as at rest."""
    within: dict[str, Positive] = Field(default={})
    """Maximum error of each of these parts, in its unit; 0.1 by default."""
