"""The baselines' runs as a picture: J on the true physics over time and over physics steps."""

from __future__ import annotations

import io
from pathlib import Path
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.control.baselines.run_baseline import BaselineRun
from neuroanimator.control.synthesis.synthesise import Synthesis
from neuroanimator.files.atomic import write_whole

WIDTH = 11.0
"""Width of the picture [in]."""

PANEL_HEIGHT = 1.9
"""Height of each task's part of the picture [in]."""

DPI = 110
"""Pixels an inch: the picture is as wide as a page."""

COLOURS = {
    "annealing": "#2b5a94",
    "cma-es": "#e8892b",
    "genetic": "#8a8d2f",
    "ilqr": "#4fa3a0",
    "nelder-mead": "#7a4f9a",
}
"""The colour of each baseline's curve."""


class Panel(NamedTuple):
    """What is drawn of a task."""

    task: str
    synthesis: Synthesis
    """What was found through the emulator."""
    seconds: float
    """What that took."""
    runs: list[BaselineRun]


def draw_runs(panels: list[Panel], path: Path) -> None:
    """Draw for each task how J fell in its first runs: baselines as curves, the emulator as a star."""
    figure = Figure(figsize=(WIDTH, PANEL_HEIGHT * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), 2, squeeze=False)
    for (by_time, by_steps), panel in zip(axes, panels, strict=True):
        _draw_panel(by_time, by_steps, panel)
    axes[-1, 0].set_xlabel("seconds, compiling excluded")
    axes[-1, 1].set_xlabel("physics steps")
    axes[0, 0].legend(fontsize="small")
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=DPI)
    write_whole(path, picture.getvalue())


def _draw_panel(by_time: Axes, by_steps: Axes, panel: Panel) -> None:
    for run in panel.runs:
        colour = COLOURS[run.name]
        costs = [point.cost for point in run.curve]
        seconds = [point.seconds for point in run.curve]
        steps = [point.physics_steps for point in run.curve]
        by_time.step(seconds, costs, where="post", color=colour, label=run.name)
        by_steps.step(steps, costs, where="post", color=colour)
    cost = panel.synthesis.outcome.cost_physics
    by_time.plot(panel.seconds, cost, "k*", markersize=11, label="emulator")
    by_steps.plot(panel.synthesis.spent.physics_steps, cost, "k*", markersize=11)
    by_time.set_ylabel(f"{panel.task}\nJ on the physics")
    for axis in (by_time, by_steps):
        axis.set_xscale("log")
        axis.set_yscale("log")
