"""Datasets from recordings: windows of super steps at any offset, and whole runs kept for the test.

A super step's control is the mean over its samples. Windows of one stretch share its run number, so
that training validates on stretches it has not seen; the test's stretches it never gets.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from neuroanimator.data.recorded_splits import Stretch, cut_stretches
from neuroanimator.data.transitions import (
    HELD_OUT_NAME,
    MAX_UNROLL,
    RUN_STEPS,
    RUNS_PER_SHARD,
    DatasetConfig,
    window_length,
)
from neuroanimator.storage.files import write_tensors
from neuroanimator.systems.recorded.recorded_system import RecordedSystem


def cut_shard(system: RecordedSystem, config: DatasetConfig, shard: int) -> dict[str, np.ndarray]:
    """Return the tensors of shard number `shard`: a function of its arguments and the recordings alone."""
    learn, _ = cut_stretches(system, window_length(config.substeps))
    counts = np.array([stretch.windows(window_length(config.substeps)) for stretch in learn])
    order = np.random.default_rng([config.seed, 2]).permutation(counts.sum())[
        : config.runs * config.picks
    ]
    each = RUNS_PER_SHARD * config.picks
    chosen = order[shard * each : (shard + 1) * each]
    ends = np.cumsum(counts)
    number = np.searchsorted(ends, chosen, side="right")
    offsets = chosen - (ends - counts)[number]
    runs = unwrapped(system)
    windows = [
        super_steps(
            runs, learn[i]._replace(start=learn[i].start + offset), config.substeps, MAX_UNROLL
        )
        for i, offset in zip(number.tolist(), offsets.tolist(), strict=True)
    ]
    return {
        "states": np.stack([states for states, _ in windows]).astype(np.float32),
        "controls": np.stack([controls for _, controls in windows]).astype(np.float32),
        "picks": np.zeros((len(windows), 1), np.int32),
        "runs": number.astype(np.int32),
    }


def unwrapped(system: RecordedSystem) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return each run's (states, controls); angles seen by sine and cosine go on over ±π instead of jumping."""
    recording, runs = system.recording(), []
    for states, controls in zip(recording.states, recording.controls, strict=True):
        states = states.copy()
        states[:, system.turning] = np.unwrap(states[:, system.turning], axis=0)
        runs.append((states, controls))
    return runs


def super_steps(
    runs: list[tuple[np.ndarray, np.ndarray]], stretch: Stretch, substeps: int, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return (states (T+1, S), controls (T, C)) of the first `count` super steps of a stretch."""
    states, controls = runs[stretch.run]
    stop = stretch.start + count * substeps
    held = controls[stretch.start : stop].reshape(count, substeps, -1).mean(axis=1)
    return states[stretch.start : stop + 1 : substeps], held


def write_held_out(system: RecordedSystem, config: DatasetConfig, folder: Path) -> None:
    """Store the test's runs beside the shards: as many as fit, equally long, none overlapping another."""
    _, test = cut_stretches(system, window_length(config.substeps))
    fitting = [(stretch.stop - stretch.start - 1) // config.substeps for stretch in test]
    steps, runs = min(RUN_STEPS, *fitting), unwrapped(system)
    pieces = [
        super_steps(
            runs,
            stretch._replace(start=stretch.start + k * steps * config.substeps),
            config.substeps,
            steps,
        )
        for stretch, fits in zip(test, fitting, strict=True)
        for k in range(fits // steps)
    ]
    tensors = {
        "states": np.stack([s for s, _ in pieces]),
        "controls": np.stack([c for _, c in pieces]),
    }
    write_tensors(folder / HELD_OUT_NAME, tensors, {"kind": "held-out", "config": config.hash})
