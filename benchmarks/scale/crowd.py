"""Thousands of bodies on one machine: schools that a policy drives, and Gymnasium's vector environments."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator import load_policy
from neuroanimator.codegen.cores import CORES, core_count
from neuroanimator.control.policies.closed_loop import rollout_on_emulator
from neuroanimator.control.policies.school import school_start
from neuroanimator.gym import EmulatorVectorEnv

COUNTS = (1, 10, 100, 1_000, 10_000)

QUICK_COUNTS = (1, 100, 1_000)

STEPS = 20
"""Super steps in a turn."""

ROUNDS = 7
"""Number of turns of each number of cores, one after the other."""

QUICK_ROUNDS = 2

Turn = Callable[[], float]
"""Makes `STEPS` super steps of all bodies and returns how much motion that was [s]."""


def measure(_: Path, is_quick: bool) -> list[dict[str, Any]]:
    """Return a row for each kind and number of bodies: seconds of motion of all of them in a second, on one core and on all."""
    counts = QUICK_COUNTS if is_quick else COUNTS
    rounds = QUICK_ROUNDS if is_quick else ROUNDS
    rows = []
    kinds = {"fish, a school": _school, "fish, gym": _fish, "truck, gym": _trucks}
    for count in counts:
        for kind, make in kinds.items():
            rows.append(_row(kind, count, make(count), rounds))
    return rows


def _row(kind: str, count: int, turn: Turn, rounds: int) -> dict[str, Any]:
    every_core = core_count()
    seconds: dict[int, list[float]] = {1: [], every_core: []}
    motion = turn()  # compiles
    for _ in range(rounds):
        for cores, spans in seconds.items():
            os.environ[CORES] = str(cores)
            began = time.perf_counter()
            turn()
            spans.append(time.perf_counter() - began)
    del os.environ[CORES]
    one = float(np.median(seconds[1]))
    every = float(np.median(seconds[every_core]))
    return {
        "bodies": kind,
        "count": count,
        "motion_per_s_1_core": motion / one,
        f"motion_per_s_{every_core}_cores": motion / every,
        "images_per_s": STEPS / every,
        "us_per_body_and_step": 1e6 * every / (STEPS * count),
        "peak_resident_GB": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e9,
    }


def _school(count: int) -> Turn:
    """Return turns of a school that swims along together; an image is one super step of all of it."""
    policy = load_policy("fish")
    starts, behaviour = school_start(policy, count, 0)

    def turn() -> float:
        np.asarray(rollout_on_emulator(policy, behaviour, starts, STEPS))
        return STEPS * policy.dt

    return turn


def _fish(count: int) -> Turn:
    return _environments("fish-50", count)


def _trucks(count: int) -> Turn:
    return _environments("truck-50", count)


def _environments(emulator: str, count: int) -> Turn:
    """Return turns of environments under random actions, resets among them."""
    environments = EmulatorVectorEnv(emulator, num_envs=count)
    environments.reset(seed=0)
    environments.action_space.seed(0)
    actions = [environments.action_space.sample() for _ in range(STEPS)]

    def turn() -> float:
        for action in actions:
            environments.step(action)
        return STEPS * environments.emulator.dt

    return turn
