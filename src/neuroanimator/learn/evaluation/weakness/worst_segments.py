"""The segments of unseen runs with the largest errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.normaliser import MIN_CHANGE
from neuroanimator.learn.evaluation.accuracy import bounded, emulate, root_mean_square
from neuroanimator.learn.evaluation.component_errors import change_names
from neuroanimator.learn.evaluation.held_out import HeldOut
from neuroanimator.state.layout import entry_names

SEGMENT_SECONDS = 1.0
"""Length of a segment, longer where it would hold too few super steps [s]."""

MIN_STEPS = 4
"""Minimum number of super steps in a segment, if runs are long enough."""

SEGMENTS = 4
"""Number of segments that are kept."""

CURVES = 3
"""Number of curves of each segment."""


class Curve(NamedTuple):
    """One number of the state through a segment."""

    name: str
    unit: str
    physics: Float[np.ndarray, " T1"]
    emulated: Float[np.ndarray, " T1"]


@dataclass(frozen=True)
class WorstSegment:
    """A stretch of an unseen run, by the physics and by the emulator from the same state under the same controls."""

    run: int
    start: float
    """Time since the run's start [s]."""
    dt: float
    """Super step [s]."""
    error: float
    """Root mean square error, over the distance of runs from their start in the same time."""
    component: str
    """Name of the number of the state with the largest error in it."""
    curves: tuple[Curve, ...]
    """The numbers with the largest errors over the segment's time, the worst first."""
    physics: Float[np.ndarray, "T1 S"]
    """The states by the physics, or as recorded."""
    emulated: Float[np.ndarray, "T1 S"]
    """The states by the emulator."""
    controls: Float[np.ndarray, "T C"]


def worst_segments(emulator: Emulator, test: HeldOut) -> tuple[WorstSegment, ...]:
    """Return the `SEGMENTS` segments of the test's runs with the largest error, at most one of each run, worst first."""
    runs, total, _ = test.states.shape
    steps = min(max(round(SEGMENT_SECONDS / test.dt), MIN_STEPS), total - 1)
    starts = np.arange(0, total - steps, max(1, steps // 2))
    pieces = starts[:, None] + np.arange(steps + 1)
    segments = runs * len(starts)
    physics = test.states[:, pieces].reshape(segments, steps + 1, test.states.shape[-1])
    controls = test.controls[:, pieces[:, :-1]].reshape(segments, steps, test.controls.shape[-1])
    emulated = emulate(emulator, physics[:, 0], controls)
    relative = _relative(test, physics, emulated)
    errors = root_mean_square(relative, axis=(1, 2)).reshape(runs, len(starts))
    found = []
    for run in np.argsort(-errors.max(axis=1), kind="stable")[:SEGMENTS].tolist():
        piece = int(np.argmax(errors[run]))
        row = run * len(starts) + piece
        wrong = root_mean_square(relative[row])
        found.append(
            WorstSegment(
                run=run,
                start=float(starts[piece]) * test.dt,
                dt=test.dt,
                error=float(errors[run, piece]),
                component=change_names(test.system)[int(np.argmax(wrong))][0],
                curves=_curves(test, wrong, physics[row], emulated[row]),
                physics=physics[row],
                emulated=emulated[row],
                controls=controls[row],
            )
        )
    return tuple(found)


def _relative(
    test: HeldOut, physics: Float[np.ndarray, "B T S"], emulated: Float[np.ndarray, "B T S"]
) -> Float[np.ndarray, "B T V"]:
    """Return the errors over the physics' distance from the start; 0 for what stays there."""
    reach = root_mean_square(test.frame.difference(physics[:, :1], physics), axis=(0, 1))
    moves = reach >= MIN_CHANGE
    with np.errstate(over="ignore", invalid="ignore"):
        errors = test.frame.difference(physics, emulated) / np.where(moves, reach, np.inf)
    return bounded(errors)


def _curves(
    test: HeldOut,
    wrong: Float[np.ndarray, " V"],
    physics: Float[np.ndarray, "F S"],
    emulated: Float[np.ndarray, "F S"],
) -> tuple[Curve, ...]:
    """Return the numbers of largest error `wrong` (V,) as curves: state entries, or rotations since the start about an axis."""
    names = change_names(test.system)
    entries = entry_names(test.system.state)
    pair = (physics, emulated)
    curves = []
    for number in np.argsort(-wrong, kind="stable")[:CURVES].tolist():
        name, unit = names[number]
        if name in entries:
            drawn = [states[:, entries.index(name)] for states in pair]
        else:
            drawn = [test.frame.difference(states[:1], states)[:, number] for states in pair]
        curves.append(Curve(name, unit, *drawn))
    return tuple(curves)
