"""Propose a definition for recordings: what their columns say, and what their numbers show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.data.config import window_length
from neuroanimator.data.recorded_noise import noise_of
from neuroanimator.data.recorded_segments import split_runs
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.errors import BadFileError
from neuroanimator.scaffold.defaults import FASTEST, MAX_TURN, proposed_substeps, usual_name
from neuroanimator.scaffold.scales import refuse_large, warn_of_small
from neuroanimator.scaffold.time_scales import (
    MAX_SUBSTEPS,
    is_slow,
    share_of_noise,
    slow_substeps,
    substeps_through_noise,
)
from neuroanimator.state.units import rate_unit
from neuroanimator.systems.recorded.recording import Recording, read_recording
from neuroanimator.systems.trusted_files import digest_of
from neuroanimator.tables import check_table
from neuroanimator.text import listed

HALF_TURN = np.pi
"""An angle that covers more than this [rad] is represented by its sine and cosine."""

RATE_ERROR = 0.15
"""A column is taken for another's rate if what it adds up to is off by less than this share of that one's change."""

SPANS = (1, 2, 5, 10, 20, 50)
"""Numbers of samples over which changes are compared: noise stays as it is, and the change grows."""

MAX_TURN_THROUGH_NOISE = 2 * MAX_TURN
"""Maximum turn of angles in a super step [rad] where noise hides what happens in a shorter one."""

MAX_TURN_BETWEEN_SAMPLES = 0.7 * np.pi
"""Turn of an angle from one sample to the next that is near half a turn [rad]."""

TOLD_NOISE = 0.05
"""Noise that makes more than this share of the changes in a super step is worth a word."""

USUAL_SHARE = 99
"""Samples within this percentile of all distances from the middle are what usually occurs."""

FAR_OUT = 10
"""Multiple of the usual distance at which a sample is worth a word."""

MIN_CHANGES = 8
"""Minimum number of changes in the recordings for a span to count."""


def propose_recording(
    path: Path,
) -> tuple[RecordedDefinition, dict[str, str], tuple[str, ...]]:
    """Return a definition of the recordings at `path`, notes on its keys, and what to look at.

    The user must have allowed the file to be opened, see `trust_file`. Raises BadFileError for a
    control that never changes, and for recordings in which nothing moves.
    """
    digest = digest_of(path)
    recording = read_recording(digest, path.name)
    _refuse_standstill(recording, path)
    runs = _unwrapped(recording)
    rates = _rates(recording, runs)
    state = []
    for entry in range(len(recording.state)):
        state.append(_state_part(recording, entry, rates.get(entry)))
    control = []
    for entry in range(len(recording.control)):
        control.append(_control_part(recording, entry, path))
    refuse_large(path.name, _names(recording), np.concatenate(recording.states))
    substeps, note = _substeps(recording, runs, state)
    rest = _stillest(recording, runs, substeps)
    rest_note = "where the recordings are stillest"
    if not control:
        rest = recording.states[0][0]
        rest_note = "where the recordings begin, for nothing drives what is recorded"
    for part, number in zip(state, rest, strict=True):
        part["rest"] = [float(f"{number:.6g}")]
    values = {
        "name": usual_name(path),
        "kind": "recorded",
        "file": path.name,
        "substeps": substeps,
        "physics": {"step": recording.step},
        "state": state,
        "control": control,
    }
    notes = {
        "substeps": note,
        "physics.step": f"the sampling interval [s]; {len(recording.states)} runs",
        "state.rate": "where one column adds up to another's changes, noise left aside",
        "state.rest": f"{rest_note}; motions begin there if nothing else is said",
    }
    definition = check_table(values, path.name, RecordedDefinition)
    return definition, notes, tuple(_warnings(recording, runs, state, substeps))


def _refuse_standstill(recording: Recording, path: Path) -> None:
    """Raise BadFileError if no state column ever changes."""
    if all(np.ptp(_column(recording, entry)) == 0 for entry in range(len(recording.state))):
        raise BadFileError(
            f"{path.name}: the state is the same in every row, so there is no motion to learn. Record while it moves."
        )


def _names(recording: Recording) -> list[str]:
    """Return the names of the state columns, with units."""
    return [f"{name} {unit}" for name, unit in recording.state]


def _column(recording: Recording, entry: int) -> Float[np.ndarray, " N"]:
    """Return a state column, all runs one after the other."""
    return np.concatenate([states[:, entry] for states in recording.states])


def _warnings(
    recording: Recording,
    runs: list[Float[np.ndarray, "_ S"]],
    state: Sequence[dict[str, Any]],
    substeps: int,
) -> Iterator[str]:
    """Yield what the user should look at, one line each."""
    still = []
    for entry, (name, _) in enumerate(recording.state):
        if np.ptp(_column(recording, entry)) == 0:
            still.append(f"state.{name}")
    if still:
        yield f"{listed(still)}: the same in every row, so nothing can be learned of it. Remove the column."
    yield from _outliers(recording)
    yield from _fast_turns(recording, runs, state)
    yield from _short_runs(recording, window_length(substeps))
    changes = [_changes(runs, entry, substeps) for entry in range(len(recording.state))]
    yield from warn_of_small(_names(recording), np.stack(changes, axis=1))


def _stillest(
    recording: Recording, runs: list[Float[np.ndarray, "_ S"]], span: int
) -> Float[np.ndarray, " S"]:
    """Return the recorded state from which least changes over `span` samples, each number by its own measure."""
    before = np.concatenate([states[:-span] for states in recording.states])
    changes = np.concatenate([states[span:] - states[:-span] for states in runs])
    usual = changes.std(axis=0)
    moves = usual > 0
    unrest = ((changes[:, moves] / usual[moves]) ** 2).sum(axis=1)
    return before[int(np.argmin(unrest))]


def _fast_turns(
    recording: Recording, runs: list[Float[np.ndarray, "_ S"]], state: Sequence[dict[str, Any]]
) -> Iterator[str]:
    """Yield a line for each angle that turns so far between two samples that nobody can tell which way."""
    for entry, part in enumerate(state):
        if part["feature"] != "sine":
            continue
        turn = float(np.percentile(np.abs(_changes(runs, entry, 1)), FASTEST))
        if turn > MAX_TURN_BETWEEN_SAMPLES:
            yield (
                f"state.{part['name']}: turns by {turn:.2g} rad and more between two samples, and half a turn one way looks like "
                "half a turn the other way. Sample faster."
            )


def _outliers(recording: Recording) -> Iterator[str]:
    """Yield a line for each state column in which a few samples lie far from all others: a sensor may have failed."""
    # As they are in the file: an angle far out would be taken for one that has turned often.
    states = np.concatenate(recording.states)
    for entry, (name, unit) in enumerate(recording.state):
        distance = np.abs(states[:, entry] - np.median(states[:, entry]))
        usual = float(np.percentile(distance, USUAL_SHARE))
        count = int((distance > FAR_OUT * usual).sum())
        if not usual or not count:
            continue
        farthest = int(np.argmax(distance))
        yield (
            f"state.{name}: {count} of {len(states)} samples lie more than {FAR_OUT} times as far out as {USUAL_SHARE} % do, "
            f"such as {states[farthest, entry]:.4g} {unit} in {recording.where(farthest)}. Correct them, or cut them out."
        )


def _short_runs(recording: Recording, length: int) -> Iterator[str]:
    """Yield a line if there are runs shorter than `length` samples, which nothing can be learned from."""
    short = [run for run, states in enumerate(recording.states) if len(states) < length]
    if short:
        first = short[0]
        yield (
            f"{len(short)} of {len(recording.states)} runs are left out, for they have fewer than {length} rows, such as the "
            f"{len(recording.states[first])} from {recording.origins[first]} on. Record longer, or use a smaller substeps."
        )


def _unwrapped(recording: Recording) -> list[Float[np.ndarray, "_ S"]]:
    """Return each run's states; angles go on where the recording has them jump by a whole turn."""
    is_angle = np.array([unit == "rad" for _, unit in recording.state])
    runs = []
    for states in recording.states:
        continuous = states.copy()
        continuous[:, is_angle] = np.unwrap(states[:, is_angle], axis=0)
        runs.append(continuous)
    return runs


def _substeps(
    recording: Recording, runs: list[Float[np.ndarray, "_ S"]], state: list[dict[str, Any]]
) -> tuple[int, str]:
    """Return how many samples a super step should have, and why: no angle should turn too far in it, nor noise hide it."""
    noise = noise_of(runs, recording.controls)
    substeps = proposed_substeps(recording.step)
    if is_slow(recording.step):
        substeps = slow_substeps(runs, noise, substeps)
    turning = [entry for entry, part in enumerate(state) if part["feature"] == "sine"]
    turn = 0.0
    for entry in turning:
        # Over the whole super step: noise between two samples is no motion.
        changes = _changes(runs, entry, substeps)
        if len(changes):
            fastest = float(np.percentile(np.abs(changes), FASTEST))
            turn = max(turn, fastest / substeps)
    most = MAX_SUBSTEPS
    if turn > 0:
        substeps = max(1, min(substeps, int(MAX_TURN / turn)))
        most = max(1, int(MAX_TURN_THROUGH_NOISE / turn))
    substeps = substeps_through_noise(runs, noise, substeps, most)
    rows = [len(states) for states in runs]
    substeps = _largest_for(recording.file, rows, substeps)
    note = f"samples; a super step of {substeps * recording.step:g} s"
    if turning:
        note += f", in which angles turn by up to {substeps * turn:.2g} rad"
    hidden = share_of_noise(runs, noise, substeps)
    if hidden > TOLD_NOISE:
        note += f"; {hidden:.2g} of the changes in it are noise"
    return substeps, note


def _largest_for(file: str, rows: list[int], most: int) -> int:
    """Return the largest number of samples a super step may have, up to `most`, so that enough is left to test on.

    Raises BadFileError if the recordings are too short for any.
    """
    for substeps in range(most, 1, -1):
        try:
            split_runs(file, rows, window_length(substeps))
        except BadFileError:
            continue
        return substeps
    split_runs(file, rows, window_length(1))
    return 1


def _state_part(recording: Recording, entry: int, rate_entry: int | None) -> dict[str, Any]:
    """Return the TOML table of one state column, whose rate of change is the column `rate_entry`."""
    name, unit = recording.state[entry]
    column = _column(recording, entry)
    is_full_turn = unit == "rad" and np.ptp(column) > HALF_TURN
    feature = "plain"
    if is_full_turn:
        feature = "sine"
    rate = ""
    if rate_entry is not None:
        rate, _ = recording.state[rate_entry]
    return {
        "name": name,
        "unit": unit,
        "feature": feature,
        "rate": rate,
    }


def _control_part(recording: Recording, entry: int, path: Path) -> dict[str, Any]:
    """Return the TOML table of one control column."""
    name, unit = recording.control[entry]
    column = np.concatenate([controls[:, entry] for controls in recording.controls])
    if np.ptp(column) == 0:
        raise BadFileError(
            f"{path.name}: control.{name} never changes, so nothing can be learned of it. Remove the column, or record "
            "while it changes."
        )
    low = float(column.min())
    high = float(column.max())
    return {"name": name, "unit": unit, "low": [low], "high": [high]}


def _rates(recording: Recording, runs: list[Float[np.ndarray, "_ S"]]) -> dict[int, int]:
    """Return {entry: the entry that is its rate of change}, where units and numbers agree."""
    rates: dict[int, int] = {}
    for entry, (_, unit) in enumerate(recording.state):
        best = RATE_ERROR
        for other, (_, other_unit) in enumerate(recording.state):
            if other_unit != rate_unit(unit):
                continue
            error = _rate_error(runs, recording.step, entry, other)
            if error < best:
                best = error
                rates[entry] = other
    return rates


def _rate_error(runs: list[Float[np.ndarray, "_ S"]], step: float, entry: int, other: int) -> float:
    """Return how far what one entry adds up to is off the other's changes, as a share of these; the least of `SPANS`.

    Infinite if the recordings are too short to tell, or if nothing changes.
    """
    sums = []
    for states in runs:
        means = (states[1:, other] + states[:-1, other]) / 2
        total = np.concatenate([[0.0], np.cumsum(means)]) * step
        sums.append(total[:, None])
    errors = [float("inf")]
    for span in SPANS:
        changes = _changes(runs, entry, span)
        added = _changes(sums, 0, span)
        rms = np.sqrt(np.mean(added**2)) if len(added) >= MIN_CHANGES else 0.0
        if rms > 0:
            errors.append(float(np.sqrt(np.mean((changes - added) ** 2)) / rms))
    return min(errors)


def _changes(
    runs: list[Float[np.ndarray, "_ S"]], entry: int, span: int
) -> Float[np.ndarray, " N"]:
    """Return by how much an entry changes over `span` samples, wherever a run is long enough."""
    changes = [states[span:, entry] - states[:-span, entry] for states in runs]
    return np.concatenate(changes)
