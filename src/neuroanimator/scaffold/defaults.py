"""Defaults of every definition that `neuroanimator new` proposes: super step, error of a teacher, spread of angles."""

from __future__ import annotations

import re
from pathlib import Path

from neuroanimator.files.zoo import SHIPPED_SYSTEMS

MAX_USUAL_NAME = 30
"""Maximum number of characters of a name from a file: with `my-` before it, it must be a valid system name."""

WANTED_SUPER_STEP = 0.1
"""Longest proposed super step [s], unless one step is longer: three frames of a film."""

FINE_PARTS = 10
"""Number of parts into which the step is divided for the fine reference of every error."""

MAX_TEACHER_ERROR = 0.002
"""Largest one-step error of a scheme that may teach, as a share of the change's standard deviation."""

MIN_CHANGE = 1e-9
"""Smallest change in a super step by which errors are divided."""

ANGLE_SPREAD = 3.1416
"""Half width that spreads random starts over all angles [rad]: pi, rounded for readability."""

MAX_TURN = 0.5
"""Largest angle by which something should turn in a super step [rad], except in a twentieth of the time."""

SHORT_SUPER_STEP = 0.02
"""Shortest super step proposed for fast motions [s], unless they turn too far in it."""

BEARABLE = 1.5
"""Factor by which angles may turn too far in the shortest super step before controls are narrowed."""

SHARES = (1.0, 0.5, 0.25, 0.125)
"""Shares of their range over which controls are tried, the largest first."""

FASTEST = 95
"""Percentile of the velocities that counts as the fastest."""

PART_TITLES = {
    "physics": "The step the function is called with, or the sampling interval [s].\n"
    "Of a function: truth_step is the dt that teaches, fine_step the one every error is measured against.",
    "state": "The state, part by part. feature: plain, sine (an angle that may turn all the way round) or\n"
    "cyclic (where it is does not matter, how fast it moves does); rate: the part that is its rate of change.",
    "control": "The control, part by part, with its least (low) and greatest (high) values.",
    "sampling": "Random starts: a share of them near rest, spread by a share of the others' spread.",
}
"""Titles of the tables of a step function or recordings."""


def proposed_substeps(step: float) -> int:
    """Return the proposed number of steps of `step` [s] in a super step."""
    return max(1, round(WANTED_SUPER_STEP / step))


def rounded(value: float, digits: int) -> float:
    """Return a number with `digits` significant digits, for readability."""
    return float(f"{value:.{digits}g}")


def usual_name(path: Path) -> str:
    """Return a system's name from its file's: of valid characters only, and not that of a shipped system."""
    name = re.sub("[^a-z0-9_-]+", "-", path.stem.lower()).strip("-_")[:MAX_USUAL_NAME]
    if not name or not name[0].isalpha() or name in SHIPPED_SYSTEMS:
        name = f"my-{name}".rstrip("-")
    return name
