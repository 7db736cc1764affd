"""Materials of a GLB file: colours as light, and names by which users find the parts they stand for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from neuroanimator.appearance.skeleton import Shape, Skeleton
from neuroanimator.export.ghost import GHOST_COLOUR, GHOST_OPACITY
from neuroanimator.export.gltf.colour import linear_of

MAX_FLOOR_THICKNESS = 0.05
"""A box in the scenery that is thinner than this share of its other sides is a floor."""


def material(
    name: str,
    colour: Sequence[float],
    *,
    opacity: float = 1.0,
    metallic: float = 0.1,
    roughness: float = 0.6,
) -> dict[str, Any]:
    """Return the glTF object of a material of an sRGB `colour`, three numbers or four with opacity."""
    alpha = opacity
    if len(colour) > 3:
        alpha = colour[3] * opacity
    light = [round(float(amount), 6) for amount in linear_of(colour[:3])]
    surface = {
        "baseColorFactor": [*light, alpha],
        "metallicFactor": metallic,
        "roughnessFactor": roughness,
    }
    described = {"name": name, "pbrMetallicRoughness": surface}
    if alpha < 1:
        described["alphaMode"] = "BLEND"
    return described


def ghost_material() -> dict[str, Any]:
    """Return the one colour of all of a ghost."""
    return material("ghost", GHOST_COLOUR, opacity=GHOST_OPACITY, metallic=0.0, roughness=0.5)


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


def unique(name: str, taken: Iterable[str]) -> str:
    """Return `name`, numbered if it is among those `taken`."""
    known = set(taken)
    number = 1
    own = name
    while own in known:
        number += 1
        own = f"{name} {number}"
    return own


def _is_slab(shape: Shape) -> bool:
    return shape.kind == "box" and shape.size[2] < MAX_FLOOR_THICKNESS * min(shape.size[:2])
