"""Error over cost: every setting of the physics and the emulators as points in one picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroanimator.evaluation.evaluate import Evaluation
from neuroanimator.evaluation.plots import EMULATOR
from neuroanimator.evaluation.speed import Speed
from neuroanimator.evaluation.speed_function import PYTHON_FUNCTION

COLOURS = {
    "euler": "#2b5a94",
    "symplectic": "#2b5a94",
    "implicitfast": "#4fa3a0",
    "semi-implicit": "#4fa3a0",
    "implicit": "#8a94a0",
    "rk4": "#7a4f9a",
}
"""The colour of each integrator; those of MuJoCo and of mass-spring bodies that are alike share one."""

MIN_ERROR = 1e-6
"""Schemes with a smaller error are not drawn: they are the reference itself."""

MAX_ERROR = 2.0
"""Schemes with a larger error are not drawn: they diverge."""

PANEL_WIDTH = 3.4
"""Width of one panel [inch]."""

PANEL_HEIGHT = PANEL_WIDTH * 0.85
"""Height of one panel [inch]."""

DPI = 110
"""Pixels an inch of a PNG file."""

SMALL = 7
"""Size of labels in a picture of many panels [points]."""


def draw_work_precision(evaluations: list[Evaluation], path: Path) -> None:
    """Draw one panel per system and n to `path`, a PNG or SVG file."""
    systems = sorted({evaluation.system for evaluation in evaluations})
    counts = sorted({evaluation.substeps for evaluation in evaluations})
    size = (PANEL_WIDTH * len(counts), PANEL_HEIGHT * len(systems))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(systems), len(counts), squeeze=False)
    for row, system in enumerate(systems):
        for column, substeps in enumerate(counts):
            chosen = [e for e in evaluations if (e.system, e.substeps) == (system, substeps)]
            _draw_panel(panels[row, column], chosen, f"{system}, n = {substeps}")
    panels[0, 0].legend(frameon=False, fontsize=SMALL)
    path.parent.mkdir(parents=True, exist_ok=True)
    # Without its date an SVG file has the same bytes every time.
    metadata = {"Date": None} if path.suffix == ".svg" else None
    figure.savefig(path, dpi=DPI, metadata=metadata)


def _draw_panel(axes: Axes, evaluations: list[Evaluation], title: str) -> None:
    axes.set_title(title, fontsize=9)
    axes.tick_params(labelsize=SMALL)
    if not evaluations:
        axes.set_axis_off()
        return
    draw_work(axes, evaluations)
    axes.xaxis.label.set_size(SMALL)
    axes.yaxis.label.set_size(SMALL)


def draw_work(axes: Axes, evaluations: list[Evaluation]) -> None:
    """Draw error over cost: the physics' schemes as timed in the first evaluation, and a star for each emulator."""
    speed = evaluations[0].speed
    for integrator in sorted({opponent.scheme.integrator for opponent in speed.opponents}):
        _draw_integrator(axes, speed, integrator)
    costs = [evaluation.emulator_seconds * 1e6 for evaluation in evaluations]
    errors = [evaluation.one_step_error for evaluation in evaluations]
    axes.plot(costs, errors, "*", ms=12, color=EMULATOR, label="emulator")
    axes.set(
        xlabel="cost of one super step [µs]", ylabel="one-step error", xscale="log", yscale="log"
    )


def _draw_integrator(axes: Axes, speed: Speed, integrator: str) -> None:
    """Draw one integrator's steps, from the cheapest on, as a line."""
    points = []
    for opponent in speed.opponents:
        is_drawn = MIN_ERROR < opponent.error < MAX_ERROR
        if opponent.scheme.integrator == integrator and is_drawn:
            points.append((opponent.seconds * 1e6, opponent.error))
    line = np.array(sorted(points)).reshape(-1, 2)
    name = speed.physics
    if speed.physics != PYTHON_FUNCTION:
        name = f"{speed.physics} {integrator}"
    colour = COLOURS.get(integrator)
    axes.plot(line[:, 0], line[:, 1], "o-", ms=3, lw=0.8, color=colour, label=name)
