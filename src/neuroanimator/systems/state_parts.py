"""From the parts a definition lists to layouts, structure, bounds and goals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from neuroanimator.definitions.goal import GoalTable
from neuroanimator.definitions.parts import ControlPart, StatePart
from neuroanimator.errors import ArgumentError
from neuroanimator.state.layout import Bounds, Layout, Slice
from neuroanimator.state.structure import Structure
from neuroanimator.state.units import known_unit
from neuroanimator.systems.system import Goal

GOAL_TOLERANCE = 0.1
"""Of a goal's part for which none is given, in its own unit."""

MAX_STATE = 1000
"""Most numbers in a state: a definition may come from a stranger, and memory grows with their square."""


def layout_of_state(parts: Sequence[StatePart]) -> Layout:
    """Return the parts as a vector; refuse names that clash and unknown units."""
    _refuse_clash("state", [part.name for part in parts])
    if sum(part.size for part in parts) > MAX_STATE:
        raise ArgumentError(
            f"state: wanted at most {MAX_STATE} numbers. Leave out what does not matter."
        )
    return Layout(
        tuple(
            Slice(part.name, part.size, known_unit(part.unit, f"state.{part.name}"))
            for part in parts
        )
    )


def layout_of_control(parts: Sequence[ControlPart]) -> tuple[Layout, Bounds]:
    """Return the parts as a vector with its bounds."""
    _refuse_clash("control", [part.name for part in parts])
    for part in parts:
        pairs = zip(part.low, part.high, strict=False)
        if len(part.low) != len(part.high) or not all(low < high for low, high in pairs):
            raise ArgumentError(
                f"control.{part.name}: wanted as many numbers in low as in high, each below its partner, "
                f"came {list(part.low)} and {list(part.high)}."
            )
    slices = tuple(
        Slice(p.name, len(p.low), known_unit(p.unit, f"control.{p.name}")) for p in parts
    )
    low, high = (sum((getattr(part, side) for part in parts), ()) for side in ("low", "high"))
    return Layout(slices), Bounds(low, high)


def numbers_of(parts: Sequence[StatePart], key: str) -> np.ndarray:
    """Return (S,) every part's `rest` or `spread`, zeros where it is left out."""
    rows = []
    for part in parts:
        numbers = getattr(part, key) or (0.0,) * part.size
        if len(numbers) != part.size:
            raise ArgumentError(
                f"state.{part.name}.{key}: wanted {part.size} numbers, came {len(numbers)}."
            )
        rows += numbers
    return np.array(rows, float)


def structure_of_parts(parts: Sequence[StatePart]) -> Structure:
    """Return what an emulator may exploit: which entries are angles, and which the rates of which."""
    layout = layout_of_state(parts)
    entries = {part.name: range(*layout.index(part.name).indices(layout.size)) for part in parts}
    rates = []
    for part in parts:
        if part.rate:
            if part.rate not in entries or len(entries[part.rate]) != part.size:
                valid = ", ".join(
                    name for name, numbers in entries.items() if len(numbers) == part.size
                )
                raise ArgumentError(
                    f"state.{part.name}.rate: no part '{part.rate}' of its size. Parts: {valid}."
                )
            rates += list(zip(entries[part.name], entries[part.rate], strict=True))
    looks = {
        look: [i for part in parts if part.feature == look for i in entries[part.name]]
        for look in ("sine", "plain")
    }
    unit = np.eye(layout.size, dtype=int)
    angles = tuple(tuple(int(x) for x in unit[i]) for i in looks["sine"])
    return Structure(angles=angles, rates=tuple(rates), plain=tuple(looks["plain"]))


def goals_of(layout: Layout, tables: Mapping[str, GoalTable]) -> dict[str, Goal]:
    """Return the goals as entries of the state."""
    return {
        name: goal_of(name, table, _wanted(layout, name, table)) for name, table in tables.items()
    }


def _wanted(
    layout: Layout, name: str, table: GoalTable
) -> dict[str, tuple[range, Sequence[float]]]:
    wanted = {}
    for part, numbers in table.reach.items():
        entries = layout.index(part)
        if len(numbers) != entries.stop - entries.start:
            raise ArgumentError(
                f"goals.{name}.reach: '{part}' has {entries.stop - entries.start} numbers."
            )
        wanted[part] = (range(entries.start, entries.stop), numbers)
    return wanted


def goal_of(
    name: str, table: GoalTable, wanted: Mapping[str, tuple[Sequence[int], Iterable[float]]]
) -> Goal:
    """Return the goal that each part in `wanted` has its numbers in its state entries.

    Raises ArgumentError where the table gives a tolerance to another part.
    """
    values, tolerances = [], []
    for part, (entries, numbers) in wanted.items():
        values += [(entry, float(number)) for entry, number in zip(entries, numbers, strict=True)]
        tolerances += [table.within.get(part, GOAL_TOLERANCE)] * len(entries)
    for part in table.within:
        if part not in wanted:
            raise ArgumentError(
                f"goals.{name}.within: '{part}' is not reached for. Parts: {', '.join(wanted)}."
            )
    return Goal(tuple(values), tuple(tolerances), table.seconds)


def _refuse_clash(kind: str, names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(f"{kind}: two parts are called '{name}'. Rename one of them.")
