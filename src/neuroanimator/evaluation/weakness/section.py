"""The section of a report on an inspection: its tables, its plots and the curves of its worst cases."""

from __future__ import annotations

import html
from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroanimator.emulator.trust import EDGE
from neuroanimator.evaluation.component_errors import ErrorSpread
from neuroanimator.evaluation.page import facts_html, table_html
from neuroanimator.evaluation.plots import (
    EMULATOR,
    PHYSICS,
    QUIET,
    WIDTH,
    inline_svg,
    plot,
    small_bars,
)
from neuroanimator.evaluation.trust_bands import TrustBand
from neuroanimator.evaluation.weakness.inspection import Inspection
from neuroanimator.evaluation.weakness.tables import (
    COMPONENTS_CAPTION,
    COVERAGE_CAPTION,
    component_table,
    coverage_facts,
    spread_tables,
    weak_rows,
)
from neuroanimator.evaluation.weakness.worst_segments import Curve, Segment
from neuroanimator.text import printable

ERRORS_CAPTION = (
    "How often which one-step error occurs on unseen runs, against {}. Errors are the root mean square over all numbers "
    "that move, each in standard deviations of its change in a super step: at 1 the emulator knows no more than how much "
    "things change on average."
)

WEAK_CAPTION = (
    "Mean errors where a condition holds, over those elsewhere, within what training showed. Conditions are chosen on half "
    "of the runs and measured on the other half; one that does not hold there is not listed. They may overlap. What helps: "
    "more data there (the [sampling] and [control] tables), a shorter super step, a wider network, or longer training."
)

NOT_WEAK = (
    "No condition was found under which its error is half as large again as elsewhere: it errs alike everywhere, or where no "
    "single number tells."
)

TRUST_CAPTION = (
    "One-step errors of unseen super steps, in bands of like scores (<code>emulator.trust</code>, "
    "<code>animate --trust</code>): where the lines rise, they do. 99 of a hundred super steps as in training "
    "score at most 1. Within the edge an error may be large all the same: the score says where to look, and is no bound."
)

WORST_CAPTION = (
    "The unseen segments with the largest errors, physics and emulator from the same state under the same controls. "
    "Drawn are the numbers that are most wrong. Errors are over how far runs get in this time."
)

ROW_HEIGHT = 1.9
"""Height of a row of curves [inch]."""

SMALL = 8
"""Size of labels [points]."""

MARGIN = 0.1
"""Room above and below the physics and a sound emulator, over their range."""

MAX_OVER = 3.0
"""Distance from the physics' range, over that range, beyond which an emulator is drawn out of the picture."""


def inspection_html(inspection: Inspection) -> str:
    """Return the sections of one emulator."""
    truth = "the recordings" if inspection.is_recorded else "the physics that teaches emulators"
    outside = f"Of {inspection.samples:,} samples: {html.escape(str(inspection.outside))}."
    spots = f"<p>{NOT_WEAK}</p>"
    if inspection.weak_spots:
        spots = f"{table_html(weak_rows(inspection))}<p>{WEAK_CAPTION}</p>"
    trust = ""
    if inspection.trust:
        picture = plot(partial(_draw_trust, bands=inspection.trust))
        trust = f"<h3>Whether its trust scores predict errors</h3>{picture}<p>{TRUST_CAPTION}</p>"
    components = component_table(inspection)
    parts = [
        "<h3>How large its errors are</h3>",
        plot(partial(_draw_errors, spread=inspection.errors)),
        f"<p>{inspection.samples:,} super steps of {inspection.runs:,} unseen runs: {inspection.errors}. "
        f"{ERRORS_CAPTION.format(truth)}</p>",
        f"<h3>Where it is weak</h3>{spots}<p>{outside}</p>{trust}",
        f"<h3>Error of each number</h3>{table_html(components.rows)}",
        f"<p>{' '.join([*components.remarks, COMPONENTS_CAPTION])}</p>",
        "<h3>Its worst cases</h3>",
        f"<div class=wide>{inline_svg(draw_segments(inspection.worst, inspection.truth_name))}</div>",
        f"<p>{WORST_CAPTION}</p>",
        f"<h3>What {'the data' if inspection.has_data else 'unseen runs'} cover</h3>",
        facts_html(coverage_facts(inspection.coverage)),
    ]
    for table in spread_tables(inspection.coverage, small_bars):
        parts.append(table_html(table.rows, pictures="histogram"))
        parts += [f"<p>{remark}</p>" for remark in table.remarks]
    return "".join([*parts, f"<p>{COVERAGE_CAPTION}</p>"])


def _draw_errors(axes: Axes, spread: ErrorSpread) -> None:
    axes.stairs(spread.counts, spread.edges, fill=True, color=EMULATOR)
    marks = {"median": spread.median, "95 %": spread.high, "worst": spread.worst}
    for (label, value), style in zip(marks.items(), ("-", "--", ":"), strict=True):
        if 0 < value < np.inf:
            axes.axvline(value, color=PHYSICS, ls=style, lw=1.2, label=f"{label}: {value:.2g}")
    axes.set(
        xlabel="one-step error [standard deviations of the change]",
        ylabel="super steps",
        xscale="log",
    )
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False)


def _draw_trust(axes: Axes, bands: Sequence[TrustBand]) -> None:
    middles = [band.middle for band in bands]
    axes.plot(middles, [band.median for band in bands], "o-", color=EMULATOR, label="median")
    large = [band.large for band in bands]
    axes.plot(middles, large, "o--", color=QUIET, label="95 % are below")
    axes.axvline(EDGE, color=PHYSICS, ls=":", lw=1.2, label="edge of training")
    axes.set(
        xlabel="trust: score of a super step",
        ylabel="one-step error [standard deviations]",
        xscale="log",
        yscale="log",
    )
    axes.legend(frameon=False)


def draw_segments(segments: Sequence[Segment], truth_name: str = "physics") -> Figure:
    """Return a figure with a row for each segment: the numbers that are most wrong in it, by physics and emulator.

    `truth_name` is what the legend calls the physics.
    """
    size = (WIDTH, ROW_HEIGHT * len(segments))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(segments), len(segments[0].curves), squeeze=False)
    for row, segment in zip(panels, segments, strict=True):
        times = segment.start + np.arange(len(segment.physics)) * segment.dt
        for axes, curve in zip(row, segment.curves, strict=True):
            axes.plot(times, curve.physics, color=PHYSICS, lw=1.2, label=truth_name)
            axes.plot(times, curve.emulated, "o-", color=EMULATOR, ms=2, lw=0.6, label="emulator")
            # Matplotlib reads what is between dollars as formulas.
            label = printable(f"{curve.name} [{curve.unit}]").replace("$", r"\$")
            axes.set_ylabel(label, fontsize=SMALL)
            axes.set_ylim(*_limits(curve))
            axes.tick_params(labelsize=SMALL)
        title = f"run {segment.run + 1}, from {segment.start:.2g} s: error {segment.error:.2g}"
        row[0].set_title(title, fontsize=SMALL, loc="left")
    for axes in panels[-1]:
        axes.set_xlabel("time [s]", fontsize=SMALL)
    panels[0, 0].legend(frameon=False, fontsize=SMALL)
    return figure


def _limits(curve: Curve) -> tuple[float, float]:
    """Return the ends of the vertical axis: all of the physics, and of the emulator what is not far away."""
    low = curve.physics.min()
    high = curve.physics.max()
    reach = MAX_OVER * max(high - low, 1e-9)
    sound = curve.emulated[np.isfinite(curve.emulated)]
    drawn = [*curve.physics, *np.clip(sound, low - reach, high + reach)]
    room = MARGIN * max(max(drawn) - min(drawn), 1e-9)
    return min(drawn) - room, max(drawn) + room
