"""MuJoCo's warnings, which are counted and kept out of a MUJOCO_LOG.TXT, and its fatal errors, raised as ours."""

from __future__ import annotations

import re
import threading
from collections import Counter
from typing import Any

import mujoco

from neuroanimator.errors import BadFileError

MAX_WARNING = 160
"""Maximum number of characters kept of a warning: some repeat a model's names, which may be long."""

MAX_KINDS = 100
"""Maximum number of different warnings counted separately; others count as one, as names could make any number."""

OTHERS = "other warnings"
"""Name of the count of warnings beyond the first `MAX_KINDS`."""

CROWDED = "more contacts at once than fit into memory: let fewer geoms collide, by their contype and conaffinity"
"""Advice on a model whose contacts outgrow MuJoCo's working memory."""

ADVICE = {
    "arena": CROWDED,
    "contact buffer": CROWDED,
    "out of memory": CROWDED,
    "element body weight": (
        "its soft body flies apart: give it less damping, a smaller timestep, softer material, or "
        'integrator="discrete" and solver="CG"'
    ),
    "Inertia matrix": "a body or a joint has next to no inertia: give it some armature or mass",
}
"""Advice on some warnings, by a part of their text."""

CALMER = "a smaller step, or narrower control bounds, would keep them"
"""Advice on the other warnings, which are due to growing numbers."""

_heard: Counter[str] = Counter()


class _Handler:
    """MuJoCo's only warning handler, ours while anyone counts; afterwards the previous one is restored."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counting = 0
        self._before: Any = None

    def __enter__(self) -> None:
        with self._lock:
            if self._counting == 0:
                self._before = mujoco.get_mju_user_warning()
                mujoco.set_mju_user_warning(_hear)
            self._counting += 1

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        with self._lock:
            self._counting -= 1
            if self._counting == 0:
                mujoco.set_mju_user_warning(self._before)
        if isinstance(error, mujoco.FatalError):
            raise BadFileError(fatal_line(error)) from error


warnings_counted = _Handler()
"""`with warnings_counted:` counts MuJoCo's warnings, in all threads, instead of printing and logging them.

A fatal error of MuJoCo becomes a BadFileError: it is due to the model.
"""


def fatal_line(error: mujoco.FatalError) -> str:
    """Return one line about why MuJoCo cannot simulate a model."""
    said = shortened(str(error).partition("\n")[0])
    return f"MuJoCo cannot simulate this model: {said}; {_advice(said, 'correct the model')}."


def warnings_heard() -> Counter[str]:
    """Return how often MuJoCo has given each warning in this process, without the time in the run."""
    return Counter(_heard)


def also_heard(warnings: Counter[str]) -> None:
    """Count MuJoCo's warnings in another process that works for this one."""
    _heard.update(warnings)


def forget_other_than(warnings: Counter[str]) -> None:
    """Count only `warnings` from now on: the others were of what was merely tried."""
    _heard.clear()
    _heard.update(warnings)


def warning_line() -> str:
    """Return one line on MuJoCo's warnings in this process: their number, subject and consequence; empty if none."""
    if not _heard:
        return ""
    count = sum(_heard.values())
    times = f"{count:,} times"
    if count == 1:
        times = "once"
    [(text, _)] = _heard.most_common(1)
    others = len(_heard) - 1
    more = ""
    if others == 1:
        more = " (and one other kind)"
    elif others > 1:
        more = f" (and {others} other kinds)"
    return f"MuJoCo warned {times}: {text}{more}. Runs that diverged were dropped, or count as failed; {_advice(text, CALMER)}."


def _advice(complaint: str, otherwise: str) -> str:
    """Return the advice on a warning; `otherwise` for one that is not in `ADVICE`."""
    for part, advice in ADVICE.items():
        if part in complaint:
            return advice
    return otherwise


def _hear(text: str) -> None:
    """Count a warning: MuJoCo calls this with its text."""
    warning = shortened(text)
    if warning not in _heard and len(_heard) >= MAX_KINDS:
        warning = OTHERS
    _heard[warning] += 1


def shortened(text: str) -> str:
    """Return a warning without what differs from run to run (its time and joint), and without its standard advice."""
    line = " ".join(str(text).split())
    line = line.replace("The simulation is unstable.", "")
    line = re.sub(r"Time = \S+| at (DOF|actuator) \d+", "", line)
    return line[:MAX_WARNING].rstrip(". ")
