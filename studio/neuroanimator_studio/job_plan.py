"""What a training started from the page is to do: the system, the super step, how large and how long."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from neuroanimator import ArgumentError, BadFileError
from neuroanimator.authoring import SHIPPED_SYSTEMS, SystemName, Table, first_fault, write_whole

PLAN = "plan.json"
"""The file of a job's folder that says what it is to do."""

MODEL = "model.toml"
"""The file of a job's folder that defines somebody's own system; there is none for a system of the package."""

MIN_COUNT = 3600
"""The fewest transitions worth training on."""

MIN_UPDATES = 250
"""The fewest updates there can be: those compiled into one call."""

Size = Literal["sketch", "usual", "large"]


class Plan(Table):
    """What a training is to do."""

    system: SystemName
    substeps: Annotated[int, Field(ge=1, le=1000)]
    size: Size = "usual"
    count: Annotated[int, Field(ge=MIN_COUNT, le=10_000_000)] | None = None
    """Transitions to learn from; what the size takes if not given."""
    updates: Annotated[int, Field(ge=MIN_UPDATES, le=1_000_000)] | None = None
    """Updates of the weights; what the size takes if not given."""
    began: float = 0.0
    """When it was started [s since 1970]."""


def checked_plan(values: dict[str, object]) -> Plan:
    """Return a plan; ArgumentError names what is wrong with it."""
    try:
        return Plan.model_validate(values)
    except ValidationError as error:
        raise ArgumentError(f"{first_fault(error)}.") from error


def check_packaged(system: str) -> None:
    """Raise ArgumentError, which lists the systems of the package, unless `system` is one of them."""
    if system not in SHIPPED_SYSTEMS:
        names = ", ".join(sorted(SHIPPED_SYSTEMS))
        raise ArgumentError(f"No system called '{system}'. Systems: {names}.")


def write_plan(plan: Plan, folder: Path) -> None:
    """Write what the job in `folder` is to do."""
    write_whole(folder / PLAN, plan.model_dump_json().encode())


def read_plan(folder: Path) -> Plan:
    """Return what the job in `folder` is to do; BadFileError for a file that says nothing of the kind."""
    try:
        return checked_plan(json.loads((folder / PLAN).read_text()))
    except (OSError, ValueError) as error:
        raise BadFileError(
            f"{folder.name} is not a training job. Remove it with 'Forget'."
        ) from error
