"""Proposal for a step function, from its file's declarations and a few trial runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.function import PythonDefinition, StartSampling
from neuroanimator.errors import BadFileError
from neuroanimator.files.tables import check_table
from neuroanimator.learn.data.config import RUN_STEPS, USUAL_COUNT, USUAL_SAMPLES_PER_RUN
from neuroanimator.physics.functions.function_system import FUNCTION, PythonSystem, are_too_large
from neuroanimator.physics.functions.step_file import run_file
from neuroanimator.physics.recorded.rates import rate_entries
from neuroanimator.scaffold.declarations import Declarations, read_declarations
from neuroanimator.scaffold.defaults import (
    ANGLE_SPREAD,
    BEARABLE,
    FASTEST,
    FINE_PARTS,
    MAX_TEACHER_ERROR,
    MAX_TURN,
    MIN_CHANGE,
    PART_TITLES,
    SHARES,
    SHORT_SUPER_STEP,
    WANTED_SUPER_STEP,
    proposed_substeps,
    rounded,
    usual_name,
)
from neuroanimator.scaffold.proposal import Proposal
from neuroanimator.scaffold.scales import (
    MAX_CHANGE,
    MAX_SUBSTEPS,
    fastest_rate,
    refuse_large,
    warn_of_small,
)
from neuroanimator.scaffold.structure import (
    States,
    placeless_entries,
    turning_entries,
)
from neuroanimator.state.layout import entry_units
from neuroanimator.state.rotation import wrapped
from neuroanimator.systems.system import Scheme
from neuroanimator.systems.trusted_files import digest_of
from neuroanimator.terminal import progress_bar
from neuroanimator.text import listed

TEACHER_PARTS = (1, 2, 5, 10)
"""Numbers of parts into which the user's step is divided for the teacher: the first with a small enough error is used."""

TRIAL_RUNS = 8
"""Number of trial runs, which show the range of the state; each starts elsewhere."""

TRIAL_STEPS = 25
"""Number of super steps in a trial run, each under another random control."""

TRIAL_SEED = 0
"""Seed of trial runs, so that a proposal is the same every time."""

MAX_TRIAL_SECONDS = 1.0
"""Approximate maximum time of trial runs [s]: those of a slow function are shorter."""

MAX_SLOW_STATES = 30
"""Number of states examined in a slow function's trial runs."""

MIN_TRIAL_STEPS = 3
"""Minimum number of super steps in a trial run."""

SLOW_CALL = 1e-3
"""Time of a call at which a function counts as slow [s]."""

TIMED = 5
"""Number of calls timed; the quickest counts."""

REPEATED = 20
"""Number of states for which the function is called twice."""

TOLERANCES = {"rtol": 1e-9, "atol": 1e-12}
"""Relative and absolute tolerances of equal results: the same sums, perhaps in another order."""

MAX_PLAIN = 1e6
"""Magnitude of states up to which a step cannot overflow: NaN is then the function's own."""

LATER = 5
"""Number of steps after which a control should have had an effect."""

AT_ITS_OWN_STEP = (
    "the function at its own step is the truth. If it integrates an equation, and is more accurate with a smaller dt, "
    "set ODE = True in {file}"
)
"""Note on the teacher's step if the file does not say that it integrates an equation."""


class FunctionTrial(NamedTuple):
    """States of a function's trial runs, each under a control of its own."""

    system: PythonSystem
    states: States
    controls: Float[np.ndarray, "N C"]

    @property
    def dt(self) -> float:
        """Duration of the function's own step [s]."""
        return self.system.physics_dt

    def after(self, states: States, steps: float = 1, parts: int = 1) -> States:
        """Return the states `steps` steps after `states`, each step divided into `parts`."""
        scheme = Scheme(FUNCTION, min(steps, 1) * self.dt / parts)
        held = self.controls[:, None]
        return self.system.simulate(states, held, steps * self.dt, scheme=scheme).states[:, 1]


def propose_function(path: Path) -> Proposal:
    """Return a definition of the step file at `path`; this runs the file.

    The user must have allowed that, see `trust_file`. Raises BadFileError for a missing or wrong
    declaration, a function that diverges, one that returns other results for batches, and one that says ODE and ignores
    dt.
    """
    digest = digest_of(path)
    declared = read_declarations(path, run_file(digest, path.name))
    values = _declared_values(path, declared)
    comments = PART_TITLES | {
        "state.feature": "from calls that differ by a whole turn, or by where a part is",
        "state.rate": "where a step changes one part by dt times another",
        "physics.truth_step": AT_ITS_OWN_STEP.format(file=path.name),
    }

    def system() -> PythonSystem:
        definition = check_table(values, path.name, PythonDefinition)
        return PythonSystem(definition, {"name": path.name, "sha256": digest})

    trial = _run_trial(system())
    _refuse_memory(trial)
    refuse_large(path.name, trial.system.state.names, trial.states)
    _fill_structure(values["state"], trial, declared)
    trial, told = _slow_enough(values, system)
    if told:
        comments["control.low"] = told
    if not declared.SPREAD:
        _fill_spread(values["state"], trial)
        comments["state.spread"] = "as far as trial runs went; SPREAD in the file is better"
        trial = _run_trial(system())
    values["substeps"], comments["substeps"] = _substeps(trial)
    if _takes_batches(trial, declared) and not declared.BATCHED:
        values["batched"] = True
        comments["batched"] = "from calls: (S, B) arrays give the same results as (S,)"
    if declared.ODE:
        parts, error = _teacher(trial)
        values["physics"]["truth_step"] = declared.STEP / parts
        values["physics"]["fine_step"] = declared.STEP / FINE_PARTS
        comments["physics.truth_step"] = (
            f"{path.name} says ODE; teaches with an error of {error:.2g} of a step's change"
        )
    warnings = tuple(_warnings(trial, values))
    if told:
        warnings = (f"control: {told}.", *warnings)
    definition = check_table(values, path.name, PythonDefinition)
    return Proposal(definition, comments, tuple(declared.STATE), warnings)


def _declared_values(path: Path, declared: Declarations) -> dict[str, Any]:
    """Return the definition's table as far as the file itself gives it."""
    step = declared.STEP
    control = []
    for name, (unit, low, high) in declared.CONTROL.items():
        control.append({"name": name, "unit": unit, "low": low, "high": high})
    return {
        "name": usual_name(path),
        "kind": "python",
        "file": path.name,
        "batched": bool(declared.BATCHED),
        "substeps": proposed_substeps(step),
        "physics": {"step": step, "truth_step": step, "fine_step": step},
        "state": declared.parts(),
        "control": control,
        "sampling": StartSampling().model_dump(),
        "parameters": declared.parameters(),
    }


def _fill_structure(
    parts: list[dict[str, Any]], trial: FunctionTrial, declared: Declarations
) -> None:
    """Fill in from trial calls what the file does not declare: angles, entries without a fixed origin, and rates."""
    layout = trial.system.state
    units = entry_units(layout)
    is_turning = turning_entries(trial.after, trial.states, units)
    is_placeless = placeless_entries(trial.after, trial.states, units)
    is_angle = np.array(units) == "rad"
    following = trial.after(trial.states)
    change = following - trial.states
    change[:, is_angle] = wrapped(change[:, is_angle])
    following = trial.states + change
    steps = list(np.stack([trial.states, following], axis=1))
    rates = rate_entries(steps, trial.dt, units)
    names = {tuple(_entries(layout.index(name))): name for name in declared.STATE}
    for part in parts:
        entries = layout.index(part["name"])
        if is_placeless[entries].all():
            part["feature"] = "cyclic"
        elif is_turning[entries].all() and not declared.ANGLES:
            part["feature"] = "sine"
            if not any(part["spread"]):
                part["spread"] = [ANGLE_SPREAD] * part["size"]
        if not declared.RATES:
            found = tuple(rates.get(entry, -1) for entry in _entries(entries))
            part["rate"] = names.get(found, "")


def _entries(part: slice) -> range:
    return range(part.start, part.stop)


def _slow_enough(
    values: dict[str, Any], system: Callable[[], PythonSystem]
) -> tuple[FunctionTrial, str]:
    """Narrow the controls until angles turn no faster than is learnt, and return (trial runs, what to tell of it).

    If the smallest share does not do, they keep their range.
    """
    whole = values["control"]
    first = _run_trial(system())
    name, speed = _fastest_turning(first)
    fast = f"{name} turns at {speed:.2g} rad/s in trial runs, too fast to learn well"
    if _is_slow(first):
        return first, ""
    with progress_bar("shares of the controls tried", len(SHARES)) as bar:
        for number, share in enumerate(SHARES[1:], 1):
            bar.advance_to(number)
            values["control"] = [_narrowed(part, share) for part in whole]
            trial = _run_trial(system())
            if _is_slow(trial):
                return (
                    trial,
                    f"at full range {fast}; {share:.3g} of it is proposed, widen it if needed",
                )
    values["control"] = whole
    return (
        first,
        f"{fast}, even with {SHARES[-1]:.3g} of the range. Add damping, or use a smaller SPREAD",
    )


def _is_slow(trial: FunctionTrial) -> bool:
    """Return whether angles turn slowly enough for a short super step."""
    _, speed = _fastest_turning(trial)
    return speed * max(trial.dt, SHORT_SUPER_STEP) <= BEARABLE * MAX_TURN


def _narrowed(part: dict[str, Any], share: float) -> dict[str, Any]:
    """Return a part of the control with `share` of its range, around the middle."""
    low = np.array(part["low"])
    high = np.array(part["high"])
    room = (1 - share) / 2 * (high - low)
    return part | {"low": tuple((low + room).tolist()), "high": tuple((high - room).tolist())}


def _fastest_turning(trial: FunctionTrial) -> tuple[str, float]:
    """Return (name of the angle that turns fastest, its speed [rad/s]); an empty name and 0 if none turns."""
    entries = [row.index(1) for row in trial.system.structure.angles]
    if not entries:
        return "", 0.0
    turns = np.abs(wrapped((trial.after(trial.states) - trial.states)[:, entries]))
    speeds = np.percentile(turns, FASTEST, axis=0) / trial.dt
    fastest = int(np.argmax(speeds))
    return trial.system.state.names[entries[fastest]], float(speeds[fastest])


def _fill_spread(parts: list[dict[str, Any]], trial: FunctionTrial) -> None:
    """Fill in unknown spreads by the distances of trial runs from rest: twice the rms, two digits."""
    system = trial.system
    reach = 2 * np.sqrt(np.mean((trial.states - system.rest) ** 2, axis=0))
    widths = np.where(system.spread > 0, system.spread, reach)
    for part in parts:
        part["spread"] = [rounded(width, 2) for width in widths[system.state.index(part["name"])]]


def _substeps(trial: FunctionTrial) -> tuple[int, str]:
    """Return the proposed number of steps in a super step, and the reason.

    No angle should turn too far in it, and the fastest motion of a slow system should go only a little way.
    """
    substeps = proposed_substeps(trial.dt)
    if trial.dt > WANTED_SUPER_STEP:
        rate = fastest_rate(trial.after, trial.states, trial.dt)
        substeps = 1
        if rate > 0:
            substeps = int(np.clip(MAX_CHANGE / (rate * trial.dt), 1, MAX_SUBSTEPS))
    name, speed = _fastest_turning(trial)
    if not name:
        return substeps, f"a super step of {substeps * trial.dt:g} s"
    turn = speed * trial.dt
    if turn > 0:
        substeps = max(1, min(substeps, int(MAX_TURN / turn)))
    return substeps, (
        f"a super step of {substeps * trial.dt:g} s, in which angles turn by up to {substeps * turn:.2g} rad"
    )


def _teacher(trial: FunctionTrial) -> tuple[int, float]:
    """Return the number of parts of the teacher's step, and its error; refuse a function that ignores dt."""
    states = trial.states
    if np.array_equal(trial.after(states), trial.after(states, 0.5)):
        raise BadFileError(
            f"{trial.system.file}: ODE: step gives the same result for every dt. Leave ODE out, or use dt in step."
        )
    exact = trial.after(states, parts=FINE_PARTS)
    unit = np.maximum((exact - states).std(axis=0), MIN_CHANGE)
    for parts in TEACHER_PARTS:
        errors = (trial.after(states, parts=parts) - exact) / unit
        rms_error = float(np.sqrt(np.mean(errors**2)))
        if rms_error <= MAX_TEACHER_ERROR:
            return parts, rms_error
    return FINE_PARTS, 0.0


def _warnings(trial: FunctionTrial, values: dict[str, Any]) -> Iterator[str]:
    """Yield warnings for the user, one line each."""
    system = trial.system
    states = trial.states
    substeps = values["substeps"]
    is_still = (trial.after(states) == states).all(axis=0)
    is_still[system.parameter_entries] = False
    still = [system.state.names[entry] for entry in np.flatnonzero(is_still)]
    if still:
        yield f"state: {listed(still)} never change. Leave them out of STATE, or check step."
    following = trial.after(states, substeps)
    is_whole = ~are_too_large(following)
    yield from warn_of_small(system.state.names, (following - states)[is_whole])
    side = np.where(trial.controls < system.bounds.middle, 0.5, -0.5)
    other = trial._replace(controls=trial.controls + side * system.bounds.half)
    if np.array_equal(other.after(states, LATER), trial.after(states, LATER)):
        yield "control: nothing that step returns depends on it. Check step."
    seconds = _seconds_per_call(system)
    if seconds > SLOW_CALL and not values["batched"]:
        parts = round(values["physics"]["step"] / values["physics"]["truth_step"])
        runs = USUAL_COUNT / USUAL_SAMPLES_PER_RUN
        hours = runs * RUN_STEPS * substeps * parts * seconds / 3600
        yield (
            f"step takes {seconds * 1e3:.2g} ms: {USUAL_COUNT:,} transitions take about {hours:.2g} hours. Write it for (S, B) "
            "arrays, or make fewer: neuroanimator generate --count."
        )


def _run_trial(system: PythonSystem) -> FunctionTrial:
    """Return the states and controls of all steps of trial runs under random controls; fewer if a call takes long."""
    rng = np.random.default_rng(TRIAL_SEED)
    starts = system.sample_starts(rng, TRIAL_RUNS)
    substeps = proposed_substeps(system.physics_dt)
    seconds = _seconds_per_call(system)
    steps = TRIAL_STEPS
    if seconds >= SLOW_CALL:  # the same number however busy the machine is
        affordable = int(MAX_TRIAL_SECONDS / (seconds * TRIAL_RUNS * substeps))
        steps = max(MIN_TRIAL_STEPS, min(TRIAL_STEPS, affordable))
    shape = (TRIAL_RUNS, steps, system.control.size)
    controls = system.bounds.middle + rng.uniform(-1, 1, shape) * system.bounds.half
    runs = system.simulate(starts, controls, substeps * system.physics_dt, scheme=system.scheme)
    is_whole = ~runs.has_diverged
    if is_whole.sum() < TRIAL_RUNS / 2:
        _refuse_nan(system, starts, np.repeat(controls, substeps, axis=1))
        raise BadFileError(
            f"{system.file}: {runs.has_diverged.sum()} of {TRIAL_RUNS} trial runs under random controls diverged. "
            "Use a smaller STEP, a smaller SPREAD or weaker CONTROL."
        )
    states = runs.states[is_whole, :-1].reshape(-1, system.state.size)
    held = controls[is_whole].reshape(-1, system.control.size)
    every = 1
    if steps < TRIAL_STEPS:
        every = -(-len(states) // MAX_SLOW_STATES)
    return FunctionTrial(system, states[::every], held[::every])


def _refuse_nan(system: PythonSystem, starts: States, controls: Float[np.ndarray, "B T C"]) -> None:
    """Raise BadFileError if the function returns NaN for an ordinary state on the way from one of `starts`."""
    for start, held in zip(starts, controls, strict=True):
        state = start
        for control in held:
            if are_too_large(state) or np.abs(state).max() > MAX_PLAIN:
                break
            following = system.next_state(state, control, system.physics_dt)
            if np.isnan(following).any():
                entry = int(np.argmax(np.isnan(following)))
                shown = np.array2string(
                    state, precision=4, threshold=8, edgeitems=4, separator=", "
                )
                raise BadFileError(
                    f"{system.file}: step returns NaN for {system.state.names[entry]} in the state {shown}. "
                    "Correct the function, or use a smaller SPREAD."
                )
            state = following


def _refuse_memory(trial: FunctionTrial) -> None:
    """Raise BadFileError for a function with two results for the same arguments: it has memory, or is random."""
    system = trial.system
    asked = list(zip(trial.states[:REPEATED], trial.controls[:REPEATED], strict=True))
    first = [system.next_state(*question, system.physics_dt) for question in asked]
    again = [system.next_state(*question, system.physics_dt) for question in reversed(asked)]
    for one, other in zip(first, reversed(again), strict=True):
        if not np.allclose(one, other, **TOLERANCES, equal_nan=True):
            entry = int(np.argmax(np.abs(one - other)))
            raise BadFileError(
                f"{system.file}: step returns both {one[entry]:.6g} and {other[entry]:.6g} for "
                f"{system.state.names[entry]}, from the same state and control. It must keep nothing between "
                "calls and use no random numbers."
            )


def _takes_batches(trial: FunctionTrial, declared: Declarations) -> bool:
    """Return whether the function takes batches; BadFileError if it says so and returns other results for them."""
    if declared.BATCHED is False:
        return False
    system = trial.system
    singly = [
        system.next_state(*question, system.physics_dt)
        for question in zip(trial.states, trial.controls, strict=True)
    ]
    try:
        together = system.next_state(trial.states.T, trial.controls.T, system.physics_dt)
    except BadFileError:
        # If it says that it takes batches, an error in the function itself is reported as such.
        if declared.BATCHED:
            raise
        return False
    is_same = np.allclose(np.stack(singly), together.T, **TOLERANCES, equal_nan=True)
    if declared.BATCHED and not is_same:
        raise BadFileError(
            f"{system.file}: BATCHED: step gives other results for (S, B) arrays than for (S,). Leave it out."
        )
    return is_same


def _seconds_per_call(system: PythonSystem) -> float:
    """Return the time of one call of the function for one state [s]."""
    best = float("inf")
    for _ in range(TIMED):
        began = time.perf_counter()
        system.next_state(system.rest, system.bounds.middle, system.physics_dt)
        best = min(best, time.perf_counter() - began)
    return best
