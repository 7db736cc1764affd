"""What a transition costs on its way from physics to weights, and what that makes of a billion and of 1e12 of them.

Core seconds are processor time, which other programs on the machine change little; a training's time is the fastest of some
chunks. Physics is that of the system's usual super step.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from neuroanimator import DatasetConfig, TrainingConfig, generate, load_system, read_transitions
from neuroanimator.learn.data.shard import make_shard
from neuroanimator.learn.data.stored import StoredTransitions
from neuroanimator.learn.training.checkpoint import TrainingState
from neuroanimator.learn.training.config import UPDATES_PER_CHUNK
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.learn.training.lesson import lesson_of
from neuroanimator.learn.training.optimizer import make_optimizer
from neuroanimator.learn.training.survey import Survey, sample_of

SYSTEMS = ("pendulum", "fish")

SUBSTEPS = 50

SHARDS = 8

QUICK_SHARDS = 2

CHUNKS = 4
"""Chunks of training that are timed, besides the one that compiles."""

QUICK_CHUNKS = 1

REPEATS = 4
"""Number of times the statistics of all transitions are taken again, to tell what grows with them from what does not."""

TRANSITIONS = (1e6, 1e9, 1e12)

NODES = (1, 10, 100, 1_000)

CORES_PER_NODE = 32

NETWORK = 1.25e9
"""Bytes a second between a node and the store: ten gigabits."""

HOUR = 3600.0


def measure(work: Path, is_quick: bool) -> list[dict[str, Any]]:
    """Return a row of costs for each system, in seconds and bytes a transition."""
    rows = []
    for name in SYSTEMS:
        folder = work / f"costs-{name}"
        shutil.rmtree(folder, ignore_errors=True)
        rows.append(_costs(name, folder, is_quick))
    return rows


def project(work: Path, is_quick: bool) -> list[dict[str, Any]]:
    """Return what the costs come to, for numbers of transitions and of nodes; the longest stage is the bottleneck.

    Simulation is spread over all nodes and cores; every node writes to the store at the speed of its network. One machine
    reads, checks and mixes each transition once, and learns from it once.
    """
    rows = []
    for costs in measure(work, is_quick):
        for transitions in TRANSITIONS:
            for nodes in NODES:
                rows.append(_projected(costs, transitions, nodes))
    return rows


def _projected(costs: dict[str, Any], transitions: float, nodes: int) -> dict[str, Any]:
    stored = transitions * costs["bytes_stored"]
    hours = {
        "simulation_h": transitions * costs["simulation_core_s"] / (nodes * CORES_PER_NODE) / HOUR,
        "writing_h": stored / (nodes * NETWORK) / HOUR,
        "reading_h": stored / NETWORK / HOUR,
        "survey_h": transitions * costs["survey_core_s"] / HOUR,
        "shuffle_h": transitions * costs["shuffle_core_s"] / HOUR,
        "training_h": transitions * costs["training_s"] / HOUR,
    }
    bottleneck = max(hours, key=lambda stage: hours[stage]).removesuffix("_h")
    return {
        "system": costs["system"],
        "transitions": transitions,
        "nodes": nodes,
        "stored_TB": stored / 1e12,
        "shards": transitions / costs["transitions_per_shard"],
        **hours,
        "bottleneck": bottleneck,
    }


def _costs(name: str, folder: Path, is_quick: bool) -> dict[str, Any]:
    per_shard = 256 * 36
    shards = QUICK_SHARDS if is_quick else SHARDS
    config = DatasetConfig(
        system=name, substeps=SUBSTEPS, count=shards * per_shard, samples_per_run=36
    )
    system = load_system(name)
    make_shard(system, config, 0, 1)  # compiles
    simulation = _core_seconds(lambda: make_shard(system, config, 1, 1)) / per_shard
    generate(config, folder)
    count = len(read_transitions(folder).states)
    stored = sum(file.stat().st_size for file in folder.glob("shard-*"))
    training = TrainingConfig(memory="400MB")
    data = StoredTransitions(folder, config, system)
    lesson = lesson_of(data, training, None)
    feed = lesson.feed
    pools = feed.pools
    windows = UPDATES_PER_CHUNK * training.batch
    chunks = QUICK_CHUNKS if is_quick else CHUNKS
    next(pools.pools(0))  # compiles
    # A pool serves as many draws as it has windows.
    mixing = _core_seconds(lambda: next(pools.pools(0))) / pools.size
    network = lesson.problem.base.network
    state = TrainingState.fresh(network, make_optimizer(training)).optimizer_state
    spans = []
    for chunk in range(1 + chunks):
        began = time.perf_counter()
        network, state, _ = feed.train(network, state, chunk)
        spans.append(time.perf_counter() - began)
    feed.close()
    seconds = min(spans[1:]) / windows
    return {
        "system": name,
        "substeps": SUBSTEPS,
        "transitions_per_shard": per_shard,
        "bytes_stored": stored / count,
        "simulation_core_s": simulation,
        "survey_core_s": _survey_cost(data, training),
        "shuffle_core_s": mixing,
        "training_s": seconds,
        "cores_that_feed_one_training": simulation / seconds,
    }


def _survey_cost(data: StoredTransitions, config: TrainingConfig) -> float:
    """Return the core seconds that one more transition takes before training: read, checked, and counted in.

    Shape modes and the like cost the same for any number of transitions. Divided by the few there are here they would seem
    to be the bottleneck, so only what grows with the data counts: the difference between reading all once and several times.
    """
    sample = sample_of(data, config)
    parts = list(Survey(data, config).parts())
    count = sum(len(part.states) for part in parts)
    reading = _core_seconds(lambda: list(Survey(data, config).parts()))
    build_emulator(sample, config, parts)  # compiles
    once = _core_seconds(lambda: build_emulator(sample, config, parts))
    often = _core_seconds(lambda: build_emulator(sample, config, (1 + REPEATS) * parts))
    return reading / count + max(0.0, often - once) / (REPEATS * count)


def _core_seconds(action: Callable[[], object]) -> float:
    began = time.process_time()
    action()
    return time.process_time() - began
