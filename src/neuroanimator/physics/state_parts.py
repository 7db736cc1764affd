"""Layouts, bounds, structure and parameters from the tables of a definition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.parts import ControlPart, GaitTable, ParameterTable, StatePart
from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_known, refuse_twins
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds, Layout, Slice
from neuroanimator.state.parameters import Parameter
from neuroanimator.state.segments import Constant, Plain
from neuroanimator.state.structure import Structure
from neuroanimator.state.units import known_unit

ANGLE = "rad"
"""Unit of angles."""

MAX_STATE = 1000
"""Maximum number of entries of a state: a definition may come from a stranger, and memory grows with its square."""


def layout_of_state(parts: Sequence[StatePart]) -> Layout:
    """Return the parts as a vector.

    Raises ArgumentError for two parts with the same name, for too many numbers and for an unknown unit.
    """
    refuse_twins((part.name for part in parts), "state")
    if sum(part.size for part in parts) > MAX_STATE:
        raise ArgumentError(
            f"state: wanted at most {MAX_STATE} numbers. Leave out what does not matter."
        )
    slices = []
    for part in parts:
        unit = known_unit(part.unit, f"state.{part.name}")
        slices.append(Slice(part.name, part.size, unit))
    return Layout(tuple(slices))


def layout_of_control(parts: Sequence[ControlPart]) -> tuple[Layout, Bounds]:
    """Return the parts as a vector with its bounds.

    Raises ArgumentError for two parts with the same name, for bounds that are empty and for an unknown unit.
    """
    refuse_twins((part.name for part in parts), "control")
    for part in parts:
        _refuse_empty_bounds(part)
    slices = []
    low: list[float] = []
    high: list[float] = []
    for part in parts:
        unit = known_unit(part.unit, f"control.{part.name}")
        slices.append(Slice(part.name, len(part.low), unit))
        low += part.low
        high += part.high
    return Layout(tuple(slices)), Bounds(tuple(low), tuple(high))


def _refuse_empty_bounds(part: ControlPart) -> None:
    """Raise ArgumentError unless each number in `low` is below its partner in `high`."""
    has_partners = len(part.low) == len(part.high)
    pairs = zip(part.low, part.high, strict=False)
    if not has_partners or not all(low < high for low, high in pairs):
        raise ArgumentError(
            f"control.{part.name}: wanted as many numbers in low as in high, each below its partner, "
            f"got {list(part.low)} and {list(part.high)}."
        )


def numbers_of(
    parts: Sequence[StatePart], key: Literal["rest", "spread"]
) -> Float[np.ndarray, " S"]:
    """Return every part's numbers under `key` as one vector, zeros if they are left out.

    Raises ArgumentError for a part whose count of numbers is not its size.
    """
    vector: list[float] = []
    for part in parts:
        numbers = getattr(part, key) or (0.0,) * part.size
        if len(numbers) != part.size:
            raise ArgumentError(
                f"state.{part.name}.{key}: wanted {part.size} numbers, got {len(numbers)}."
            )
        vector += numbers
    return np.array(vector, float)


def structure_of_parts(parts: Sequence[StatePart]) -> Structure:
    """Return the structure an emulator may use: which entries are angles, and which are rates of others.

    Raises ArgumentError for a rate that is not a part, or is a part of another size.
    """
    layout = layout_of_state(parts)
    entries = {}
    for part in parts:
        place = layout.index(part.name)
        entries[part.name] = range(place.start, place.stop)
    angles = []
    plain = []
    rates = []
    for part in parts:
        if part.feature == "sine":
            angles += [_unit_vector(entry, layout.size) for entry in entries[part.name]]
        elif part.feature == "plain":
            plain += entries[part.name]
        if part.rate:
            _refuse_unknown_rate(part, entries)
            rates += zip(entries[part.name], entries[part.rate], strict=True)
    return Structure(angles=tuple(angles), rates=tuple(rates), plain=tuple(plain))


def with_parameters(structure: Structure, moving: int, parameters: int) -> Structure:
    """Return the structure of a state of `moving` entries followed by `parameters` constant ones."""
    if not parameters:
        return structure
    entries = range(moving, moving + parameters)
    zeros = (0,) * parameters
    return replace(
        structure,
        angles=tuple(row + zeros for row in structure.angles),
        plain=(*structure.plain, *entries),
        segments=(Plain(size=moving), Constant(size=parameters)),
    )


def wrapping_entries(parts: Sequence[StatePart]) -> list[int]:
    """Return the state entries that may jump by a whole turn without a change: angles that wrap."""
    layout = layout_of_state(parts)
    entries: list[int] = []
    for part in parts:
        if part.feature == "sine" or (part.feature == "cyclic" and part.unit == ANGLE):
            place = layout.index(part.name)
            entries += range(place.start, place.stop)
    return entries


def _unit_vector(entry: int, size: int) -> tuple[int, ...]:
    """Return `size` numbers, all zero except for a one at `entry`: the combination of the state that is an angle."""
    vector = [0] * size
    vector[entry] = 1
    return tuple(vector)


def _refuse_unknown_rate(part: StatePart, entries: dict[str, range]) -> None:
    """Raise ArgumentError unless the rate of `part` is a part of the same size; `entries` are those of each part."""
    valid = [name for name, numbers in entries.items() if len(numbers) == part.size]
    if part.rate not in valid:
        raise ArgumentError(
            f"state.{part.name}.rate: no part '{part.rate}' of its size. Parts: {', '.join(valid)}."
        )


def parameter_from_table(name: str, table: ParameterTable, unit: str, own: float) -> Parameter:
    """Return the parameter that a table describes, with the value `own` if the table gives none.

    Raises ArgumentError for a nominal value outside the range.
    """
    low, high = table.range
    nominal = own if table.nominal is None else table.nominal
    if not low <= nominal <= high:
        raise ArgumentError(
            f"parameters.{name}.range: wanted one around the body's own value, {nominal:g} {unit}, got {low:g} to {high:g}. "
            "Widen it, or give nominal = … within it."
        )
    return Parameter(name, unit, low, high, nominal)


def gait_of(table: GaitTable | None, names: Sequence[str]) -> Gait | None:
    """Return the gait of a body with controls of these names; ArgumentError if it drives another."""
    if table is None:
        return None
    check_known(table.controls, names, "control", "gait.controls")
    at_rest = (0.0, 0.0)
    waves = [table.controls.get(name, at_rest) for name in names]
    amplitudes = tuple(amplitude for amplitude, _ in waves)
    lags = tuple(lag for _, lag in waves)
    return Gait(table.period, amplitudes, lags, table.share)
