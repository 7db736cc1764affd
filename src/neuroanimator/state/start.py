"""The start of a motion: a state of rest, with named parts of it changed.

The same in TOML, `start = { "root.position" = [3, -2, 8] }`, and on the command line, `--start root.position=3,-2,8`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from neuroanimator.errors import ArgumentError
from neuroanimator.files.numbers import number_in
from neuroanimator.state.layout import Layout, Slice
from neuroanimator.state.reference_shape import Cloud
from neuroanimator.state.rotation import facing, rotate
from neuroanimator.text import did_you_mean, quoted

BODY = {
    "body.position": Slice("body.position", 3, "m"),
    "body.heading": Slice("body.heading", 1, "rad"),
    "body.velocity": Slice("body.velocity", 3, "m/s"),
}
"""Parts of a mass-spring body as a whole; the position is its centre of mass, the velocity in the world."""

SHORTEST = 1e-9
"""Length of a quaternion below which it is no rotation."""


Start = Mapping[str, ArrayLike] | Sequence[str]
"""Parts of a state with their numbers, as a mapping or as texts of the command line."""


def start_state(
    layout: Layout,
    rest: Iterable[float],
    parts: Start,
    *,
    orientations: Sequence[int] = (),
    cloud: Cloud | None = None,
) -> np.ndarray:
    """Return `rest` (S,) with the numbers of `parts` set: a mapping, or texts as for `read_starts`.

    A part is one of the layout's; `<root>.heading` [rad] turns a free root about Z. A mass-spring body (`cloud`) can
    also be moved as a whole, by the parts of `BODY`. `orientations` are the first entries of quaternions.

    Raises ArgumentError for parts that do not exist, listing those that do, and for a wrong count of numbers.
    """
    if isinstance(parts, str):
        parts = [parts]
    if not isinstance(parts, Mapping):
        parts = read_starts(parts)
    parts = {name: _as_numbers(name, numbers) for name, numbers in parts.items()}
    start = np.array(rest, float)
    known = _known_parts(layout, cloud)
    for name, numbers in parts.items():
        _check_name(name, known)
        _check_numbers(known[name], numbers)
    if cloud is not None and cloud.parameters:
        start = _with_parameters(cloud, layout, start, parts)
    for name, numbers in parts.items():
        if name not in BODY:
            _set_part(layout, start, name, np.array(numbers, float))
    if cloud is not None:
        _move_body(cloud, start, parts)
    for entry in orientations:
        orientation = start[entry : entry + 4]
        length = np.linalg.norm(orientation)
        if length < SHORTEST:
            raise ArgumentError(
                "start: a quaternion of zeros is no rotation. Give 1, 0, 0, 0 for none."
            )
        orientation /= length
    return start


def _as_numbers(name: str, numbers: ArrayLike) -> tuple[float, ...]:
    """Return a part's numbers, also if only one is given."""
    try:
        return tuple(np.atleast_1d(np.asarray(numbers, float)).tolist())
    except (TypeError, ValueError):
        raise ArgumentError(
            f"start: '{name[:60]}': wanted a number or several, got {quoted(numbers)}."
        ) from None


def read_starts(texts: Iterable[str]) -> dict[str, tuple[float, ...]]:
    """Return the parts named by texts such as `root.position=3,-2,8`, with their numbers."""
    parts = {}
    for text in texts:
        before, equals, numbers = text.partition("=")
        name = before.strip()
        if not equals or not name:
            raise ArgumentError(
                f"start: wanted NAME=NUMBERS such as root.position=3,-2,8, got '{text[:60]}'."
            )
        parts[name] = _read_numbers(name, numbers)
    return parts


def _read_numbers(name: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(number_in(number) for number in text.split(","))
    except ValueError:
        raise ArgumentError(
            f"start: '{name}': wanted numbers separated by commas, got '{text[:60]}'."
        ) from None


def _known_parts(layout: Layout, cloud: Cloud | None) -> dict[str, Slice]:
    """Return every part that can be given, those of the whole body first."""
    known = {}
    if cloud is not None:
        known.update(BODY)
    for part in layout.slices:
        known[part.name] = part
        if part.name.endswith(".orientation") and part.size == 4:
            heading = part.name.removesuffix("orientation") + "heading"
            known[heading] = Slice(heading, 1, "rad")
    return known


def _check_name(name: str, known: Mapping[str, Slice]) -> None:
    if name in known:
        return
    valid = ", ".join(f"{part.name} ({part.size}, {part.unit})" for part in known.values())
    raise ArgumentError(
        f"start: no part called '{name[:60]}'. {did_you_mean(name, known)}Parts, how many numbers and their unit: {valid}."
    )


def _check_numbers(part: Slice, numbers: Sequence[float]) -> None:
    if len(numbers) != part.size:
        raise ArgumentError(
            f"start: '{part.name}' has {part.size} numbers [{part.unit}], got {len(numbers)}."
        )
    if not all(math.isfinite(number) for number in numbers):
        raise ArgumentError(f"start: '{part.name}': wanted finite numbers, got {list(numbers)}.")


def _set_part(layout: Layout, start: np.ndarray, name: str, numbers: np.ndarray) -> None:
    if name.endswith(".heading") and not any(part.name == name for part in layout.slices):
        start[layout.index(name.removesuffix("heading") + "orientation")] = facing(numbers[0])
    else:
        start[layout.index(name)] = numbers


def _with_parameters(
    cloud: Cloud, layout: Layout, start: np.ndarray, parts: Mapping[str, Sequence[float]]
) -> np.ndarray:
    """Return `start` in the shape of a mass-spring body with the parameters among `parts`."""
    first = layout.size - cloud.parameters
    values = start[first:].copy()
    for part in layout.slices[-cloud.parameters :]:
        if part.name in parts:
            values[layout.index(part.name).start - first] = parts[part.name][0]
    return cloud.reshaped(start, values)


def _move_body(cloud: Cloud, start: np.ndarray, parts: Mapping[str, Sequence[float]]) -> None:
    """Set heading, position and velocity of a mass-spring body in `start`, about its centre of mass."""
    size = 3 * cloud.count
    positions = start[:size].reshape(-1, 3)
    velocities = start[size : 2 * size].reshape(-1, 3)
    centre = cloud.centroid(positions)
    if "body.heading" in parts:
        orientation = facing(np.float64(parts["body.heading"][0]))
        positions[:] = centre + rotate(orientation, positions - centre)
        velocities[:] = rotate(orientation, velocities)
    if "body.position" in parts:
        positions += np.array(parts["body.position"]) - centre
    if "body.velocity" in parts:
        velocities += np.array(parts["body.velocity"]) - cloud.centroid(velocities)
