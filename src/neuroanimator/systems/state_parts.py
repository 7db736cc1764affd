"""From the parts of a state and a control a definition lists to layouts, bounds and structure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuroanimator.definitions.parts import ControlPart, StatePart
from neuroanimator.errors import ArgumentError
from neuroanimator.state.layout import Bounds, Layout, Slice
from neuroanimator.state.structure import Structure
from neuroanimator.state.units import known_unit

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


def _refuse_clash(kind: str, names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(f"{kind}: two parts are called '{name}'. Rename one of them.")
