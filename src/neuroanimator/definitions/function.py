"""The tables of a TOML file about a system whose physics is a Python function."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from neuroanimator.definitions.parts import ControlPart, GoalTable, Parameters, StatePart
from neuroanimator.files.names import FileName, SystemName
from neuroanimator.files.numbers import MIN_STEP
from neuroanimator.files.tables import Share, Table

MAX_STEP = 3600.0
"""Maximum step of a function [s]: an hour, for something slow."""

FunctionStep = Annotated[float, Field(ge=MIN_STEP, le=MAX_STEP)]
"""A value of dt that a Python function is called with [s]."""


class FunctionPhysics(Table):
    """The values of dt [s] that a Python function is called with; see `System.scheme`, `truth` and `fine`."""

    step: FunctionStep
    truth_step: FunctionStep
    fine_step: FunctionStep


class StartSampling(Table):
    """Random starts of training runs, around the state of rest."""

    rest_share: Share = 0.3
    """Share of starts near rest, as most motions begin."""
    rest_spread: Share = 0.15
    """Spread of starts near rest, as a share of the others'."""


class PythonDefinition(Table):
    """A system whose physics is a Python function."""

    name: SystemName
    kind: Literal["python"]
    file: FileName
    batched: bool = False
    """Whether the function also takes (S, B) states and (C, B) controls at once."""
    substeps: int = Field(50, ge=1, le=1000)
    """Default number of calls of the function in a super step."""
    physics: FunctionPhysics
    state: tuple[StatePart, ...] = Field(min_length=1, max_length=256)
    control: tuple[ControlPart, ...] = Field(min_length=1, max_length=256)
    sampling: StartSampling = StartSampling()
    parameters: Parameters = Field(default={})
    """Parameters that vary between the bodies of a family."""
    goals: dict[SystemName, GoalTable] = Field(default={})
