"""The tables of a TOML file about a system known from recordings alone."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from neuroanimator.definitions.parts import ControlPart, GoalTable, StatePart
from neuroanimator.files.names import FileName, SystemName
from neuroanimator.files.numbers import MIN_STEP
from neuroanimator.files.tables import Table


class RecordedPhysics(Table):
    """The sampling of recordings."""

    step: Annotated[float, Field(ge=MIN_STEP, le=3600)]
    """Interval between two samples [s]."""


class RecordedDefinition(Table):
    """A system known from recordings alone."""

    name: SystemName
    kind: Literal["recorded"]
    file: FileName
    resample: bool = False
    """Whether samples at uneven times are interpolated at even ones."""
    velocities: bool = False
    """Whether velocities that the file does not hold are estimated from positions."""
    substeps: int = Field(10, ge=1, le=1000)
    """Default number n of samples in a super step."""
    physics: RecordedPhysics
    state: tuple[StatePart, ...] = Field(min_length=1, max_length=256)
    control: tuple[ControlPart, ...] = Field((), max_length=256)
    """Parts of the control; empty for undriven systems: a free swing, a drop, motion capture."""
    goals: dict[SystemName, GoalTable] = Field(default={})
