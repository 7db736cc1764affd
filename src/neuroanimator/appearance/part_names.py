"""Names of the colours and parts of a scene in the files that users open."""

from __future__ import annotations

import re
from collections.abc import Iterable

from neuroanimator.appearance.skeleton import Shape, Skeleton

MAX_FLOOR_THICKNESS = 0.05
"""Thickness below which a box in the scenery is a floor, over its other sides."""


FLOOR = "floor"
"""Name of the colour of a floor."""


def colour_names(skeleton: Skeleton) -> dict[tuple[float, ...], str]:
    """Return a name for each colour of the shapes of `skeleton`: 'floor', or the first bone that has it, numbered."""
    names: dict[tuple[float, ...], str] = {}
    for number, bone in enumerate(skeleton.bones):
        for shape in bone.shapes:
            if shape.colour in names:
                continue
            name = bone.name
            if _is_slab(shape) and not skeleton.is_moved(number):
                name = FLOOR
            names[shape.colour] = unique(name, names.values())
    return names


def unique(name: str, taken: Iterable[str], separator: str = " ") -> str:
    """Return `name`, numbered after the `separator` if it is among those `taken` in upper or lower case: engines ignore case."""
    known = {other.casefold() for other in taken}
    number = 1
    own = name
    while own.casefold() in known:
        number += 1
        own = f"{name}{separator}{number}"
    return own


def identifier(name: str, taken: set[str]) -> str:
    """Return `name` as an identifier not among `taken`, and add it to them: other characters become underscores."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name) or "_"
    if plain[0].isdigit():
        plain = f"_{plain}"
    own = unique(plain, taken, "_")
    taken.add(own)
    return own


def _is_slab(shape: Shape) -> bool:
    return shape.kind == "box" and shape.size[2] < MAX_FLOOR_THICKNESS * min(shape.size[:2])
