"""Error over cost: every MuJoCo setting and the emulators as points in one picture."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroanimator.evaluation.evaluate import Evaluation

EMULATOR = "#e8892b"
COLOURS = {"euler": "#2b5a94", "implicitfast": "#4fa3a0", "implicit": "#8a94a0", "rk4": "#7a4f9a"}
PANEL = 3.4
"""[inch] Side of one panel."""


def draw_work_precision(evaluations: list[Evaluation], path: Path) -> None:
    """Draw one panel per system and n to `path`, a PNG or SVG file."""
    systems = sorted({e.system for e in evaluations})
    counts = sorted({e.substeps for e in evaluations})
    figure = Figure(figsize=(PANEL * len(counts), PANEL * len(systems) * 0.85), layout="constrained")
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
    for integrator, colour in COLOURS.items():
        rivals = [o for o in evaluations[0].speed.opponents if o.scheme.integrator == integrator]
        points = sorted((o.seconds * 1e6, o.error) for o in rivals if 1e-6 < o.error < 2)
        cost, error = [x for x, _ in points], [y for _, y in points]
        axes.plot(cost, error, "o-", ms=3, lw=0.8, color=colour, label=f"MuJoCo {integrator}")
    axes.plot(
        [e.emulator_seconds * 1e6 for e in evaluations],
        [e.one_step_error for e in evaluations],
        "*", ms=12, color=EMULATOR, label="emulator",
    )  # fmt: skip
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel("cost of one super step [µs]", fontsize=7)
    axes.set_ylabel("one-step error", fontsize=7)
