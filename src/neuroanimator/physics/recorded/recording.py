"""Recorded runs: samples of state and control at a constant interval, from a CSV or an NPZ file.

A CSV begins with a header of names and units; without `run`, a new run starts where time goes
back:

    run,time s,state.angle rad,state.velocity rad/s,control.torque N·m
    1,0.00,0.1,0.0,0.5

An NPZ holds the same as arrays: time (N,) [s], states (N, S), controls (N, C), state_names and
control_names such as "angle rad", and optionally run (N,). The control in a row acts until the next one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import read_bounded
from neuroanimator.files.clock import Clock, clock_of, resolution_of
from neuroanimator.files.number_table import Header, read_header, read_numbers
from neuroanimator.files.numbers import MIN_STEP
from neuroanimator.physics.recorded.npz_file import read_npz
from neuroanimator.physics.recorded.rates import refuse_degrees
from neuroanimator.physics.recorded.resample import on_even_grids
from neuroanimator.physics.recorded.rotations import rotations_in, with_one_sign
from neuroanimator.state.columns import (
    NamesAndUnits,
    Samples,
    Vocabulary,
    columns_of,
    samples_of,
    seconds,
    time_column,
    where_in_file,
)
from neuroanimator.systems.trusted_files import MAX_FILE, trusted_file
from neuroanimator.text import printable

MAX_SHOWN = 60
"""Maximum number of characters of a file's name shown in an error."""

HEADER = "run,time s,state.angle rad,state.velocity rad/s,control.torque N·m"
"""Example of a header shown in errors."""

RUN = "run"
"""Name of the column of runs' labels."""


@dataclass(frozen=True)
class Recording:
    """All runs of one file."""

    file: str
    """Name of the file."""
    state: NamesAndUnits
    """(name, unit) of each state entry."""
    control: NamesAndUnits
    """(name, unit) of each control entry."""
    step: float
    """Sampling interval [s]."""
    states: tuple[Float[np.ndarray, "_ S"], ...]
    """States of each run, of various lengths."""
    controls: tuple[Float[np.ndarray, "_ C"], ...]
    """Controls of each run: row k acts from sample k to sample k+1."""
    origins: tuple[str, ...]
    """Start of each run in the file, in words."""
    lines: Int[np.ndarray, " N"] | None = None
    """Line number of each row of all runs, if the file is text."""
    remarks: tuple[str, ...] = ()
    """What was changed as the file was read, for the user."""

    def where(self, row: int) -> str:
        """Return the place in the file of a row of all runs, in words."""
        return where_in_file(self.lines, row)


@lru_cache(maxsize=4)
def read_recording(digest: str, name: str, is_resampled: bool = False) -> Recording:
    """Return the recording in the file with this sha256; BadFileError names the line and the fix."""
    content = trusted_file(
        digest,
        f"It was made from {printable(name)}, recordings that are opened only if you say so: give the TOML file beside "
        "them, --system PATH, or in Python trust_files(PATH). If you did, they have changed since.",
    )
    return parse_recording(content, name, is_resampled=is_resampled)


def open_recording(
    path: Path, vocabulary: Vocabulary | None = None, *, is_resampled: bool = False
) -> Recording:
    """Return the recording in the file at `path`, which a user names; BadFileError names the line and the fix.

    Columns may be called as the numbers of a system are, whose `vocabulary` is given. With `is_resampled`, samples at
    uneven times are interpolated.
    """
    content = b""
    if path.suffix.lower() in READERS:
        content = read_bounded(path, MAX_FILE)
    return parse_recording(content, path.name, vocabulary, is_resampled=is_resampled)


def parse_recording(
    content: bytes, name: str, vocabulary: Vocabulary | None = None, *, is_resampled: bool = False
) -> Recording:
    """Return the recording in the file called `name`; see `open_recording`."""
    read = READERS.get(Path(name).suffix.lower())
    if read is None:
        raise BadFileError(f"{name[:MAX_SHOWN]}: recordings end in {', '.join(READERS)}.")
    samples = read(content, name, vocabulary)
    return cut_runs(samples, name, is_resampled=is_resampled)


def cut_runs(samples: Samples, name: str, *, is_resampled: bool = False) -> Recording:
    """Return the samples run by run: a new one starts where the run's label changes or time goes back."""
    if len(samples.time) < 2:
        raise BadFileError(
            f"{name}: {len(samples.time)} rows; wanted a few hundred. Record longer."
        )
    is_inside = (samples.run[1:] == samples.run[:-1]) & (np.diff(samples.time) >= 0)
    if not is_inside.any():
        raise BadFileError(
            f"{name}: every run has one row only. Sort the rows by run, then by time."
        )
    clock = clock_of(samples.time, samples.resolution, is_inside)
    _refuse_clock(samples, name, clock, is_inside, is_resampled=is_resampled)
    rotations = rotations_in(samples.state, samples.states)
    begins = np.flatnonzero(~is_inside) + 1
    runs = np.split(samples.states, begins)
    states = np.concatenate(with_one_sign(runs, rotations))
    refuse_degrees(name, samples.state, np.split(states, begins), clock.step)
    remarks = list(samples.remarks)
    is_turned = (states != samples.states).any(axis=1)
    jumps = np.flatnonzero(np.diff(is_turned, prepend=False))
    if len(jumps):
        remarks.append(
            f"quaternions change their sign {len(jumps)} times, which means nothing, first in {samples.where(int(jumps[0]))}; "
            "undone"
        )
    samples = replace(samples, states=states)
    if not clock.is_steady:
        samples, begins = on_even_grids(samples, begins, clock.step, rotations)
        remarks.append(f"resampled to {len(samples.time)} rows, {1 / clock.step:.6g} a second")
    origins = [samples.where(row) for row in (0, *begins.tolist())]
    return Recording(
        file=name,
        state=samples.state,
        control=samples.control,
        step=clock.step,
        states=tuple(np.split(samples.states, begins)),
        controls=tuple(np.split(samples.controls, begins)),
        origins=tuple(origins),
        lines=samples.lines,
        remarks=tuple(remarks),
    )


def _refuse_clock(
    samples: Samples,
    name: str,
    clock: Clock,
    is_inside: Bool[np.ndarray, " G"],
    *,
    is_resampled: bool,
) -> None:
    """Raise BadFileError for times that tell no rate, or for uneven ones, unless these are to be `is_resampled`."""
    intervals = np.diff(samples.time)
    inside = intervals[is_inside]
    usual = float(np.median(inside))
    if 0 < usual < MIN_STEP:
        raise BadFileError(
            f"{name}: sampled every {usual:g} s; wanted at least {MIN_STEP:g} s. Give the time in seconds."
        )
    if clock.step <= 0:
        row = int(np.flatnonzero(is_inside)[0])
        raise BadFileError(
            f"{name}, {samples.where(row + 1)}, time: {intervals[row]:g} s after the row before, and times tell no less than "
            f"{samples.resolution[row + 1]:.3g} s apart. Write them with more digits, or since the first row."
        )
    if clock.is_steady or is_resampled:
        return
    first = int(clock.wrong[0])
    share = 100 * len(clock.wrong) / is_inside.sum()
    remedy = "--resample interpolates there (in the TOML file: resample = true)"
    if clock.has_gaps_only:
        raise BadFileError(
            f"{name}, {samples.where(first + 1)}, time: {intervals[first]:.6g} s after the row before, elsewhere "
            f"{clock.step:.6g} s; {len(clock.wrong)} such intervals, {share:.2g} % of all. {remedy}; or begin a new run there "
            "(column run)."
        )
    worst = int(clock.wrong[np.argmax(np.abs(intervals[clock.wrong] - clock.step))])
    raise BadFileError(
        f"{name}: the clock drifts or jitters: rows are {inside.min():.6g} to {inside.max():.6g} s apart, on average "
        f"{clock.step:.6g} s ({1 / clock.step:.6g} a second); {share:.3g} % are off, most in "
        f"{samples.where(worst + 1)}. {remedy}."
    )


def read_csv(content: bytes, name: str, vocabulary: Vocabulary | None = None) -> Samples:
    """Return the samples in a CSV file; BadFileError names line, column and fix."""
    header = read_header(content, lambda cells: any(map(time_column, cells)), name)
    time, run = _clocks(header, name)
    where = f"{name}, line {header.line}"
    numbers = [number for number in range(len(header.cells)) if number not in (time, run)]
    cells = {f"{where}, column {number + 1}": header.cells[number] for number in numbers}
    columns = columns_of(cells, vocabulary, where)
    table = read_numbers(content, header, [time, *numbers], name, run)
    clock = time_column(header.cells[time])
    assert clock is not None
    times = table.values[:, 0]
    timing = seconds(times, clock, f"{where}, column {time + 1}")
    resolution = resolution_of(times, table.places)
    return samples_of(table.labels, timing, resolution, table.values[:, 1:], columns, table.lines)


def _clocks(header: Header, name: str) -> tuple[int, int | None]:
    """Return the columns of the time, and of the run's label if there is one."""
    if not header.line:
        raise BadFileError(f"{name} is empty. It should begin with a header such as '{HEADER}'.")
    times = [number for number, cell in enumerate(header.cells) if time_column(cell)]
    runs = [number for number, cell in enumerate(header.cells) if cell.strip() == RUN]
    where = f"{name}, line {header.line}"
    if not times:
        raise BadFileError(f"{where}: no column 'time s'. Wanted a header such as '{HEADER}'.")
    for label, found in (("time", times), (RUN, runs)):
        if len(found) > 1:
            raise BadFileError(f"{where}: two columns are called '{label}'. Remove one of them.")
    return times[0], (runs or [None])[0]


READERS: dict[str, Callable[[bytes, str, Vocabulary | None], Samples]] = {
    ".csv": read_csv,
    ".npz": read_npz,
}
"""Readers of samples from a file's bytes and name, by suffix."""
