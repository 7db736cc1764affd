"""What an inspection says on a terminal: how large the errors are, of which numbers, and where."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from neuroanimator.evaluation.inspection import Inspection

MAX_COMPONENTS = 12
"""So many numbers of the state are shown, those with the largest errors."""


def print_weak_spots(found: Inspection) -> None:
    """Print how the one-step errors are spread, and a line for each condition under which they are large."""
    from neuroanimator.terminal import sparkline
    from neuroanimator.text import print_line, short_number

    errors = found.errors
    median, high, worst = map(short_number, (errors.median, errors.high, errors.worst))
    print_line(
        f"{found.system}: one step is off by less than {median} in half of all super steps, than {high} in 95 %, and by "
        f"{worst} in the worst [standard deviations of the change]."
    )
    print_line(
        f"{found.system}: how often, from {short_number(errors.edges[0])} to {short_number(errors.edges[-1])} "
        f"(logarithmic): |{sparkline(errors.counts.tolist())}|"
    )
    for spot in found.weak_spots:
        print_line(f"{found.system}: {spot}")
    if found.outside.samples:
        print_line(f"{found.system}: {found.outside}")


def print_components(found: Inspection) -> None:
    """Print the one-step error of each number of the state, the worst first."""
    from neuroanimator.evaluation.component_errors import by_relative_error
    from neuroanimator.terminal import print_table
    from neuroanimator.text import print_line, short_number

    components = by_relative_error(found.components)
    rows: list[dict[str, object]] = []
    for component in components[:MAX_COMPONENTS]:
        unit = "" if component.unit == "1" else f" {component.unit}"
        rows.append(
            {
                "number": f"{component.name}{unit}",
                "error": short_number(component.error),
                "worst": short_number(component.worst),
                "change": short_number(component.change),
                "error / change": short_number(component.relative or 0.0),
            }
        )
    print_table(rows)
    left_out = len(components) - MAX_COMPONENTS
    if left_out > 0:
        print_line(f"and {left_out} more with smaller errors (--json names them)")
    print_line(
        "Error: root mean square after a super step. Change: standard deviation of how much it changes in one."
    )
