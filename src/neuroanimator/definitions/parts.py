"""The TOML tables of the parts of state and control, for systems without a model file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from neuroanimator.files.names import PartName
from neuroanimator.files.tables import Finite, Table


class StatePart(Table):
    """One named part of the state of a system without a model file."""

    name: PartName
    unit: str
    size: int = Field(1, ge=1, le=256)
    """Length of the part, a vector in one unit."""
    feature: Literal["plain", "sine", "cyclic"] = "plain"
    """How the part is represented to the network: as it is, by sine and cosine, or not at all.

    A cyclic part is left out: its position does not matter, only its rate.
    """
    rate: str = ""
    """Name of the part that is its rate of change; empty if there is none."""
    rest: tuple[Finite, ...] = ()
    """Its numbers at rest; zeros if not given."""
    spread: tuple[Annotated[float, Field(ge=0, le=1e9)], ...] = ()
    """Half the width of the uniform spread of random starts around rest."""


class ControlPart(Table):
    """One named part of the control, and its bounds."""

    name: PartName
    unit: str
    low: tuple[Finite, ...] = Field(min_length=1, max_length=256)
    """Minimum value of each of its numbers."""
    high: tuple[Finite, ...] = Field(min_length=1, max_length=256)
    """Maximum value of each of its numbers."""
