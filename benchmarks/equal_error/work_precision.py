"""Error over cost: every setting of the physics and the emulators as points in one picture."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroanimator.learn.evaluation.evaluate import Evaluation
from neuroanimator.learn.evaluation.figures import draw_work

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
