"""The table of a TOML file that names a goal of control."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from neuroanimator.files.tables import Finite, Positive, Table

MAX_SECONDS = 1e6
"""[s] No motion to a goal is longer: twelve days, of something slow."""


class GoalTable(Table):
    """A state, or part of one, worth reaching."""

    seconds: Annotated[float, Field(gt=0, le=MAX_SECONDS)] = 2.0
    """Time in which to get there [s]; how long it may be depends on the super step."""
    site: str = ""
    """A site of the model where a free root should be, at rest and turned as the site is."""
    reach: dict[str, tuple[Finite, ...]] = Field(default={})
    """Parts of the state and the values they should have at the end."""
    start: dict[str, tuple[Finite, ...]] = Field(default={})
    """Parts of the state a motion to this goal starts with, if nothing else is said; others are as at rest."""
    within: dict[str, Positive] = Field(default={})
    """Largest error of each of these parts, in its unit; 0.1 if not said."""
