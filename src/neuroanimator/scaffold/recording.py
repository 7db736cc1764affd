"""Proposal for recordings, from their columns and numbers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.data.config import window_length
from neuroanimator.data.recorded_noise import noise_of
from neuroanimator.data.recorded_segments import split_runs
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.errors import BadFileError
from neuroanimator.files.tables import check_table
from neuroanimator.scaffold.defaults import (
    FASTEST,
    MAX_TURN,
    PART_TITLES,
    WANTED_SUPER_STEP,
    proposed_substeps,
    rounded,
    usual_name,
)
from neuroanimator.scaffold.proposal import Proposal
from neuroanimator.scaffold.scales import (
    MAX_SUBSTEPS,
    refuse_large,
    share_of_noise,
    slow_substeps,
    substeps_through_noise,
    warn_of_small,
)
from neuroanimator.scaffold.structure import Runs, changes_of, rate_entries
from neuroanimator.systems.recorded.recording import Recording, read_recording
from neuroanimator.systems.trusted_files import digest_of
from neuroanimator.text import listed

MAX_TURN_THROUGH_NOISE = 2 * MAX_TURN
"""Maximum turn of angles in a super step [rad] if noise hides the changes in a shorter one."""

MAX_TURN_BETWEEN_SAMPLES = 0.7 * np.pi
"""Turn of an angle between samples that counts as near half a turn [rad]."""

TOLD_NOISE = 0.05
"""Share of noise in the changes in a super step above which it is mentioned."""

USUAL_SHARE = 99
"""Percentile of distances from the median within which samples are usual."""

FAR_OUT = 10
"""Multiple of the usual distance at which a sample is mentioned."""


def propose_recording(path: Path) -> Proposal:
    """Return a definition of the recordings at `path`.

    The user must have allowed the file to be opened, see `trust_file`. Raises BadFileError for a
    control that never changes, and for recordings in which nothing moves.
    """
    recording = read_recording(digest_of(path), path.name)
    samples = np.concatenate(recording.states)
    names = [name for name, _ in recording.state]
    units = [unit for _, unit in recording.state]
    with_units = [f"{name} {unit}" for name, unit in recording.state]
    warnings = list(_still_columns(recording, samples))
    refuse_large(path.name, with_units, samples)
    runs = _unwrapped(recording)
    is_turning = (np.ptp(samples, axis=0) > np.pi) & (np.array(units) == "rad")
    turning = np.flatnonzero(is_turning)
    substeps, note = _substeps(recording, runs, turning)
    rest = _stillest(recording, runs, substeps)
    rates = rate_entries(runs, recording.step, units)
    state = []
    for entry, (name, unit) in enumerate(recording.state):
        part = {
            "name": name,
            "unit": unit,
            "feature": "sine" if is_turning[entry] else "plain",
            "rate": names[rates[entry]] if entry in rates else "",
            "rest": [rounded(rest[entry], 6)],
        }
        state.append(part)
    control = []
    for entry, (name, unit) in enumerate(recording.control):
        column = np.concatenate([controls[:, entry] for controls in recording.controls])
        bounds = {"low": [float(column.min())], "high": [float(column.max())]}
        control.append({"name": name, "unit": unit} | bounds)
    values = {
        "name": usual_name(path),
        "kind": "recorded",
        "file": path.name,
        "substeps": substeps,
        "physics": {"step": recording.step},
        "state": state,
    }
    if control:
        values["control"] = control
    where = "are stillest" if control else "begin, since nothing drives the system"
    comments = PART_TITLES | {
        "substeps": note,
        "physics.step": f"the sampling interval [s]; {len(recording.states)} runs",
        "state.rate": "where one column adds up to another's changes, noise left aside",
        "state.rest": f"where the recordings {where}; motions begin there by default",
    }
    warnings += [
        *_outliers(recording, samples),
        *_fast_turns(names, runs, turning),
        *_short_runs(recording, window_length(substeps)),
        *warn_of_small(with_units, changes_of(runs, substeps)),
    ]
    definition = check_table(values, path.name, RecordedDefinition)
    # Where nothing drives the motion there are no goals to reach.
    parts = tuple(names) if recording.control else ()
    return Proposal(definition, comments, parts, tuple(warnings))


def _still_columns(recording: Recording, samples: Float[np.ndarray, "N S"]) -> Iterator[str]:
    """Yield a line if some state columns never change.

    Raises BadFileError if no state column ever changes, or if a control column does not.
    """
    is_still = np.ptp(samples, axis=0) == 0
    if is_still.all():
        raise BadFileError(
            f"{recording.file}: the state is the same in every row, so there is no motion to learn. Record while it moves."
        )
    changes = np.ptp(np.concatenate(recording.controls), axis=0)
    for (name, _), change in zip(recording.control, changes, strict=True):
        if change == 0:
            raise BadFileError(
                f"{recording.file}: control.{name} never changes, so nothing can be learnt from it. Remove the column, or record "
                "while it changes."
            )
    still = [f"state.{recording.state[i][0]}" for i in np.flatnonzero(is_still)]
    if still:
        yield f"{listed(still)}: the same in every row, so nothing can be learnt from it. Remove the column."


def _unwrapped(recording: Recording) -> Runs:
    """Return each run's states, with angles unwrapped."""
    is_angle = np.array([unit == "rad" for _, unit in recording.state])
    runs = []
    for states in recording.states:
        continuous = states.copy()
        continuous[:, is_angle] = np.unwrap(states[:, is_angle], axis=0)
        runs.append(continuous)
    return runs


def _stillest(recording: Recording, runs: Runs, span: int) -> Float[np.ndarray, " S"]:
    """Return the recorded state with the smallest change over `span` samples, each number in its own scale.

    If nothing drives the recorded system, it is the start of the recordings.
    """
    if not recording.control:
        return recording.states[0][0]
    before = np.concatenate([states[:-span] for states in recording.states])
    changes = changes_of(runs, span)
    usual = changes.std(axis=0)
    moves = usual > 0
    unrest = ((changes[:, moves] / usual[moves]) ** 2).sum(axis=1)
    return before[int(np.argmin(unrest))]


def _substeps(recording: Recording, runs: Runs, turning: Int[np.ndarray, " T"]) -> tuple[int, str]:
    """Return the proposed number of samples in a super step, and the reason: turns stay small, and noise does not dominate."""
    noise = noise_of(runs, recording.controls)
    substeps = proposed_substeps(recording.step)
    if recording.step > WANTED_SUPER_STEP:
        substeps = slow_substeps(runs, noise, substeps)
    # Over the whole super step: noise between two samples is not motion.
    turn = max(_fastest_turns(runs, turning, substeps), default=0.0) / substeps
    most = MAX_SUBSTEPS
    if turn > 0:
        substeps = max(1, min(substeps, int(MAX_TURN / turn)))
        most = max(1, int(MAX_TURN_THROUGH_NOISE / turn))
    substeps = substeps_through_noise(runs, noise, substeps, most)
    substeps = _largest_for(recording, substeps)
    note = f"samples; a super step of {substeps * recording.step:g} s"
    if len(turning):
        note += f", in which angles turn by up to {substeps * turn:.2g} rad"
    hidden = share_of_noise(runs, noise, substeps)
    if hidden > TOLD_NOISE:
        note += f"; {hidden:.2g} of the changes in it are noise"
    return substeps, note


def _fastest_turns(runs: Runs, turning: Int[np.ndarray, " T"], span: int) -> list[float]:
    """Return the fast turns of the entries `turning` in `span` samples [rad]."""
    turns = np.abs(changes_of(runs, span)[:, turning])
    return np.percentile(turns, FASTEST, axis=0).tolist() if len(turns) else []


def _largest_for(recording: Recording, most: int) -> int:
    """Return the largest number of samples in a super step, up to `most`, that leaves enough to test on.

    Raises BadFileError if the recordings are too short for any.
    """
    rows = [len(states) for states in recording.states]
    for substeps in range(most, 1, -1):
        try:
            split_runs(recording.file, rows, window_length(substeps))
        except BadFileError:
            continue
        return substeps
    split_runs(recording.file, rows, window_length(1))
    return 1


def _outliers(recording: Recording, samples: Float[np.ndarray, "N S"]) -> Iterator[str]:
    """Yield a line for each state column with a few samples far from all others: a sensor may have failed."""
    # As in the file: an outlier of an angle would be unwrapped to many turns.
    distances = np.abs(samples - np.median(samples, axis=0))
    usual = np.percentile(distances, USUAL_SHARE, axis=0)
    for entry, (name, unit) in enumerate(recording.state):
        count = int((distances[:, entry] > FAR_OUT * usual[entry]).sum())
        if not usual[entry] or not count:
            continue
        farthest = int(np.argmax(distances[:, entry]))
        yield (
            f"state.{name}: {count} of {len(samples)} samples lie more than {FAR_OUT} times as far out as {USUAL_SHARE} % do, "
            f"such as {samples[farthest, entry]:.4g} {unit} in {recording.where(farthest)}. Correct them, or cut them out."
        )


def _fast_turns(names: list[str], runs: Runs, turning: Int[np.ndarray, " T"]) -> Iterator[str]:
    """Yield a line for each angle that turns so far between two samples that its direction is ambiguous."""
    for entry, turn in zip(turning, _fastest_turns(runs, turning, 1), strict=True):
        if turn > MAX_TURN_BETWEEN_SAMPLES:
            yield (
                f"state.{names[entry]}: turns by {turn:.2g} rad and more between two samples, and half a turn one way looks like "
                "half a turn the other way. Sample faster."
            )


def _short_runs(recording: Recording, length: int) -> Iterator[str]:
    """Yield a line if there are runs shorter than `length` samples, too short to learn from."""
    short = [run for run, states in enumerate(recording.states) if len(states) < length]
    if short:
        first = short[0]
        yield (
            f"{len(short)} of {len(recording.states)} runs are left out, as they have fewer than {length} rows, such as the "
            f"{len(recording.states[first])} from {recording.origins[first]} on. Record longer, or use a smaller substeps."
        )
