"""Propose a definition for a step function: what its file declares, and what a few trial runs show."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.function import MAX_STEP, PythonDefinition, StartSampling
from neuroanimator.errors import BadFileError
from neuroanimator.parsing.names import PART_PATTERN
from neuroanimator.parsing.numbers import MIN_STEP
from neuroanimator.scaffold.defaults import (
    ANGLE_SPREAD,
    FASTEST,
    MAX_TEACHER_ERROR,
    MAX_TURN,
    proposed_substeps,
    usual_name,
)
from neuroanimator.scaffold.scales import refuse_large, warn_of_small
from neuroanimator.scaffold.step_checks import (
    SLOW_CALL,
    refuse_memory,
    refuse_nan,
    seconds_of_data,
    seconds_per_call,
    takes_batches,
)
from neuroanimator.scaffold.step_structure import (
    placeless_entries,
    rate_entries,
    turning_entries,
    wrapped,
)
from neuroanimator.scaffold.time_scales import MAX_CHANGE, MAX_SUBSTEPS, fastest_rate, is_slow
from neuroanimator.systems.functions.function_system import PythonSystem
from neuroanimator.systems.functions.step_file import call_step, run_file
from neuroanimator.systems.system import Scheme
from neuroanimator.systems.trusted_files import digest_of
from neuroanimator.tables import check_table
from neuroanimator.text import listed

FINE_PARTS = 10
"""The fine step, which every error is measured against, is the user's step cut into this many."""

TEACHER_PARTS = (1, 2, 5, 10)
"""The teacher's step is the user's, cut into the first of these numbers of parts whose error is small enough."""

TRIAL_RUNS = 8
"""This many trial runs show how far the state goes; each starts elsewhere."""

TRIAL_STEPS = 25
"""A trial run has this many super steps, each under another random control."""

TRIAL_SEED = 0
"""Trial runs are drawn with this seed, so that a proposal is the same every time."""

MIN_CHANGE = 1e-9
"""An entry that changes less than this in a step does not count by more than its difference over this."""

MAX_TRIAL_SECONDS = 1.0
"""Trial runs of a slow function are shorter, so that they take about this long [s]."""

MAX_SLOW_STATES = 30
"""Number of states looked at of a slow function's trial runs."""

MIN_TRIAL_STEPS = 3
"""Minimum length, in super steps."""

MAX_SHOWN = 60
"""An error shows at most this many characters of a wrong declaration."""

AT_ITS_OWN_STEP = (
    "the function at its own step is the truth. Where it integrates an equation and is the better the smaller dt is, "
    "say ODE = True in {file}"
)
"""This note stands at the teacher's step if the file does not say that it integrates an equation."""

EXAMPLES = {
    "STEP": "STEP = 0.01",
    "STATE": 'STATE = {"angle": "rad", "speed": "rad/s"}',
    "CONTROL": 'CONTROL = {"torque": ("N·m", -2.0, 2.0)}',
    "ANGLES": 'ANGLES = ["angle"]',
    "RATES": 'RATES = {"angle": "speed"}',
    "REST": 'REST = {"angle": 0.0}',
    "SPREAD": 'SPREAD = {"angle": 3.14, "speed": 4.0}',
    "ODE": "ODE = True",
}
"""Each declaration is shown by its example in the error about it."""


def propose_function(path: Path) -> tuple[PythonDefinition, dict[str, str], tuple[str, ...]]:
    """Return a definition of the step file at `path` and notes on its keys; this runs the file.

    The user must have allowed that, see `trust_file`. Raises BadFileError for a missing or wrong
    declaration, a function that diverges, one that answers batches otherwise, and one that says ODE
    and ignores dt.
    """
    digest = digest_of(path)
    module = run_file(digest, path.name)
    files = {"name": path.name, "sha256": digest}
    values = _declared(path, module)
    notes: dict[str, str] = {}
    system = PythonSystem(_check(values, path), files)
    states, controls = _trial(system)
    refuse_memory(system, states, controls)
    refuse_large(path.name, system.state.names, states)
    _see_structure(system, module, values, notes)
    system = PythonSystem(_check(values, path), files)
    if not getattr(module, "SPREAD", None):
        widths = _spread_of_trials(system)
        for part, width in zip(values["state"], widths, strict=True):
            part["spread"] = width
        notes["state.spread"] = "as far as trial runs went; SPREAD in the file says it better"
        system = PythonSystem(_check(values, path), files)
    values["substeps"], notes["substeps"] = _substeps(system)
    system = PythonSystem(_check(values, path), files)
    if _see_batches(system, module) and not system.batched:
        values["batched"] = True
        notes["batched"] = "seen by calls: it answers (S, B) arrays as it answers (S,)"
        system = PythonSystem(_check(values, path), files)
    notes["physics.truth_step"] = AT_ITS_OWN_STEP.format(file=path.name)
    if _is_ode(path, module):
        parts, error = _teacher(system)
        step = values["physics"]["step"]
        values["physics"]["truth_step"] = step / parts
        values["physics"]["fine_step"] = step / FINE_PARTS
        notes["physics.truth_step"] = (
            f"{path.name} says ODE; teaches with an error of {error:.2g} of a step's change"
        )
    definition = _check(values, path)
    return definition, notes, tuple(_warnings(system, definition.substeps))


def _see_structure(
    system: PythonSystem, module: ModuleType, values: dict[str, Any], notes: dict[str, str]
) -> None:
    """Fill in what trial calls show and the file does not declare: angles, what may stand anywhere, and rates."""
    states, controls = _trial(system)
    units = []
    for part in system.state.slices:
        units += [part.unit] * part.size

    def step(states: Float[np.ndarray, "N S"]) -> Float[np.ndarray, "N S"]:
        runs = system.simulate(states, controls[:, None], system.physics_dt, scheme=system.scheme)
        return runs.states[:, 1]

    is_turning = turning_entries(step, states, units)
    is_placeless = placeless_entries(step, states, units)
    rates = rate_entries(states, step(states), system.physics_dt, units)
    for part in values["state"]:
        entries = system.state.index(part["name"])
        is_given = part["feature"] != "plain" or getattr(module, "ANGLES", ())
        if is_placeless[entries].all():
            part["feature"] = "cyclic"
        elif is_turning[entries].all() and not is_given:
            part["feature"] = "sine"
            part["spread"] = (
                part["spread"] if any(part["spread"]) else [ANGLE_SPREAD] * part["size"]
            )
        if not part["rate"] and not getattr(module, "RATES", None):
            part["rate"] = _rate_part(system, entries, rates)
    notes["state.feature"] = "from calls that differ by a whole turn, or by where a part is"
    notes["state.rate"] = "where a step changes one part by dt times another"


def _rate_part(system: PythonSystem, entries: slice, rates: dict[int, int]) -> str:
    """Return the part whose entries, in order, are the rates of those at `entries`; empty if none is."""
    found = [rates.get(entry) for entry in range(entries.start, entries.stop)]
    for part in system.state.slices:
        place = system.state.index(part.name)
        if found == list(range(place.start, place.stop)):
            return part.name
    return ""


def _substeps(system: PythonSystem) -> tuple[int, str]:
    """Return how many steps a super step should have, and why: no angle should turn too far in it."""
    substeps = proposed_substeps(system.physics_dt)
    entries = [row.index(1) for row in system.structure.angles]
    if is_slow(system.physics_dt):
        substeps = _slow_substeps(system)
    if not entries:
        return substeps, f"a super step of {substeps * system.physics_dt:g} s"
    states, controls = _trial(system)
    runs = system.simulate(states, controls[:, None], system.physics_dt, scheme=system.scheme)
    turns = np.abs(wrapped((runs.states[:, 1] - states)[:, entries]))
    turn = float(np.percentile(turns, FASTEST, axis=0).max())
    if turn > 0:
        substeps = max(1, min(substeps, int(MAX_TURN / turn)))
    return substeps, (
        f"a super step of {substeps * system.physics_dt:g} s, in which angles turn by up to {substeps * turn:.2g} rad"
    )


def _slow_substeps(system: PythonSystem) -> int:
    """Return how many steps of something slow a super step should have: in it the fastest motion goes only a little way."""
    states, controls = _trial(system)

    def step(states: Float[np.ndarray, "N S"]) -> Float[np.ndarray, "N S"]:
        runs = system.simulate(states, controls[:, None], system.physics_dt, scheme=system.scheme)
        return runs.states[:, 1]

    rate = fastest_rate(step, states, system.physics_dt)
    if rate == 0:
        return 1
    return max(1, min(MAX_SUBSTEPS, int(MAX_CHANGE / (rate * system.physics_dt))))


def _warnings(system: PythonSystem, substeps: int) -> Iterator[str]:
    """Yield what the user should look at, one line each."""
    states, controls = _trial(system)
    runs = system.simulate(states, controls[:, None], system.physics_dt, scheme=system.scheme)
    is_still = (runs.states[:, 1] == states).all(axis=0)
    still = [name for name, stands in zip(system.state.names, is_still, strict=True) if stands]
    if still:
        yield f"state: {listed(still)} never change. Leave them out of STATE, or check step."
    following = system.simulate(
        states, controls[:, None], system.physics_dt * substeps, scheme=system.scheme
    )
    changes = (following.states[:, 1] - states)[~following.has_diverged]
    yield from warn_of_small(system.state.names, changes)
    other = controls + np.where(controls < system.bounds.middle, 0.5, -0.5) * system.bounds.half
    driven = system.simulate(states, other[:, None], system.physics_dt * 5, scheme=system.scheme)
    usual = system.simulate(states, controls[:, None], system.physics_dt * 5, scheme=system.scheme)
    if np.array_equal(driven.states, usual.states):
        yield "control: nothing that step returns depends on it. Check step."
    each = seconds_per_call(system)
    if each > SLOW_CALL and not system.batched:
        hours = seconds_of_data(system, substeps) / 3600
        yield (
            f"step takes {each * 1e3:.2g} ms: 100,000 transitions take about {hours:.2g} hours. Write it for (S, B) arrays, "
            "or make fewer: neuroanimator generate --count."
        )


def _check(values: dict[str, Any], path: Path) -> PythonDefinition:
    return check_table(values, path.name, PythonDefinition)


def _declared(path: Path, module: ModuleType) -> dict[str, Any]:
    """Return the definition's table as far as the file itself says it."""
    step = _declaration(path, module, "STEP", (int, float))
    if not MIN_STEP <= step <= MAX_STEP:
        raise BadFileError(
            f"{path.name}: STEP: wanted {MIN_STEP:g} to {MAX_STEP:g} s, came {step:g}."
        )
    state = _declaration(path, module, "STATE", dict)
    control = _declaration(path, module, "CONTROL", dict)
    _refuse_names(path, "STATE", state)
    _refuse_names(path, "CONTROL", control)
    by_part = {}
    for name in ("RATES", "REST", "SPREAD"):
        by_part[name] = _declaration(path, module, name, dict, {})
    angles = _declaration(path, module, "ANGLES", (list, tuple), ())
    for name, parts in by_part.items():
        _refuse_unknown_parts(path, name, parts, state)
    _refuse_unknown_parts(path, "ANGLES", angles, state)
    substeps = proposed_substeps(step)
    state_parts = []
    for name, value in state.items():
        state_parts.append(_state_part(path, name, value, name in angles, by_part))
    control_parts = []
    for name, value in control.items():
        control_parts.append(_control_part(path, name, value))
    return {
        "name": usual_name(path),
        "kind": "python",
        "file": path.name,
        "batched": bool(getattr(module, "BATCHED", False)),
        "substeps": substeps,
        "physics": {"step": step, "truth_step": step, "fine_step": step},
        "state": state_parts,
        "control": control_parts,
        "sampling": StartSampling().model_dump(),
    }


def _refuse_names(path: Path, declaration: str, parts: dict[Any, Any]) -> None:
    """Raise BadFileError for a part that is called what nothing may be called."""
    for name in parts:
        if not isinstance(name, str) or not re.fullmatch(PART_PATTERN, name):
            raise BadFileError(
                f"{path.name}: {declaration}: wanted a name of letters, digits and _ . -, at most 40, beginning with a letter, "
                f"came {repr(name)[:MAX_SHOWN]}."
            )


def _refuse_unknown_parts(path: Path, name: str, parts: Any, state: dict[str, Any]) -> None:
    """Raise BadFileError if the declaration `name` is about a part that STATE does not have."""
    for part in parts:
        if part not in state:
            raise BadFileError(
                f"{path.name}: {name}: no part '{part}' in STATE. Parts: {', '.join(state)}."
            )


def _is_ode(path: Path, module: ModuleType) -> bool:
    """Return whether the file says that its function integrates an equation, the better the smaller dt is."""
    value = getattr(module, "ODE", False)
    if not isinstance(value, bool):
        raise BadFileError(
            f"{path.name}: ODE: wanted a line like `{EXAMPLES['ODE']}`, came {repr(value)[:MAX_SHOWN]}."
        )
    return value


def _declaration(path: Path, module: ModuleType, name: str, kind: Any, default: Any = None) -> Any:
    """Return what the file declares under `name`, of the type `kind`; without a default it must say something."""
    value = getattr(module, name, default)
    is_missing = default is None and not value
    if isinstance(value, bool) or not isinstance(value, kind) or is_missing:
        came = "nothing"
        if value is not None:
            came = repr(value)[:MAX_SHOWN]
        raise BadFileError(
            f"{path.name}: {name}: wanted a line like `{EXAMPLES[name]}`, came {came}."
        )
    return value


def _state_part(
    path: Path, name: str, value: Any, is_angle: bool, by_part: dict[str, Any]
) -> dict[str, Any]:
    """Return the TOML table of the part `name`; STATE gives its unit, or (unit, size)."""
    if isinstance(value, str):
        unit = value
        size = 1
    else:
        unit, size = _unpacked(path, "STATE", value, 2)
    if type(size) is not int:
        raise BadFileError(
            f"{path.name}: STATE: {name}: wanted a unit, or (unit, size), came {value!r}."
        )
    feature = "plain"
    usual_spread = 0.0
    if is_angle:
        feature = "sine"
        usual_spread = ANGLE_SPREAD
    return {
        "name": name,
        "unit": unit,
        "size": size,
        "feature": feature,
        "rate": by_part["RATES"].get(name, ""),
        "rest": _several(by_part["REST"].get(name, 0.0), size),
        "spread": _several(by_part["SPREAD"].get(name, usual_spread), size),
    }


def _control_part(path: Path, name: str, value: Any) -> dict[str, Any]:
    """Return the TOML table of the control `name`; CONTROL gives (unit, low, high)."""
    unit, low, high = _unpacked(path, "CONTROL", value, 3)
    return {"name": name, "unit": unit, "low": _several(low, 1), "high": _several(high, 1)}


def _unpacked(path: Path, name: str, value: Any, count: int) -> Any:
    """Return `value` if it is a tuple or list of `count`; BadFileError shows how `name` is declared."""
    if not isinstance(value, (tuple, list)) or len(value) != count:
        raise BadFileError(
            f"{path.name}: {name}: wanted a line like `{EXAMPLES[name]}`, came {value!r}."
        )
    return value


def _several(value: Any, size: int) -> list[Any]:
    """Return a list: the numbers given, or one number `size` times."""
    if isinstance(value, (list, tuple, np.ndarray)):
        return list(value)
    return [value] * size


@lru_cache(maxsize=2)
def _trial(
    system: PythonSystem,
) -> tuple[Float[np.ndarray, "N S"], Float[np.ndarray, "N C"]]:
    """Return the states and controls of all steps of trial runs under random controls, kept for whoever asks again."""
    rng = np.random.default_rng(TRIAL_SEED)
    starts = system.sample_starts(rng, TRIAL_RUNS)
    substeps = proposed_substeps(system.physics_dt)
    steps = _trial_steps(system, substeps)
    is_shortened = steps < TRIAL_STEPS
    shape = (TRIAL_RUNS, steps, system.control.size)
    controls = system.bounds.middle + rng.uniform(-1, 1, shape) * system.bounds.half
    dt = substeps * system.physics_dt
    runs = system.simulate(starts, controls, dt, scheme=system.scheme)
    is_whole = ~runs.has_diverged
    if is_whole.sum() < TRIAL_RUNS / 2:
        refuse_nan(system, starts, controls, substeps)
        raise BadFileError(
            f"{system.file}: {runs.has_diverged.sum()} of {TRIAL_RUNS} trial runs under random controls diverged. "
            "Use a smaller STEP, a smaller SPREAD or weaker CONTROL."
        )
    states = runs.states[is_whole, :-1].reshape(-1, system.state.size)
    held = controls[is_whole].reshape(-1, system.control.size)
    every = 1
    if is_shortened:
        every = -(-len(states) // MAX_SLOW_STATES)
    return states[::every], held[::every]


def _trial_steps(system: PythonSystem, substeps: int) -> int:
    """Return how many super steps of `substeps` calls a trial run has: fewer where a call takes long."""
    each = seconds_per_call(system)
    if each < SLOW_CALL:  # as many whatever else the machine does
        return TRIAL_STEPS
    affordable = int(MAX_TRIAL_SECONDS / (each * TRIAL_RUNS * substeps))
    return max(MIN_TRIAL_STEPS, min(TRIAL_STEPS, affordable))


def _spread_of_trials(system: PythonSystem) -> list[list[float]]:
    """Return per part how far trial runs went from rest: twice the rms, two digits."""
    states, _ = _trial(system)
    reach = 2 * np.sqrt(np.mean((states - system.rest) ** 2, axis=0))
    widths = np.where(system.spread > 0, system.spread, reach)
    spreads = []
    for part in system.state.slices:
        part_widths = widths[system.state.index(part.name)]
        spreads.append([float(f"{width:.2g}") for width in part_widths])
    return spreads


def _see_batches(system: PythonSystem, module: ModuleType) -> bool:
    """Return whether the function takes batches; BadFileError if it says so and answers them otherwise."""
    states, controls = _trial(system)
    is_batched = takes_batches(system, states, controls)
    if system.batched and not is_batched:
        # An error in the function itself is told as such.
        call_step(system.function, system.file, states.T, controls.T, system.physics_dt)
        raise BadFileError(
            f"{system.file}: BATCHED: step answers (S, B) arrays otherwise than (S,). Leave it out."
        )
    is_declared = hasattr(module, "BATCHED")
    return system.batched if is_declared else is_batched


def _teacher(system: PythonSystem) -> tuple[int, float]:
    """Return (parts of the step that teach well enough, their error); refuse a function that ignores dt."""
    states, controls = _trial(system)
    step = system.physics_dt

    def states_after(parts: int, duration: float = step) -> Float[np.ndarray, "N S"]:
        scheme = Scheme("function", duration / parts)
        runs = system.simulate(states, controls[:, None], duration, scheme=scheme)
        return runs.states[:, 1]

    if np.array_equal(states_after(1), states_after(1, step / 2)):
        raise BadFileError(
            f"{system.file}: ODE: step does the same for every dt. Leave ODE out, or use dt in step."
        )
    exact = states_after(FINE_PARTS)
    unit = np.maximum((exact - states).std(axis=0), MIN_CHANGE)
    for parts in TEACHER_PARTS:
        errors = (states_after(parts) - exact) / unit
        rms_error = float(np.sqrt(np.mean(errors**2)))
        if rms_error <= MAX_TEACHER_ERROR:
            return parts, rms_error
    return FINE_PARTS, 0.0
