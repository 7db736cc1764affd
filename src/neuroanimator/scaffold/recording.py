"""Proposal for recordings, from their columns and numbers."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.errors import BadFileError
from neuroanimator.files.tables import check_table
from neuroanimator.learn.data.config import window_length
from neuroanimator.learn.data.recorded_noise import noise_of
from neuroanimator.learn.data.recorded_segments import split_runs
from neuroanimator.learn.data.shortcomings import (
    RECORD,
    learning_steps,
    too_few,
    wilder_test,
    without_velocities,
)
from neuroanimator.physics.recorded.rates import Runs, changes_of, rate_entries
from neuroanimator.physics.recorded.recording import Recording
from neuroanimator.physics.recorded.velocities import prepared, unwrapped
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


def propose_recording(path: Path, *, resample: bool = False, velocities: bool = False) -> Proposal:
    """Return a definition of the recordings at `path`; with `resample`, samples at uneven times are interpolated,
    with `velocities`, those that are not recorded are estimated.

    The user must have allowed the file to be opened, see `trust_file`. Raises BadFileError for a
    control that never changes, and for recordings in which nothing moves.
    """
    recording = prepared(digest_of(path), path.name, resample, velocities)
    samples = np.concatenate(recording.states)
    names = [name for name, _ in recording.state]
    units = [unit for _, unit in recording.state]
    with_units = [f"{name} {unit}" for name, unit in recording.state]
    warnings = list(_still_columns(recording, samples))
    refuse_large(path.name, with_units, samples)
    runs = unwrapped(recording)
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
    for key, is_wanted in (("resample", resample), ("velocities", velocities)):
        if is_wanted:
            values[key] = True
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
        *_outliers(recording),
        *_lacking(recording, substeps, rates),
        *_fast_turns(names, runs, turning),
        *_short_runs(recording, window_length(substeps)),
        *warn_of_small(with_units, changes_of(runs, substeps)),
    ]
    definition = check_table(values, path.name, RecordedDefinition)
    # Where nothing drives the motion there are no goals to reach.
    parts = tuple(names) if recording.control else ()
    told = tuple(("recording", remark) for remark in recording.remarks)
    return Proposal(definition, comments, parts, tuple(warnings), told)


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


def _outliers(recording: Recording) -> Iterator[str]:
    """Yield a line for each column with a few samples far from all others: a sensor may have failed, or a cell is wrong.

    They are far from the median, or from both samples beside them, which agree with each other.
    """
    # As in the file: an outlier of an angle would be unwrapped to many turns.
    vectors = (
        ("state", recording.state, recording.states),
        ("control", recording.control, recording.controls),
    )
    for vector, columns, runs in vectors:
        samples = np.concatenate(runs)
        distances = np.abs(samples - np.median(samples, axis=0))
        bends = np.concatenate([_bends(numbers) for numbers in runs])
        is_far = _are_far(distances) | (_are_far(np.abs(bends)) & (bends > 0))
        for entry, (name, unit) in enumerate(columns):
            count = int(is_far[:, entry].sum())
            if not count:
                continue
            farthest = int(np.argmax(is_far[:, entry] * distances[:, entry]))
            yield (
                f"{vector}.{name}: {count} of {len(samples)} samples lie more than {FAR_OUT} times as far out as "
                f"{USUAL_SHARE} % do, such as {samples[farthest, entry]:.4g} {unit} in {recording.where(farthest)}. Correct "
                "them, or cut them out."
            )


def _bends(numbers: Float[np.ndarray, "N D"]) -> Float[np.ndarray, "N D"]:
    """Return the distance of each number from the mean of both neighbours, negative unless these agree with each other."""
    bends = np.zeros_like(numbers)
    bends[1:-1] = np.abs(numbers[1:-1] - (numbers[:-2] + numbers[2:]) / 2)
    agree = 2 * np.abs(numbers[2:] - numbers[:-2]) < bends[1:-1]
    bends[1:-1] = np.where(agree, bends[1:-1], -bends[1:-1])
    return bends


def _are_far(distances: Float[np.ndarray, "N D"]) -> Bool[np.ndarray, "N D"]:
    usual = np.percentile(distances, USUAL_SHARE, axis=0)
    return (distances > FAR_OUT * usual) & (usual > 0)


def _lacking(recording: Recording, substeps: int, rates: Collection[int]) -> Iterator[str]:
    """Yield a line on what the recordings lack: velocities, samples to learn from, motion as in what is kept for the test.

    State entries in `rates` have a rate of change.
    """
    names = [f"state.{name}" for name, _ in recording.state]
    units = [unit for _, unit in recording.state]
    rows = [len(states) for states in recording.states]
    split = split_runs(recording.file, rows, window_length(substeps))
    learnt, tested = (
        np.concatenate([recording.states[run][start:stop] for run, start, stop in segments])
        for segments in split
    )
    numbers = len(recording.state) + len(recording.control)
    lacking = [
        without_velocities(names, units, rates),
        too_few(learning_steps(recording.file, rows, substeps), numbers, RECORD),
        wilder_test(names, units, learnt, tested),
    ]
    for text in filter(None, lacking):
        yield f"{text}."


def _fast_turns(names: list[str], runs: Runs, turning: Int[np.ndarray, " T"]) -> Iterator[str]:
    """Yield a line for each angle that turns so far between two samples that its direction is ambiguous."""
    for entry, turn in zip(turning, _fastest_turns(runs, turning, 1), strict=True):
        if turn > MAX_TURN_BETWEEN_SAMPLES:
            yield (
                f"state.{names[entry]}: turns by {turn:.2g} rad and more between two samples, and half a turn one way looks like "
                f"half a turn the other way. Sample faster; if it is in degrees, call it '{names[entry]} deg'."
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
