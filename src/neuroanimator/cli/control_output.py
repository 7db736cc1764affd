"""Output of `control` about the start of a motion and the time it took."""

from __future__ import annotations

import numpy as np

from neuroanimator.systems.system import System
from neuroanimator.terminal import Rows, phase_seconds, seconds_in_all

MAX_PARTS_TOLD = 6
"""Maximum number of parts of a start that are listed by name: more would be a swimmer's mass points."""

MIN_PHASE_TOLD = 0.1
"""Minimum duration of a phase that is listed [s]."""


def start_in_words(system: System, start: np.ndarray) -> str:
    """Return the parts of `start` (S,) that differ from rest, with their numbers and units."""
    told = []
    for part in system.state.slices:
        entries = system.state.index(part.name)
        if (start[entries] != system.rest[entries]).any():
            numbers = ", ".join(f"{number:.4g}" for number in start[entries])
            told.append(f"{part.name} {numbers} {part.unit}")
    if len(told) > MAX_PARTS_TOLD:
        return f"{len(told)} parts of the state other than at rest"
    return "; ".join(told) or "at rest"


def time_rows() -> Rows:
    """Return the total time and the longest phases."""
    phases = sorted(phase_seconds().items(), key=lambda item: -item[1])
    told = ", ".join(
        f"{name} {seconds:.1f}" for name, seconds in phases if seconds >= MIN_PHASE_TOLD
    )
    total = f"{seconds_in_all():.1f} s"
    return [("total time", f"{total}: {told}" if told else total)]
