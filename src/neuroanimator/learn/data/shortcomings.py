"""What data lack, as far as they tell before anything is trained: super steps, velocities, motion like the test's."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from jaxtyping import Float

from neuroanimator.learn.data.config import DatasetConfig, window_length
from neuroanimator.learn.data.recorded_segments import split_runs
from neuroanimator.learn.data.store import Dataset
from neuroanimator.physics.recorded.velocities import MEASURED
from neuroanimator.state.layout import Layout
from neuroanimator.systems.system import System
from neuroanimator.text import listed

PER_NUMBER = 100
"""Number of super steps, for each number of state and control, from which an emulator learns something."""

WILDER = 1.3
"""Reach of what is kept for the test, as a multiple of what is learnt from, from which it is mentioned."""

VELOCITIES = ("rad/s", "m/s")
"""Units of velocities."""


def shortcomings(data: Dataset) -> list[str]:
    """Return what `data` lack, half a sentence each."""
    lacking = shortcomings_of(data.config, data.system)
    if data.held_out is not None:
        names, units = _names_and_units(data.system.state)
        learnt = data.read_part(0).states
        lacking.append(wilder_test(names, units, learnt, data.held_out[0]))
    return [text for text in lacking if text]


def shortcomings_of(config: DatasetConfig, system: System) -> list[str]:
    """Return what the data of `config`, of `system`, will lack, half a sentence each."""
    numbers = system.state.size + system.control.size
    recordings = system.recordings
    if recordings is None:
        lacking = [too_few(config.runs * system.run_steps, numbers, "generate more: --count")]
    else:
        rated = [position for position, _ in system.structure.rates]
        steps = learning_steps(recordings.name, recordings.rows, config.substeps)
        lacking = [
            without_velocities(*_names_and_units(system.state), rated),
            too_few(steps, numbers, RECORD),
        ]
    return [text for text in lacking if text]


RECORD = "record longer"
"""Remedy for recordings from which little can be learnt."""


def learning_steps(name: str, rows: Sequence[int], substeps: int) -> int:
    """Return the number of super steps, one after another, to learn from in runs of `rows` samples of the file `name`."""
    learning = split_runs(name, rows, window_length(substeps)).learning
    return sum(segment.stop - segment.start for segment in learning) // substeps


def too_few(steps: int, numbers: int, remedy: str) -> str:
    """Return half a sentence if `steps` super steps are too few to learn `numbers` numbers from; else nothing."""
    wanted = PER_NUMBER * numbers
    if steps >= wanted:
        return ""
    return (
        f"only {steps:,} super steps to learn {numbers} numbers from, wanted about {wanted:,} "
        f"({remedy}, or expect a poor emulator)"
    )


def without_velocities(names: Sequence[str], units: Sequence[str], rated: Collection[int]) -> str:
    """Return half a sentence if a state holds positions and no velocities; `rated` entries have a rate of change in it."""
    alone = [
        names[entry] for entry, unit in enumerate(units) if unit in MEASURED and entry not in rated
    ]
    if not alone or not set(units).isdisjoint(VELOCITIES):
        return ""
    return (
        f"{listed(alone)}: no column holds a velocity, and positions alone do not say where a limb is going (add velocities, "
        "or let 'new' estimate them: --velocities)"
    )


def wilder_test(
    names: Sequence[str],
    units: Sequence[str],
    learnt: Float[np.ndarray, "*A S"],
    tested: Float[np.ndarray, "*B S"],
) -> str:
    """Return half a sentence if `tested` states go further than those `learnt` from; else nothing. Angles count within a turn."""
    learnt = learnt.reshape(-1, len(names))
    middle = np.median(learnt, axis=0)
    turn = np.where(np.array(units) == "rad", 2 * np.pi, np.inf)
    reach = []
    for states in (learnt, tested.reshape(-1, len(names))):
        away = np.abs(states - middle)
        away = np.minimum(away % turn, turn - away % turn)
        reach.append(away.max(axis=0))
    wild = [
        f"{name} ({far / near:.2g} times as far)"
        for name, near, far in zip(names, *reach, strict=True)
        if far > WILDER * near > 0
    ]
    if not wild:
        return ""
    return (
        f"{listed(wild)}: the pieces kept for the test go further than those to learn from, so errors will be large there "
        "(record more of such motion)"
    )


def _names_and_units(layout: Layout) -> tuple[list[str], list[str]]:
    return [f"state.{part.name}" for part in layout.slices], [part.unit for part in layout.slices]
