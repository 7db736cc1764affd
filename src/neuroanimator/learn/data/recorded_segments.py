"""Recordings cut into segments, some to train on and some to test on, with a gap between neighbours.

Motion is continuous: a test segment that touched training segments would be half known, and its error too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from neuroanimator.errors import BadFileError
from neuroanimator.learn.data.config import DatasetConfig, window_length
from neuroanimator.physics.recorded.read_recordings import read_recordings
from neuroanimator.systems.recording_file import RecordingFile
from neuroanimator.systems.system import System

MANY_SEGMENTS = 20
"""Approximate number of segments that long runs are cut into; training holds out whole ones for validation."""

MIN_SEGMENTS = 3
"""Minimum number of segments: one to train on, one to validate on and one to test on."""

TEST_EVERY = 10
"""Interval of the segments kept for the test; at least the last one is."""

MIN_WINDOWS = 3
"""Minimum length of a segment [windows], the gap before it included: the gap takes one, cutting another."""


class RecordedSegment(NamedTuple):
    """Consecutive samples of one run."""

    run: int
    start: int
    stop: int

    def windows(self, length: int) -> int:
        """Return the number of offsets at which a window of `length` samples fits."""
        return self.stop - self.start - length + 1


class Split(NamedTuple):
    """Segments to train on, and others to test on."""

    learning: list[RecordedSegment]
    test: list[RecordedSegment]


def split_recordings(recordings: RecordingFile, length: int) -> Split:
    """Return the segments of all runs, each at least `length` samples long; BadFileError if there are too few.

    Shorter runs are left out.
    """
    return split_runs(recordings.name, recordings.rows, length)


def split_runs(name: str, rows: Sequence[int], length: int) -> Split:
    """Return the segments of runs of `rows` samples each, from the file called `name`; see `split_recordings`."""
    longest = max(rows)
    if longest < length:
        raise BadFileError(
            f"{name}: the longest run has {longest} rows; wanted at least {length} for a super step this long. "
            "Record longer, or use a smaller --substeps."
        )
    segments: list[RecordedSegment] = []
    for run in range(len(rows)):
        if rows[run] >= length:
            segments += _cut_run(rows, run, length)
    if len(segments) < MIN_SEGMENTS:
        raise BadFileError(
            f"{name}: {sum(rows)} rows are too few to learn from and to test on; "
            f"wanted at least {MIN_SEGMENTS * MIN_WINDOWS * length}. Record longer, or use a smaller --substeps."
        )
    test = segments[TEST_EVERY - 1 :: TEST_EVERY] or segments[-1:]
    learning = [segment for segment in segments if segment not in test]
    return Split(learning, test)


def _cut_run(rows: Sequence[int], run: int, length: int) -> list[RecordedSegment]:
    """Return the segments of run number `run`, with gaps of one window's `length` between neighbours."""
    own = rows[run]
    most_parts = own // (MIN_WINDOWS * length)
    parts = max(1, min(round(MANY_SEGMENTS * own / sum(rows)), most_parts))
    edges = [own * part // parts for part in range(parts + 1)]
    segments = []
    for start, stop in pairwise(edges):
        gap = length if start else 0
        segments.append(RecordedSegment(run, start + gap, stop))
    return segments


def limited_to_recordings(config: DatasetConfig, system: System) -> DatasetConfig:
    """Return `config`, of `system`, with `count` lowered to the number its recordings hold; unchanged if it is simulated.

    The recordings are read and checked against the definition, so that a wrong file is refused before a folder is made
    for it. Raises BadFileError if they hold too few windows for even one run's worth of examples.
    """
    recordings = system.recordings
    if recordings is None:
        return config
    read_recordings(recordings)
    available = count_available(recordings, config)
    return config.model_copy(update={"count": min(config.count, available)})


def count_available(recordings: RecordingFile, config: DatasetConfig) -> int:
    """Return the number of examples in recordings, a multiple of `samples_per_run`."""
    length = window_length(config.substeps)
    learning = split_recordings(recordings, length).learning
    windows = sum(segment.windows(length) for segment in learning)
    if windows < config.samples_per_run:
        raise BadFileError(
            f"{recordings.name}: only {windows} windows of super steps. Record longer."
        )
    return windows // config.samples_per_run * config.samples_per_run
