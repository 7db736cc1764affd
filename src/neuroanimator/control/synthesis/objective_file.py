"""Objectives written down: a TOML file that says what a motion should achieve, checked key by key.

    system = "fish"
    seconds = 3.0
    parametrisation = "periodic"

    [[costs]]
    kind = "travel"
    direction = [1, 0, 0]
    distance = 2.0
    within = 0.26

Each wish is a function of `costs`, `obstacles` or this file; its other keys are that function's arguments.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict, Field, PlainValidator, ValidationError, create_model
from pydantic_core import PydanticCustomError

from neuroanimator.control.descent.parametrisation import (
    EachStep,
    Parametrisation,
    Periodic,
    Spline,
)
from neuroanimator.control.objective import costs
from neuroanimator.control.objective.goals import Verdict, find_goal, is_reached, reach_goal
from neuroanimator.control.objective.objective import Objective, Term
from neuroanimator.control.objective.obstacles import avoid
from neuroanimator.control.objective.terms import END, as_weight
from neuroanimator.control.synthesis.synthesise import LONGEST, Synthesis, synthesise
from neuroanimator.definitions.goal import GoalTable
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.parsing.names import SystemName
from neuroanimator.systems.goal import Goal
from neuroanimator.systems.system import System
from neuroanimator.tables import Finite, Positive, Table, first_fault, read_toml

USUAL_KNOTS = 12
"""Of a spline: enough for a few swings to and fro."""
MAX_STARTS = 64
"""First guesses descended from side by side; memory grows with them."""


class ObjectiveTable(Table):
    """What the file may hold; the wishes are checked one by one."""

    system: SystemName
    seconds: Annotated[float, Field(gt=0, le=LONGEST)]
    parametrisation: Literal["each step", "spline", "periodic"] = "each step"
    knots: Annotated[int, Field(ge=4)] | None = None
    """Of splines only."""
    period: Positive | None = None
    """[s] Of periodic controls only; the first guess."""
    starts: Annotated[int, Field(ge=1, le=MAX_STARTS)] = 1
    start: dict[str, tuple[Finite, ...]] = Field(default={})
    """Parts of the state and where the motion begins; at rest if not said."""
    costs: Annotated[tuple[dict[str, Any], ...], Field(min_length=1)]


@dataclass(frozen=True)
class Wanted:
    """What an objective file asks for."""

    system: System
    objective: Objective
    start: np.ndarray
    """(S,)"""
    seconds: float
    starts: int
    """First guesses to descend from."""
    vary: Callable[[int, float], Parametrisation]
    """(super steps, super step [s]) → what a descent may vary."""
    verdicts: tuple[Verdict, ...]
    """Of the goals and states wanted at the end."""


def read_objective(path: Path, system: System) -> Wanted:
    """Return what the file at `path` asks of `system`; BadFileError names the key or the wish that is wrong."""
    values = read_toml(path)
    try:
        return _wanted(ObjectiveTable.model_validate(values), system)
    except ValidationError as error:
        raise BadFileError(f"{path.name}: {first_fault(error)}.") from error
    except ArgumentError as error:
        raise BadFileError(f"{path.name}: {error}") from error


def synthesise_wanted(
    emulator: Emulator, wanted: Wanted, *, starts: int | None = None, **options: Any
) -> Synthesis:
    """Return the controller for what a file asks for; `starts` overrides the file's, options are `synthesise`'s.

    What has a gait is first moved by it: an animal at rest has no slope that says left or right.
    """
    steps = round(wanted.seconds / emulator.dt)
    if steps < 1:
        raise ArgumentError(
            f"seconds: wanted at least one super step of {emulator.dt:g} s, came {wanted.seconds:g}."
        )
    system, dt = wanted.system, emulator.dt
    options |= {
        "starts": wanted.starts if starts is None else starts,
        "parametrisation": wanted.vary(steps, dt),
    }
    options |= {"first": system.gait.controls(steps, dt, system.bounds)} if system.gait else {}
    found = synthesise(emulator, system, wanted.objective, wanted.start, steps=steps, **options)
    end = found.outcome.physics_states[-1]
    return replace(
        found,
        is_reached=all(verdict(end) for verdict in wanted.verdicts) if wanted.verdicts else None,
    )


def _wanted(table: ObjectiveTable, system: System) -> Wanted:
    if table.system != system.name:
        raise ArgumentError(
            f"system: this objective is for {table.system}, the emulator of {system.name}."
        )
    terms = [_wish(number, values, system) for number, values in enumerate(table.costs, start=1)]
    named = [wish["name"] for wish in table.costs if wish["kind"] == "goal" and "at" not in wish]
    return Wanted(
        system=system,
        objective=Objective.of(*terms),
        start=system.start_at(table.start),
        seconds=table.seconds,
        starts=table.starts,
        vary=_vary(table, system),
        verdicts=(*(find_goal(system, name)[1] for name in named), *_states_reached(table, system)),
    )


def _states_reached(table: ObjectiveTable, system: System) -> list[Verdict]:
    """Return a verdict for each state that is to be reached at the end."""
    wanted = [wish for wish in table.costs if wish["kind"] == "reach_state" and "at" not in wish]
    goals = [goal_to_reach(system, wish["reach"], wish.get("within", {})) for wish in wanted]
    return [partial(is_reached, system, goal) for goal in goals]


def _vary(table: ObjectiveTable, system: System) -> Callable[[int, float], Parametrisation]:
    for key, owner in (("knots", "spline"), ("period", "periodic")):
        if getattr(table, key) is not None and table.parametrisation != owner:
            raise ArgumentError(
                f'{key}: goes with parametrisation = "{owner}" only, came "{table.parametrisation}".'
            )
    period = table.period or (system.gait.period if system.gait else None)
    if table.parametrisation == "spline":
        return lambda steps, dt: Spline.of(
            steps, table.knots or min(USUAL_KNOTS, max(steps, 4)), system.bounds
        )
    if table.parametrisation == "each step":
        return lambda steps, dt: EachStep.of(steps, system.bounds)
    if period is None:
        raise ArgumentError(
            f"period: wanted one [s], for {system.name} has no gait to take it from."
        )
    return lambda steps, dt: Periodic.of(steps, dt, period, system.bounds)


def goal(system: System, name: str, *, at: float | None = None, weight: float = 1.0) -> Term:
    """Return the wish to be in the state the system calls `name` at the end, or `at` [s]."""
    reach = find_goal(system, name)[0].terms[-1]
    return replace(reach, weight=as_weight(weight), times=END if at is None else (at,))


def reach_state(
    system: System,
    reach: dict[str, tuple[float, ...]],
    *,
    within: dict[str, float] | None = None,
    at: float | None = None,
    weight: float = 1.0,
) -> Term:
    """Return the wish that parts of the state have the values `reach` at the end, or `at` [s].

    `within` says how far off each of them may be, in its unit; 0.1 if not said.
    """
    wanted = goal_to_reach(system, reach, within or {})
    return reach_goal(system.structure, system.rest, wanted, weight, END if at is None else (at,))


def goal_to_reach(
    system: System, reach: dict[str, tuple[float, ...]], within: dict[str, float]
) -> Goal:
    """Return the goal that parts of the state have the values `reach`, `within` some tolerances."""
    if not reach:
        raise ArgumentError("reach: wanted at least one part of the state and its values.")
    table = GoalTable(reach=reach, within=within)
    return system.goal("reach_state", table)


KINDS: dict[str, Callable[..., Term]] = {
    "avoid": avoid,
    "effort": costs.effort,
    "follow_path": costs.follow_path,
    "goal": goal,
    "keep_heading": costs.keep_heading,
    "keep_speed": costs.keep_speed,
    "keep_velocity": costs.keep_velocity,
    "reach_positions": costs.reach_positions,
    "reach_heading": costs.reach_heading,
    "reach_height": costs.reach_height,
    "reach_position": costs.reach_position,
    "reach_state": reach_state,
    "smoothness": costs.smoothness,
    "stand_up": costs.stand_up,
    "stay_upright": costs.stay_upright,
    "stay_within": costs.stay_within,
    "travel": costs.travel,
}


def _wish(number: int, values: dict[str, Any], system: System) -> Term:
    kind = values.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise ArgumentError(
            f"cost {number}: no kind {str(kind)[:40]!r}. Kinds: {', '.join(KINDS)}."
        )
    given = {key: value for key, value in values.items() if key != "kind"}
    try:
        arguments = _arguments(KINDS[kind], given)
        takes_system = "system" in inspect.signature(KINDS[kind]).parameters
        return KINDS[kind](*[system] * takes_system, **arguments)
    except ValidationError as error:
        raise ArgumentError(f"cost {number} ({kind}): {first_fault(error)}.") from error
    except ArgumentError as error:
        raise ArgumentError(f"cost {number} ({kind}): {error}") from error


def _arguments(function: Callable[..., Term], given: dict[str, Any]) -> dict[str, Any]:
    """Return `given` as the arguments of `function`; ArgumentError or ValidationError says what is wrong."""
    taken = [
        p
        for p in inspect.signature(function, eval_str=True).parameters.values()
        if p.name != "system"
    ]
    names, needed = [p.name for p in taken], [p.name for p in taken if p.default is p.empty]
    wrong = {
        "no argument": [key for key in given if key not in names],
        "wanted": [*needed - given.keys()],
    }
    for said, keys in wrong.items():
        if keys:
            needs = f"; needed: {', '.join(needed)}" if needed else ""
            raise ArgumentError(f"{said} '{min(keys)[:40]}'. Arguments: {', '.join(names)}{needs}.")
    types: dict[str, Any] = {
        p.name: (_checked(p.annotation), ... if p.name in needed else p.default) for p in taken
    }
    strict = ConfigDict(strict=True, allow_inf_nan=False)
    model = create_model("Arguments", __config__=strict, **types)
    # As JSON a list may stand for a tuple and a table for a dataclass, and still a text for no number.
    checked = model.model_validate_json(json.dumps(given, default=str))
    return {name: getattr(checked, name) for name in checked.model_fields_set}


def _checked(annotation: Any) -> Any:
    return Annotated[Any, PlainValidator(_rows)] if annotation == ArrayLike else annotation


def _rows(value: Any) -> Any:
    """Return `value` if it is a number, a list of numbers or a list of equally long ones, all finite."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    rows = [value] if is_number else value if isinstance(value, list) else None
    flat = [number for row in rows or [] for number in (row if isinstance(row, list) else [row])]
    are_numbers = all(
        isinstance(n, int | float) and not isinstance(n, bool) and np.isfinite(n) for n in flat
    )
    lengths = {len(row) if isinstance(row, list) else 0 for row in rows or []}
    if not flat or not are_numbers or len(lengths) > 1:
        raise PydanticCustomError("rows", "wanted finite numbers, or rows of them equally long")
    return value
