"""Error over cost: every setting of the physics and the emulators as points in one picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroanimator.evaluation.evaluate import Evaluation
from neuroanimator.evaluation.speed_function import PYTHON_FUNCTION

EMULATOR = "#e8892b"
COLOURS = {"euler": "#2b5a94", "implicitfast": "#4fa3a0", "implicit": "#8a94a0", "rk4": "#7a4f9a"}
COLOURS |= {"symplectic": COLOURS["euler"], "semi-implicit": COLOURS["implicitfast"]}
MIN_ERROR, MAX_ERROR = 1e-6, 2.0
"""Between them lie the schemes drawn: finer ones are the reference itself, coarser ones blow up."""
PANEL = 3.4
"""[inch] Side of one panel."""


def draw_work_precision(evaluations: list[Evaluation], path: Path) -> None:
    """Draw one panel per system and n to `path`, a PNG or SVG file."""
    systems = sorted({e.system for e in evaluations})
    counts = sorted({e.substeps for e in evaluations})
    figure = Figure(
        figsize=(PANEL * len(counts), PANEL * len(systems) * 0.85), layout="constrained"
    )
    panels = figure.subplots(len(systems), len(counts), squeeze=False)
    for row, system in enumerate(systems):
        for column, substeps in enumerate(counts):
            chosen = [e for e in evaluations if (e.system, e.substeps) == (system, substeps)]
            _draw_panel(panels[row, column], chosen, f"{system}, n = {substeps}")
    panels[0, 0].legend(frameon=False, fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Date": None} if path.suffix == ".svg" else None)


def _draw_panel(axes: Axes, evaluations: list[Evaluation], title: str) -> None:
    axes.set_title(title, fontsize=9)
    axes.tick_params(labelsize=7)
    if not evaluations:
        axes.set_axis_off()
        return
    draw_work(axes, evaluations)
    axes.xaxis.label.set_size(7)
    axes.yaxis.label.set_size(7)


def draw_work(axes: Axes, evaluations: list[Evaluation]) -> None:
    """Draw error over cost: the physics' schemes as timed in the first evaluation, and a star for each emulator."""
    speed = evaluations[0].speed
    for integrator in sorted({o.scheme.integrator for o in speed.opponents}):
        points = sorted(
            (o.seconds * 1e6, o.error) for o in speed.opponents if o.scheme.integrator == integrator
        )
        shown = np.array([point for point in points if MIN_ERROR < point[1] < MAX_ERROR]).reshape(
            -1, 2
        )
        name = (
            speed.physics if speed.physics == PYTHON_FUNCTION else f"{speed.physics} {integrator}"
        )
        axes.plot(*shown.T, "o-", ms=3, lw=0.8, color=COLOURS.get(integrator), label=name)
    stars = [(e.emulator_seconds * 1e6, e.one_step_error) for e in evaluations]
    axes.plot(*np.array(stars).T, "*", ms=12, color=EMULATOR, label="emulator")
    axes.set(
        xlabel="cost of one super step [µs]", ylabel="one-step error", xscale="log", yscale="log"
    )
