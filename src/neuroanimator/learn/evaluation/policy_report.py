"""The report of a policy: how it learnt, and its returns, as one page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from neuroanimator.learn.evaluation.page import write_page
from neuroanimator.learn.evaluation.plots import EMULATOR, PHYSICS

Returns = Float[np.ndarray, " E"]
"""Return of each of E episodes."""


def write_policy_report(
    path: Path,
    rows: Sequence[tuple[str, object]],
    curve: Sequence[tuple[float, float]],
    returns: Returns,
    inside: Returns,
) -> None:
    """Write `path`: facts in `rows`, a `curve` of (super steps, mean return), returns on the physics and inside the emulator."""
    write_page(
        path,
        "policy.html",
        rows=rows,
        curve=curve,
        returns=returns,
        inside=inside,
        draw_learning=draw_learning,
        draw_returns=draw_returns,
    )


def draw_learning(axes: Axes, curve: Sequence[tuple[float, float]]) -> None:
    """Draw a policy's mean return against the super steps it learnt from."""
    axes.plot(*zip(*curve, strict=True), "o-", ms=3, color=PHYSICS)
    axes.set(xlabel="super steps of the physics", ylabel="mean return")


def draw_returns(axes: Axes, returns: Returns, inside: Returns) -> None:
    """Draw the returns of episodes on the physics, and of those inside the emulator, sorted."""
    axes.plot(np.sort(returns), color=PHYSICS, label="physics")
    axes.plot(np.sort(inside), color=EMULATOR, label="emulator")
    axes.set(xlabel="episode", ylabel="return")
