"""The curve of a training, as part of a page: from the metrics that lie beside the emulator it made."""

from __future__ import annotations

import html
from functools import partial
from pathlib import Path

from matplotlib.axes import Axes

from neuroanimator.evaluation.plots import EMULATOR, QUIET, plot
from neuroanimator.text import printable
from neuroanimator.training.train import Report, read_metrics, run_folder

CURVE_CAPTION = (
    "Errors are of runs that training never saw, root mean squares over all numbers that move, in standard deviations of "
    "their change in a super step: after one super step, and after as many as training unrolls. The loss is what training "
    "descends: where it goes on falling and the errors do not, more data helps, and more updates do not."
)
"""What stands below the curve."""

NO_METRICS = (
    "No curve: {} does not lie beside the emulator, as it does where an emulator was trained."
)
"""What is said of an emulator that came alone."""


def training_html(emulator: Path) -> str:
    """Return the curve of the training that made the file `emulator`; a line that says so where nothing is known of it."""
    path = run_folder(emulator) / "metrics.jsonl"
    reports = read_metrics(path)
    if not reports:
        told = NO_METRICS.format(printable(f"{path.parent.name}/{path.name}"))
        return f"<p>{html.escape(told)}</p>"
    last = reports[-1]
    told = f"{last.update:,} updates. {CURVE_CAPTION}"
    return f"{plot(partial(draw_training, reports=reports))}<p>{html.escape(told)}</p>"


def draw_training(axes: Axes, reports: list[Report]) -> None:
    """Draw loss and errors over the updates."""
    updates = [report.update for report in reports]
    losses = [report.loss for report in reports]
    errors = [report.error for report in reports]
    unrolled = [report.unrolled_error for report in reports]
    axes.plot(updates, errors, color=EMULATOR, label="error after one super step")
    axes.plot(updates, unrolled, color=EMULATOR, ls="--", label="error after the longest unroll")
    axes.plot(updates, losses, color=QUIET, lw=1, label="loss")
    axes.set(xlabel="update", ylabel="error, loss", yscale="log")
    axes.legend(frameon=False)
