"""Materials of a GLB file: colours as amounts of light."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from neuroanimator.appearance.colour import linear_of
from neuroanimator.export.ghost import GHOST_COLOUR, GHOST_OPACITY


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
