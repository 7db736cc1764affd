"""The part of a report that says where an emulator is good and where it is weak."""

from __future__ import annotations

import html
from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from neuroanimator.data.coverage import Coverage, Spread
from neuroanimator.emulator.trust import EDGE
from neuroanimator.evaluation.component_errors import ErrorSpread, by_relative_error
from neuroanimator.evaluation.inspection import Inspection
from neuroanimator.evaluation.plots import EMULATOR, PHYSICS, QUIET, inline_svg, plot, small_bars
from neuroanimator.evaluation.trust_bands import TrustBand
from neuroanimator.evaluation.weak_spots import WeakSpot
from neuroanimator.evaluation.worst_curves import draw_segments
from neuroanimator.text import short_number

MAX_COMPONENTS = 16
"""So many numbers of the state are shown, those with the largest errors."""

MAX_SPREADS = 40
"""So many numbers of the data are shown."""

ERRORS_CAPTION = (
    "How often which one-step error occurs on unseen runs, against {}. Errors are the root mean square over all numbers "
    "that move, each in standard deviations of its change in a super step: at 1 the emulator knows no more than how much "
    "things change on average."
)

WEAK_CAPTION = (
    "Mean errors where a condition holds, over those elsewhere, within what training showed. Conditions are chosen on half "
    "of the runs and measured on the other half; one that does not hold there is not told. They may overlap. What helps: "
    "more data there (the [sampling] and [control] tables), a shorter super step, a wider network, or longer training."
)

TRUST_CAPTION = (
    "One-step errors of unseen super steps, in bands of like scores (<code>emulator.trust</code>, "
    "<code>animate --trust</code>): where the lines rise, the score tells. 99 of a hundred super steps as in training "
    "score at most 1. Within the edge an error may be large all the same: the score says where to look, and is no bound."
)

COMPONENTS_CAPTION = (
    "Error: root mean square after one super step, in the number's own unit. Change: standard deviation of how much it "
    "changes in a super step. Relative: the one over the other. A free body's vectors are told along its own axes."
)

WORST_CAPTION = (
    "The unseen segments with the largest errors, physics and emulator from the same state under the same controls. "
    "Drawn are the numbers that are most wrong. Errors are over how far runs get in this time."
)

COVERAGE_CAPTION = (
    "5 % and 95 %: one sample in twenty lies below, above. Histograms go from the state's 0.5 % to its 99.5 %, of controls "
    "from bound to bound. At a bound: within 1 % of the range from it. What lies outside of all this the emulator "
    "has not seen, and what is rare it knows less well."
)


def inspection_html(inspection: Inspection) -> str:
    """Return the sections of one emulator."""
    truth = "the recordings" if inspection.is_recorded else "the physics that teaches emulators"
    curves = inline_svg(draw_segments(inspection.worst, inspection.truth_name))
    parts = [
        "<h3>How large its errors are</h3>",
        plot(partial(_draw_errors, spread=inspection.errors)),
        f"<p>{_spread_sentence(inspection)} {ERRORS_CAPTION.format(truth)}</p>",
        "<h3>Where it is weak</h3>",
        _weak_table(inspection.weak_spots),
        f"<p>Of {inspection.samples:,} samples: {html.escape(str(inspection.outside))}.</p>",
        *_trust_parts(inspection),
        "<h3>Error of each number</h3>",
        _component_table(inspection),
        "<h3>Its worst cases</h3>",
        f"<div class=wide>{curves}</div>",
        f"<p>{WORST_CAPTION}</p>",
        f"<h3>What {'the data' if inspection.has_data else 'unseen runs'} cover</h3>",
        _coverage_tables(inspection.coverage, has_data=inspection.has_data),
    ]
    return "".join(parts)


def _draw_errors(axes: Axes, spread: ErrorSpread) -> None:
    axes.stairs(spread.counts, spread.edges, fill=True, color=EMULATOR)
    for value, label, style in (
        (spread.median, "median", "-"),
        (spread.high, "95 %", "--"),
        (spread.worst, "worst", ":"),
    ):
        if 0 < value < np.inf:
            axes.axvline(value, color=PHYSICS, ls=style, lw=1.2, label=f"{label}: {value:.2g}")
    axes.set(
        xlabel="one-step error [standard deviations of the change]",
        ylabel="super steps",
        xscale="log",
    )
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False)


def _trust_parts(inspection: Inspection) -> list[str]:
    """Return the section that says how errors grow with the score; nothing where there are no scores."""
    if not inspection.trust:
        return []
    picture = plot(partial(_draw_trust, bands=inspection.trust))
    return ["<h3>Whether its trust may be gone by</h3>", picture, f"<p>{TRUST_CAPTION}</p>"]


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


def _spread_sentence(inspection: Inspection) -> str:
    errors = inspection.errors
    return (
        f"{inspection.samples:,} super steps of {inspection.runs:,} unseen runs: median {errors.median:.2g}, 95 % below "
        f"{errors.high:.2g}, worst {errors.worst:.2g}."
    )


def _weak_table(spots: tuple[WeakSpot, ...]) -> str:
    if not spots:
        return (
            "<p>No condition was found under which its error is half as large again as elsewhere: it errs alike "
            "everywhere, or where no single number tells.</p>"
        )
    heads = ("where", "error there", "times elsewhere", "of samples", "of all error", "most wrong")
    rows = []
    for spot in spots:
        rows.append(
            (
                spot.condition,
                short_number(spot.error),
                short_number(spot.ratio),
                f"{spot.share:.0%}",
                f"{spot.share_of_error:.0%}",
                spot.component,
            )
        )
    return f"{_table(heads, rows)}<p>{WEAK_CAPTION}</p>"


def _component_table(inspection: Inspection) -> str:
    components = by_relative_error(inspection.components)
    heads = ("number", "unit", "error", "worst", "change", "relative")
    rows = []
    for component in components[:MAX_COMPONENTS]:
        rows.append(
            (
                component.name,
                component.unit,
                short_number(component.error),
                short_number(component.worst),
                short_number(component.change),
                short_number(component.relative or 0.0),
            )
        )
    remarks = []
    left_out = components[MAX_COMPONENTS:]
    if left_out:
        most = left_out[0].relative
        remarks.append(f"{len(left_out)} more have relative errors of at most {most:.2g}.")
    still = len(inspection.components) - len(components)
    if still:
        remarks.append(f"{still} more never move, and have no error.")
    return f"{_table(heads, rows)}<p>{' '.join([*remarks, COMPONENTS_CAPTION])}</p>"


def _coverage_tables(found: Coverage, *, has_data: bool) -> str:
    words = f"{found.samples:,} samples of {found.runs:,} runs."
    if not has_data:
        words += " No data were given (--data); unseen runs are drawn as data are."
    diverged = found.diverged
    if diverged.runs:
        conditions = "; ".join(diverged.conditions)
        words += f" {diverged.runs:,} runs diverged and were dropped ({diverged.share:.2g} of all)"
        words += f": {conditions}. " if conditions else ". "
        words += f"What to do: {diverged.advice}."
    states = _spread_table("state", found.states)
    controls = _spread_table("control", found.controls)
    return f"{states}{controls}<p>{html.escape(words)} {COVERAGE_CAPTION}</p>"


def _spread_table(kind: str, spreads: Sequence[Spread]) -> str:
    if not spreads:
        return ""
    heads = [kind, "unit", "least", "5 %", "median", "95 %", "most"]
    bounded = spreads[0].at_bounds is not None
    if bounded:
        heads.append("at a bound")
    rows = []
    for spread in spreads[:MAX_SPREADS]:
        row = [spread.name, spread.unit, *spread.tidy]
        if bounded:
            row.append(f"{spread.at_bounds or 0:.1%}")
        rows.append(row)
    bars = [small_bars(spread.counts.tolist()) for spread in spreads[:MAX_SPREADS]]
    left_out = len(spreads) - MAX_SPREADS
    more = f"<p>and {left_out} more.</p>" if left_out > 0 else ""
    return _table(heads, rows, ("histogram", bars)) + more


def _table(
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    pictures: tuple[str, list[str]] | None = None,
) -> str:
    """Return a table whose cells are text; `pictures`, a head and SVG for each row, come second in it."""
    head = [f"<th>{html.escape(text)}</th>" for text in heads]
    if pictures:
        head.insert(1, f"<th>{pictures[0]}</th>")
    lines = [f"<tr>{''.join(head)}</tr>"]
    for number, row in enumerate(rows):
        cells = [f"<td>{html.escape(text)}</td>" for text in row]
        if pictures:
            cells.insert(1, f"<td>{pictures[1][number]}</td>")
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return f"<div class=wide><table>{''.join(lines)}</table></div>"
