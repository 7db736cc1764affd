"""Goals: states, or parts of states, to reach."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from neuroanimator.errors import ArgumentError
from neuroanimator.state.layout import Layout
from neuroanimator.text import listed

if TYPE_CHECKING:  # pydantic takes a tenth of a second to import, and an emulator does not need it
    from neuroanimator.definitions.parts import GoalTable

GOAL_TOLERANCE = 0.1
"""Default tolerance of a part of a goal, in the part's own unit."""


@dataclass(frozen=True)
class Goal:
    """A state, or part of one, to reach."""

    values: tuple[tuple[int, float], ...]
    """(state entry, wanted value) pairs; all four entries of a quaternion or none."""
    tolerances: tuple[float, ...]
    """Tolerance of each pair in its unit (for a quaternion, of the angle [rad])."""
    seconds: float = 2.0
    """Sensible length of the motion [s]."""
    start: tuple[float, ...] = ()
    """Default initial state (S,); empty for the state of rest."""
    sums: tuple[tuple[int, ...], ...] = ()
    """Sums (S,) of differences that are judged instead of single entries, each with its tolerance: a link's angle to the
    vertical is the sum of those of the joints above it. Sums that are angles of the structure ignore whole turns."""
    scales: tuple[float, ...] = ()
    """Errors that count as 1 in a cost; a third of the tolerances if empty."""

    def __str__(self) -> str:
        """Return the wanted values of state entries, and the time."""
        wanted = []
        for (entry, value), tolerance in zip(self.values, self.tolerances, strict=True):
            wanted.append(f"state[{entry}] = {value:.4g} ± {tolerance:.2g}")
        return f"Goal({listed(wanted)}; in {self.seconds:g} s)"


def goal_in_layout(layout: Layout, name: str, table: GoalTable) -> Goal:
    """Return the goal `table` describes, with parts of `layout`.

    Raises ArgumentError, which names the goal and the part that is wrong.
    """
    targets = {}
    for part, numbers in table.reach.items():
        entries = layout.index(part)
        if len(numbers) != entries.stop - entries.start:
            raise ArgumentError(
                f"goals.{name}.reach: '{part}' has {entries.stop - entries.start} numbers."
            )
        targets[part] = (range(entries.start, entries.stop), numbers)
    return goal_at(name, table, targets)


def goal_at(
    name: str, table: GoalTable, targets: Mapping[str, tuple[Sequence[int], Iterable[float]]]
) -> Goal:
    """Return the goal that each part in `targets` has the given numbers in its state entries.

    Raises ArgumentError if the table gives a tolerance for another part.
    """
    values = []
    tolerances = []
    for part, (entries, numbers) in targets.items():
        values += [(entry, float(number)) for entry, number in zip(entries, numbers, strict=True)]
        tolerances += [table.within.get(part, GOAL_TOLERANCE)] * len(entries)
    for part in table.within:
        if part not in targets:
            raise ArgumentError(
                f"goals.{name}.within: '{part}' is not reached for. Parts: {', '.join(targets)}."
            )
    return Goal(tuple(values), tuple(tolerances), table.seconds)
