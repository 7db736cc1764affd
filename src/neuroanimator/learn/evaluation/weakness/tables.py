"""Tables of an inspection and of a dataset's coverage, for the terminal and for reports."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from neuroanimator.learn.evaluation.component_errors import by_relative_error
from neuroanimator.learn.evaluation.weakness.coverage import Coverage
from neuroanimator.learn.evaluation.weakness.inspection import Inspection
from neuroanimator.terminal import Rows, TableRows
from neuroanimator.text import short_number

MAX_COMPONENTS = 16
"""Maximum number of rows of state entries, the largest errors first."""

MAX_SPREADS = 40
"""Maximum number of rows of states, and of controls, in tables of spreads."""

COMPONENTS_CAPTION = (
    "Error: root mean square after one super step, in the number's own unit. Change: standard deviation of how much it "
    "changes in a super step. A free body's vectors are along its own axes."
)

COVERAGE_CAPTION = (
    "5 %, 95 %: one sample in twenty lies below, above. Histograms go from the state's 0.5 % to its 99.5 %, of controls "
    "from bound to bound. At a bound: within 1 % of the range from it. What lies outside of all this an emulator "
    "has not seen, and what is rare it knows less well."
)


class CellTable(NamedTuple):
    """Rows of cells by column, and remarks on what is left out."""

    rows: TableRows
    remarks: list[str]


def weak_rows(inspection: Inspection) -> TableRows:
    """Return a row for each condition under which errors are large."""
    rows: TableRows = []
    for spot in inspection.weak_spots:
        rows.append(
            {
                "where": spot.condition,
                "error there": short_number(spot.error),
                "times elsewhere": short_number(spot.ratio),
                "of samples": f"{spot.share:.0%}",
                "of all error": f"{spot.share_of_error:.0%}",
                "most wrong": spot.component,
            }
        )
    return rows


def component_table(inspection: Inspection) -> CellTable:
    """Return the one-step error of each number of the state, the worst first."""
    components = by_relative_error(inspection.components)
    rows: TableRows = []
    for component in components[:MAX_COMPONENTS]:
        rows.append(
            {
                "number": _with_unit(component.name, component.unit),
                "error": short_number(component.error),
                "worst": short_number(component.worst),
                "change": short_number(component.change),
                "error / change": short_number(component.relative or 0.0),
            }
        )
    remarks = []
    left_out = components[MAX_COMPONENTS:]
    if left_out:
        most = left_out[0].relative
        remarks.append(f"{len(left_out)} more have errors of at most {most:.2g} of their change.")
    still = len(inspection.components) - len(components)
    if still:
        remarks.append(f"{still} more change always by the same, and have no error.")
    return CellTable(rows, remarks)


def coverage_facts(found: Coverage) -> Rows:
    """Return the number of runs, the dropped ones, and advice on them."""
    there = f"{found.transitions:,} transitions of {found.runs:,} runs"
    if found.samples < found.transitions:
        there += f"; {found.samples:,} of them looked at"
    facts: Rows = [("there are", there)]
    diverged = found.diverged
    if diverged.runs:
        facts.append(
            (
                "diverged",
                f"{diverged.runs:,} runs, dropped: {short_number(100 * diverged.share)} % of all",
            )
        )
        facts += [("", condition) for condition in diverged.conditions]
        facts.append(("what to do", diverged.advice))
    else:
        facts.append(("diverged", "no run"))
    if found.missing:
        missing = f"{len(found.missing)} shards, such as {found.missing[0]}"
        facts.append(("missing or damaged", missing))
    return facts


def spread_tables(found: Coverage, draw: Callable[[Sequence[float]], str]) -> list[CellTable]:
    """Return a table of states and one of controls: quantiles, the histogram as `draw` draws it, and the share at a bound."""
    tables = []
    for kind, spreads in (("state", found.states), ("control", found.controls)):
        rows: TableRows = []
        for spread in spreads[:MAX_SPREADS]:
            heads = (kind, "histogram", "least", "5 %", "median", "95 %", "most")
            name = _with_unit(spread.name, spread.unit)
            cells = (name, draw(spread.counts.tolist()), *spread.tidy)
            rows.append(dict(zip(heads, cells, strict=True)))
            if spread.at_bounds is not None:
                rows[-1]["at a bound"] = f"{spread.at_bounds:.1%}"
        left_out = len(spreads) - MAX_SPREADS
        if rows:
            remarks = [f"and {left_out} more (--json names them)"] if left_out > 0 else []
            tables.append(CellTable(rows, remarks))
    return tables


def _with_unit(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name} {unit}"
