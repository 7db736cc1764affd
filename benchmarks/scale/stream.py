"""Training on more windows than memory holds: how fast, in how much memory, and whether a kill changes a byte."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator import DatasetConfig, TrainingConfig, generate, load_system, read_transitions
from neuroanimator.learn.data.stored import StoredTransitions, memory_taken
from neuroanimator.learn.training.checkpoint import TrainingState
from neuroanimator.learn.training.config import UPDATES_PER_CHUNK
from neuroanimator.learn.training.feed import Feed
from neuroanimator.learn.training.lesson import lesson_of
from neuroanimator.learn.training.optimizer import make_optimizer
from neuroanimator.learn.training.train import run_folder

WINDOWS = 50_000_000

QUICK_WINDOWS = 2_000_000

WINDOWS_IN_MEMORY = 1_000_000
"""The in-memory side learns from these: as many as would not fit need forty gigabytes."""

MEMORY = "300MB"
"""For windows; the program itself takes the rest of a gigabyte."""

QUICK_MEMORY = "60MB"

SUBSTEPS = 5
"""Short super steps of the pendulum: made quickly, and to training all windows are alike."""

ROUNDS = 5
"""Number of turns of each side."""

CHUNKS_PER_TURN = 60
"""The stream begins anew in each of its turns, with nothing read ahead; a turn is long enough to pay for it."""


def measure(work: Path, is_quick: bool) -> list[dict[str, Any]]:
    """Return one row: rates in windows a second, their ratio, the peak of resident memory, and whether bytes agree."""
    windows = QUICK_WINDOWS if is_quick else WINDOWS
    memory = QUICK_MEMORY if is_quick else MEMORY
    large = _dataset(windows, work / "large")
    _dataset(WINDOWS_IN_MEMORY // (4 if is_quick else 1), work / "small")
    updates = 3000 if is_quick else UPDATES_PER_CHUNK * -(-windows // (512 * UPDATES_PER_CHUNK))
    row: dict[str, Any] = {
        "windows": large.runs * large.samples_per_run,
        "gigabytes_in_memory": memory_taken(large, load_system("pendulum")) / 1e9,
        "memory": memory,
    }
    rounds, chunks = (1, 8) if is_quick else (ROUNDS, CHUNKS_PER_TURN)
    # First: what a process starts counts its parent's memory for its own, and that is small yet.
    row |= _killed(work, memory, updates)
    row |= _rates(work, large, memory, rounds, chunks)
    return [row]


def _dataset(windows: int, folder: Path) -> DatasetConfig:
    config = DatasetConfig(system="pendulum", substeps=SUBSTEPS, count=windows, samples_per_run=36)
    generate(config, folder)
    return config


def _rates(
    work: Path, large: DatasetConfig, memory: str, rounds: int, chunks: int
) -> dict[str, Any]:
    """Return how many windows a second either side learns from: medians of turns, one side after the other."""
    config = TrainingConfig(memory=memory)
    system = load_system("pendulum")
    began = time.perf_counter()
    streamed = lesson_of(StoredTransitions(work / "large", large, system), config, None)
    survey_seconds = time.perf_counter() - began
    held = lesson_of(read_transitions(work / "small"), config, None)
    rates: dict[str, list[float]] = {"memory": [], "stream": []}
    for turn in range(rounds + 1):
        for name, lesson in (("memory", held), ("stream", streamed)):
            rate = _rate(lesson.feed, lesson.problem.base.network, config, turn, chunks)
            if turn:  # the first one compiles
                rates[name].append(rate)
    in_memory = float(np.median(rates["memory"]))
    from_disk = float(np.median(rates["stream"]))
    return {
        "survey_s": survey_seconds,
        "memory_windows_per_s": in_memory,
        "stream_windows_per_s": from_disk,
        "ratio": from_disk / in_memory,
        "lowest_ratio": min(rates["stream"]) / in_memory,
    }


def _rate(feed: Feed, network: Any, config: TrainingConfig, turn: int, chunks: int) -> float:
    """Return windows a second over some chunks of single super steps, what is opened for them included."""
    state = TrainingState.fresh(network, make_optimizer(config)).optimizer_state
    first = turn * chunks % (config.chunks // 2)
    began = time.perf_counter()
    with closing(feed):
        for chunk in range(first, first + chunks):
            network, state, _ = feed.train(network, state, chunk)
    return chunks * UPDATES_PER_CHUNK * config.batch / (time.perf_counter() - began)


def _killed(work: Path, memory: str, updates: int) -> dict[str, Any]:
    """Return the peak of resident memory of a whole run, and whether one that is killed ends with the same bytes."""
    whole = work / "whole.safetensors"
    broken = work / "broken.safetensors"
    for old in (whole, broken):
        old.unlink(missing_ok=True)
        for file in run_folder(old).glob("*"):
            file.unlink()
    began = time.perf_counter()
    process = subprocess.Popen(_command(work, whole, memory, updates))
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - began
    if status:
        raise SystemExit("the whole run failed")
    rng = random.Random(0)
    kills = 0
    while kills < 3:
        process = subprocess.Popen(_command(work, broken, memory, updates))
        time.sleep(seconds * rng.uniform(0.3, 0.6))
        process.send_signal(signal.SIGKILL)
        kills += process.wait() == -signal.SIGKILL
        if broken.exists():
            break
    subprocess.run(_command(work, broken, memory, updates), check=True)
    return {
        "updates": updates,
        "seconds": seconds,
        "peak_resident_GB": usage.ru_maxrss * 1024 / 1e9,
        "kills": kills,
        "same_bytes": broken.read_bytes() == whole.read_bytes(),
    }


def _command(work: Path, out: Path, memory: str, updates: int) -> list[str]:
    start = [sys.executable, "-c", "from neuroanimator.cli.main import main; main()", "train"]
    settings = ["--memory", memory, "--updates", str(updates)]
    return [*start, str(work / "large"), "--out", str(out), *settings]
