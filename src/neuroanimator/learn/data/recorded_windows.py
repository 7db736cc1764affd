"""Datasets from recordings: windows of super steps at any offset, and whole runs kept for the test.

A super step's control is the mean over its samples. Windows carry the number of their segment, so
that training validates on whole segments it has not seen; it never gets the test's segments.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.files.atomic import Tensors, write_tensors
from neuroanimator.files.places import Place
from neuroanimator.learn.data.config import (
    MAX_UNROLL,
    RUN_STEPS,
    RUNS_PER_SHARD,
    DatasetConfig,
    window_length,
)
from neuroanimator.learn.data.recorded_noise import noise_of
from neuroanimator.learn.data.recorded_segments import RecordedSegment, split_recordings
from neuroanimator.learn.data.store import HELD_OUT_NAME
from neuroanimator.physics.recorded.read_recordings import read_recordings
from neuroanimator.physics.recorded.rotations import without_jumps
from neuroanimator.systems.recording_file import RecordingFile

WINDOWS_STREAM = 2
"""Number that gives the order of windows a random stream of its own, beside the seed."""


class RecordedRun(NamedTuple):
    """Consecutive samples, or super steps; with super steps there is one more state than controls."""

    states: Float[np.ndarray, "T S"]
    controls: Float[np.ndarray, "K C"]


def cut_shard(recordings: RecordingFile, config: DatasetConfig, shard: int) -> Tensors:
    """Return the tensors of shard number `shard`: a function of its arguments and the recordings alone."""
    length = window_length(config.substeps)
    segments = split_recordings(recordings, length).learning
    counts = np.array([segment.windows(length) for segment in segments])
    rng = np.random.default_rng([config.seed, WINDOWS_STREAM])
    order = rng.permutation(counts.sum())[: config.runs * config.samples_per_run]
    shard_size = RUNS_PER_SHARD * config.samples_per_run
    chosen = order[shard * shard_size : (shard + 1) * shard_size]
    ends = np.cumsum(counts)
    numbers = np.searchsorted(ends, chosen, side="right")
    offsets = chosen - (ends - counts)[numbers]
    runs = unwrapped(recordings)
    windows = []
    for number, offset in zip(numbers.tolist(), offsets.tolist(), strict=True):
        segment = segments[number]
        begin = segment._replace(start=segment.start + offset)
        windows.append(super_steps(runs, begin, config.substeps, MAX_UNROLL))
    return {
        "states": np.stack([window.states for window in windows]).astype(np.float32),
        "controls": np.stack([window.controls for window in windows]).astype(np.float32),
        "samples": np.zeros((len(windows), 1), np.int32),
        "segments": numbers.astype(np.int32),
    }


def unwrapped(recordings: RecordingFile) -> list[RecordedRun]:
    """Return each run's samples; angles that are encoded by sine and cosine are unwrapped across ±π."""
    recording = read_recordings(recordings)
    angles = list(recordings.angles)
    runs = []
    for states, controls in zip(recording.states, recording.controls, strict=True):
        runs.append(RecordedRun(without_jumps(states, angles), controls))
    return runs


def super_steps(
    runs: list[RecordedRun], segment: RecordedSegment, substeps: int, count: int
) -> RecordedRun:
    """Return the first `count` super steps of a segment: count + 1 states, and the mean control of each step."""
    states, controls = runs[segment.run]
    stop = segment.start + count * substeps
    held = controls[segment.start : stop].reshape(count, substeps, controls.shape[1]).mean(axis=1)
    return RecordedRun(states[segment.start : stop + 1 : substeps], held)


def write_held_out(recordings: RecordingFile, config: DatasetConfig, folder: Place) -> None:
    """Store the test's runs beside the shards: as many as fit, of equal length, without overlap.

    The noise of all recordings, by which the test's errors are judged, is stored with them.
    """
    segments = split_recordings(recordings, window_length(config.substeps)).test
    fitting = [(segment.stop - segment.start - 1) // config.substeps for segment in segments]
    steps = min(RUN_STEPS, *fitting)
    runs = unwrapped(recordings)
    pieces = []
    for segment, fits in zip(segments, fitting, strict=True):
        for piece in range(fits // steps):
            start = segment.start + piece * steps * config.substeps
            begin = segment._replace(start=start)
            pieces.append(super_steps(runs, begin, config.substeps, steps))
    tensors = {
        "states": np.stack([piece.states for piece in pieces]),
        "controls": np.stack([piece.controls for piece in pieces]),
        "noise": noise_of([run.states for run in runs], [run.controls for run in runs]),
    }
    write_tensors(folder / HELD_OUT_NAME, tensors, {"kind": "held-out", "config": config.hash})
