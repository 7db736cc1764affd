"""Goals: states, or parts of states, to reach."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_known
from neuroanimator.state.layout import Layout
from neuroanimator.state.rotation import facing
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


def goal_in_layout(
    layout: Layout,
    name: str,
    table: GoalTable,
    at_site: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> Goal:
    """Return the goal `table` describes, with parts of `layout`; `at_site` are those given by its site.

    Raises ArgumentError, which names the goal and the part that is wrong.
    """
    values: list[tuple[int, float]] = []
    tolerances: list[float] = []
    reach = {**table.reach, **at_site}
    for part, numbers in reach.items():
        wanted = _wanted(layout, name, part, numbers)
        values += wanted
        tolerances += [table.within.get(part, GOAL_TOLERANCE)] * len(wanted)
    check_known(table.within, reach, "part", f"goals.{name}.within")
    return Goal(tuple(values), tuple(tolerances), table.seconds)


def _wanted(
    layout: Layout, name: str, part: str, numbers: Sequence[float]
) -> list[tuple[int, float]]:
    """Return the state entries of a part, or of its beginning, with its `numbers`.

    `<root>.heading` stands for the root's orientation.
    """
    if part.endswith(".heading"):
        part = part.removesuffix(".heading") + ".orientation"
        numbers = facing(np.asarray(numbers[0], float)).tolist()
    entries = range(layout.size)[layout.index(part)]
    is_orientation = part.endswith(".orientation")
    if len(numbers) > len(entries) or (is_orientation and len(numbers) != 4):
        raise ArgumentError(f"goals.{name}.reach: '{part}' has {len(entries)} numbers.")
    return list(zip(entries, map(float, numbers), strict=False))
