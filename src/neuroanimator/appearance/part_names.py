"""Names by which users find the colours and parts of a scene in the files they open."""

from __future__ import annotations

from collections.abc import Iterable

from neuroanimator.appearance.skeleton import Shape, Skeleton

MAX_FLOOR_THICKNESS = 0.05
"""A box in the scenery that is thinner than this share of its other sides is a floor."""


def colour_names(skeleton: Skeleton) -> dict[tuple[float, ...], str]:
    """Return a name for each colour of the shapes of `skeleton`: 'floor', or the first bone that has it, numbered."""
    names: dict[tuple[float, ...], str] = {}
    for number, bone in enumerate(skeleton.bones):
        for shape in bone.shapes:
            if shape.colour in names:
                continue
            name = bone.name
            if _is_slab(shape) and not skeleton.is_moved(number):
                name = "floor"
            names[shape.colour] = unique(name, names.values())
    return names


def unique(name: str, taken: Iterable[str], separator: str = " ") -> str:
    """Return `name`, numbered after the `separator` if it is among those `taken`."""
    known = set(taken)
    number = 1
    own = name
    while own in known:
        number += 1
        own = f"{name}{separator}{number}"
    return own


def _is_slab(shape: Shape) -> bool:
    return shape.kind == "box" and shape.size[2] < MAX_FLOOR_THICKNESS * min(shape.size[:2])
