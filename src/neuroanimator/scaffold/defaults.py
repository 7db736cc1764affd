"""Defaults of every definition that `neuroanimator new` proposes: super step, error of a teacher, spread of angles."""

from __future__ import annotations

import re
from pathlib import Path

from neuroanimator.systems import SYSTEMS

MAX_USUAL_NAME = 30
"""Characters of a name taken from a file: with `my-` before it, it may be a system's."""

WANTED_SUPER_STEP = 0.1
"""A proposed super step lasts at most about this long [s], and never less than one step: three pictures of a film."""

MAX_TEACHER_ERROR = 0.002
"""A scheme may teach if its one-step error is at most this share of the change's standard deviation."""

ANGLE_SPREAD = 3.1416
"""This half width [rad] spreads random starts over all angles; it is pi, rounded for people to read."""

MAX_TURN = 0.5
"""Nothing should turn farther than this in a super step [rad], but in a twentieth of the time."""

FASTEST = 95
"""This percentile of the velocities counts as the fastest that occurs."""


def proposed_substeps(step: float) -> int:
    """Return how many steps of `step` [s] a super step should have."""
    return max(1, round(WANTED_SUPER_STEP / step))


def tidy(value: float, digits: int = 12) -> float:
    """Return a number without the last digits that arithmetic leaves, for people to read."""
    return float(f"{value:.{digits}g}")


def usual_name(path: Path) -> str:
    """Return the name of a system by its file: of valid characters only, and no name of a system of the package."""
    name = re.sub("[^a-z0-9_-]+", "-", path.stem.lower()).strip("-_")[:MAX_USUAL_NAME]
    if not name or not name[0].isalpha() or name in SYSTEMS:
        name = f"my-{name}".rstrip("-")
    return name
