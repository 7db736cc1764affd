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
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import read_bounded
from neuroanimator.files.numbers import MIN_STEP
from neuroanimator.systems.recorded.columns import Samples, where_in_file
from neuroanimator.systems.recorded.csv_file import read_csv
from neuroanimator.systems.recorded.npz_file import read_npz
from neuroanimator.systems.trusted_files import MAX_FILE, trusted_file
from neuroanimator.text import printable

READERS: dict[str, Callable[[bytes, str], Samples]] = {".csv": read_csv, ".npz": read_npz}
"""Readers of samples from a file's bytes and name, by suffix."""

INTERVAL_TOLERANCE = 1e-3
"""Relative tolerance of sampling intervals; clocks are better than that."""

DRIFTING_SHARE = 0.05
"""Share of wrong intervals above which the clock is at fault, not a gap."""

FEW_GAPS = 3
"""Number of wrong intervals up to which they count as gaps, also in a short recording."""

INTERVAL_DIGITS = 6
"""Number of significant digits to which the sampling interval is rounded: times in a file are rounded too."""

MAX_SHOWN = 60
"""Maximum number of characters of a file's name shown in an error."""


@dataclass(frozen=True)
class Recording:
    """All runs of one file."""

    file: str
    """Name of the file."""
    state: tuple[tuple[str, str], ...]
    """(name, unit) of each state entry."""
    control: tuple[tuple[str, str], ...]
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

    def where(self, row: int) -> str:
        """Return the place in the file of a row of all runs, in words."""
        return where_in_file(self.lines, row)


@lru_cache(maxsize=4)
def read_recording(digest: str, name: str) -> Recording:
    """Return the recording in the file with this sha256; BadFileError names the line and the fix."""
    content = trusted_file(
        digest,
        f"It was made from {printable(name)}, recordings that are opened only if you say so: give the TOML file beside "
        "them, --system PATH, or in Python trust_files(PATH). If you did, they have changed since.",
    )
    read = READERS.get(Path(name).suffix)
    if read is None:
        raise BadFileError(f"{name[:MAX_SHOWN]}: recordings end in {', '.join(READERS)}.")
    return cut_runs(read(content, name), name)


def open_recording(path: Path) -> Recording:
    """Return the recording in the file at `path`, which a user names; BadFileError names the line and the fix."""
    read = READERS.get(path.suffix)
    if read is None:
        raise BadFileError(f"{path}: recordings end in {', '.join(READERS)}.")
    return cut_runs(read(read_bounded(path, MAX_FILE), path.name), path.name)


def cut_runs(samples: Samples, name: str) -> Recording:
    """Return the samples run by run: a new one starts where the run's label changes or time goes back."""
    if len(samples.time) < 2:
        raise BadFileError(
            f"{name}: {len(samples.time)} rows; wanted a few hundred. Record longer."
        )
    gaps = np.diff(samples.time)
    is_relabelled = samples.run[1:] != samples.run[:-1]
    begins = np.flatnonzero(is_relabelled | (gaps < 0)) + 1
    is_inside = np.ones(len(gaps), bool)  # within a run, not between two
    is_inside[begins - 1] = False
    if not is_inside.any():
        raise BadFileError(
            f"{name}: every run has one row only. Sort the rows by run, then by time."
        )
    step = _interval(samples, name, gaps, is_inside)
    origins = [samples.where(row) for row in (0, *begins.tolist())]
    return Recording(
        file=name,
        state=samples.state,
        control=samples.control,
        step=step,
        states=tuple(np.split(samples.states, begins)),
        controls=tuple(np.split(samples.controls, begins)),
        origins=tuple(origins),
        lines=samples.lines,
    )


def _interval(
    samples: Samples,
    name: str,
    gaps: Float[np.ndarray, " G"],
    is_inside: Bool[np.ndarray, " G"],
) -> float:
    """Return the sampling interval [s]; `gaps` are the times between rows, `is_inside` whether both are in one run."""
    usual = float(np.median(gaps[is_inside]))
    is_unusual = np.abs(gaps - usual) > INTERVAL_TOLERANCE * usual
    wrong = np.flatnonzero(is_inside & is_unusual)
    if usual > 0 and len(wrong) > max(FEW_GAPS, DRIFTING_SHARE * is_inside.sum()):
        least = gaps[is_inside].min()
        largest = gaps[is_inside].max()
        raise BadFileError(
            f"{name}: the clock drifts or jitters: rows are {least:.6g} to {largest:.6g} s apart, usually {usual:.6g} s. "
            "Resample to a constant interval."
        )
    if usual <= 0 or len(wrong):
        row = 0
        if len(wrong):
            row = int(wrong[0])
        raise BadFileError(
            f"{name}, {samples.where(row + 1)}, time: {gaps[row]:.6g} s after the row before, elsewhere {usual:.6g} s. "
            "Resample to a constant interval, or begin a new run there (column run)."
        )
    if usual < MIN_STEP:
        raise BadFileError(
            f"{name}: sampled every {usual:g} s; wanted at least {MIN_STEP:g} s. Give the time in seconds."
        )
    mean = gaps[is_inside].mean()
    return float(f"{mean:.{INTERVAL_DIGITS}g}")
