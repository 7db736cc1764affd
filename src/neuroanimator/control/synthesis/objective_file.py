"""Objectives written down: a TOML file with the objective of a motion, checked key by key.

    system = "fish"
    seconds = 3.0
    parametrisation = "periodic"

    [[costs]]
    kind = "travel"
    direction = [1, 0, 0]
    distance = 2.0
    within = 0.26

Each cost is a function of `costs`, `goals` or `obstacles`; its other keys are that function's arguments.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict, Field, ValidationError, create_model

from neuroanimator.control.descent.parametrisation import (
    EachStep,
    Parametrisation,
    Periodic,
    Spline,
)
from neuroanimator.control.objective import costs, goals
from neuroanimator.control.objective.objective import CostTerm, Objective
from neuroanimator.control.objective.obstacles import avoid
from neuroanimator.control.synthesis.attempt import SearchOptions
from neuroanimator.control.synthesis.synthesise import MAX_SECONDS, Synthesis, synthesise
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.names import SystemName
from neuroanimator.files.tables import Finite, Positive, Table, first_fault, read_toml
from neuroanimator.state.slowness import slowness
from neuroanimator.systems.goal import Goal
from neuroanimator.systems.system import System
from neuroanimator.text import quoted

DEFAULT_KNOTS = 12
"""Default number of a spline's knots: enough for a few swings back and forth."""

MIN_KNOTS = 4
"""Minimum number of a cubic spline's knots."""

MAX_STARTS = 64
"""Maximum number of first guesses to descend from in parallel; memory grows with it."""

MANY_SUBSTEPS = 50
"""Maximum number of physics steps in a super step of a file's emulators; it limits the duration of a slow motion."""


class ObjectiveTable(Table):
    """Keys of the file; the costs are checked one by one."""

    system: SystemName
    seconds: Positive
    parametrisation: Literal["each step", "spline", "periodic"] = "each step"
    knots: Annotated[int, Field(ge=MIN_KNOTS)] | None = None
    """Number of knots; for splines only."""
    period: Positive | None = None
    """Period of the first guess [s]; for periodic controls only."""
    starts: Annotated[int, Field(ge=1, le=MAX_STARTS)] = 1
    start: dict[str, tuple[Finite, ...]] = Field(default={})
    """Values of parts of the state at the start; all others are at rest."""
    costs: Annotated[tuple[dict[str, Any], ...], Field(min_length=1)]


@dataclass(frozen=True)
class ObjectiveFile:
    """Contents of an objective file."""

    system: System
    objective: Objective
    start: np.ndarray
    """Initial state (S,)."""
    seconds: float
    starts: int
    """Number of first guesses to descend from."""
    make_parametrisation: Callable[[int, float], Parametrisation]
    """(number of super steps, super step [s]) → the parametrisation of a descent."""
    goals: tuple[Goal, ...]
    """Goals and states to reach at the end."""


def read_objective(path: str | Path, system: System) -> ObjectiveFile:
    """Return the contents of the file at `path` for `system`; BadFileError names the key or the cost that is wrong."""
    path = Path(path)
    values = read_toml(path)
    try:
        return _objective_of(ObjectiveTable.model_validate(values), system)
    except ValidationError as error:
        raise BadFileError(f"{path.name}: {first_fault(error)}.") from error
    except ArgumentError as error:
        raise BadFileError(f"{path.name}: {error}") from error


def synthesise_file(
    emulator: Emulator, file: ObjectiveFile, *, options: SearchOptions = SearchOptions()
) -> Synthesis:
    """Return the controller for the objective of a file; see `synthesise` for the `options`.

    The first guess of a system with a gait is that gait: an animal at rest has no gradient that tells left from right. The
    parametrisation and the number of first guesses are the file's.
    """
    steps = goals.steps_in(file.seconds, emulator.dt, MAX_SECONDS * slowness(emulator.dt))
    system = file.system
    first = options.descent.first
    if system.gait is not None:
        first = system.gait.controls(steps, emulator.dt, system.bounds)
    descent = replace(
        options.descent,
        parametrisation=file.make_parametrisation(steps, emulator.dt),
        starts=file.starts,
        first=first,
    )
    options = replace(options, descent=descent)
    synthesis = synthesise(
        emulator, system, file.objective, file.start, steps=steps, options=options
    )
    if not file.goals:
        return synthesis
    end = synthesis.outcome.physics_states[-1]
    is_reached = all(goals.is_reached(system, goal, end) for goal in file.goals)
    return replace(synthesis, is_reached=is_reached)


def _objective_of(table: ObjectiveTable, system: System) -> ObjectiveFile:
    if table.system != system.name:
        raise ArgumentError(
            f"system: this objective is for {table.system}, the emulator of {system.name}."
        )
    longest = MAX_SECONDS * slowness(MANY_SUBSTEPS * system.physics_dt)
    if table.seconds > longest:
        raise ArgumentError(f"seconds: wanted at most {longest:g}, got {table.seconds:g}.")
    terms = [_cost(number, values, system) for number, values in enumerate(table.costs, start=1)]
    return ObjectiveFile(
        system=system,
        objective=Objective.of(*terms),
        start=system.start_at(table.start),
        seconds=table.seconds,
        starts=table.starts,
        make_parametrisation=_parametrisation_maker(table, system),
        goals=tuple(_goals_at_the_end(table, system)),
    )


def _goals_at_the_end(table: ObjectiveTable, system: System) -> list[Goal]:
    """Return the goals and the states to reach at the end, goals first."""
    at_end = [cost for cost in table.costs if "at" not in cost]
    reached = [goals.find_goal(system, cost["name"]) for cost in at_end if cost["kind"] == "goal"]
    for cost in at_end:
        if cost["kind"] == "reach_state":
            reached.append(goals.state_goal(system, cost["reach"], cost.get("within", {})))
    return reached


def _parametrisation_maker(
    table: ObjectiveTable, system: System
) -> Callable[[int, float], Parametrisation]:
    for key, owner in (("knots", "spline"), ("period", "periodic")):
        if getattr(table, key) is not None and table.parametrisation != owner:
            raise ArgumentError(
                f'{key}: goes with parametrisation = "{owner}" only, got "{table.parametrisation}".'
            )
    period = table.period
    if period is None and system.gait is not None:
        period = system.gait.period
    if table.parametrisation == "periodic" and period is None:
        raise ArgumentError(
            f"period: wanted one [s], for {system.name} has no gait to take it from."
        )

    def make(steps: int, dt: float) -> Parametrisation:
        if table.parametrisation == "spline":
            knots = table.knots or min(DEFAULT_KNOTS, max(steps, MIN_KNOTS))
            return Spline.of(steps, knots, system.bounds)
        if table.parametrisation == "periodic" and period is not None:
            return Periodic.of(steps, dt, period, system.bounds)
        return EachStep.of(steps, system.bounds)

    return make


KINDS: dict[str, Callable[..., CostTerm]] = {
    "avoid": avoid,
    "goal": goals.goal,
    "reach_state": goals.reach_state,
    **{name: getattr(costs, name) for name in costs.__all__},
}
"""Function that makes each kind of cost, by its name in a file."""


def _cost(number: int, values: dict[str, Any], system: System) -> CostTerm:
    kind = values.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise ArgumentError(
            f"cost {number}: no kind {quoted(kind)}. Kinds: {', '.join(sorted(KINDS))}."
        )
    make = KINDS[kind]
    given = {key: value for key, value in values.items() if key != "kind"}
    try:
        arguments = _checked_arguments(make, given)
        if "system" in inspect.signature(make).parameters:
            return make(system, **arguments)
        return make(**arguments)
    except ValidationError as error:
        raise ArgumentError(f"cost {number} ({kind}): {first_fault(error)}.") from error
    except ArgumentError as error:
        raise ArgumentError(f"cost {number} ({kind}): {error}") from error


def _checked_arguments(make: Callable[..., CostTerm], given: dict[str, Any]) -> dict[str, Any]:
    """Return `given` as the arguments of `make`; ArgumentError or ValidationError states what is wrong."""
    parameters = dict(inspect.signature(make, eval_str=True).parameters)
    parameters.pop("system", None)
    needed = [name for name, taken in parameters.items() if taken.default is taken.empty]
    _refuse_keys("no argument", given.keys() - parameters.keys(), list(parameters), needed)
    _refuse_keys("wanted", needed - given.keys(), list(parameters), needed)
    fields: dict[str, Any] = {}
    for name, taken in parameters.items():
        default = ... if name in needed else taken.default
        # Arrays are checked by `make`, which knows their shape.
        kind = Any if taken.annotation == ArrayLike else taken.annotation
        fields[name] = (kind, default)
    strict = ConfigDict(strict=True, allow_inf_nan=False)
    model = create_model("Arguments", __config__=strict, **fields)
    # In JSON mode a list is accepted for a tuple and a table for a dataclass, but a text for no number.
    checked = model.model_validate_json(json.dumps(given, default=str))
    return {name: getattr(checked, name) for name in checked.model_fields_set}


def _refuse_keys(fault: str, keys: set[str], arguments: list[str], needed: list[str]) -> None:
    """Raise ArgumentError for the first of `keys`, if there are any."""
    if not keys:
        return
    needs = f"; needed: {', '.join(needed)}" if needed else ""
    raise ArgumentError(f"{fault} {quoted(min(keys))}. Arguments: {', '.join(arguments)}{needs}.")
