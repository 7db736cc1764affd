"""Materials of a GLB file, with linear colours."""

from __future__ import annotations

from typing import Any

from neuroanimator.appearance.colour import linear_of
from neuroanimator.export.bodies import GHOST, Paint

SURFACES = {"dry": (0.1, 0.6), "ghost": (0.0, 0.5), "wet": (0.0, 0.45)}
"""Metallic and roughness factors of surfaces: wet ones are smoother than dry ones."""


def material(paint: Paint) -> dict[str, Any]:
    """Return the glTF object of a material; where points have colours of their own it is white."""
    surface = "dry" if paint.colour else "wet"
    if paint.colour == GHOST.colour:
        surface = "ghost"
    *colour, opacity = paint.colour or (1.0, 1.0, 1.0, 1.0)
    light = [round(float(amount), 6) for amount in linear_of(colour)]
    metallic, roughness = SURFACES[surface]
    described: dict[str, Any] = {
        "name": paint.name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*light, opacity],
            "metallicFactor": metallic,
            "roughnessFactor": roughness,
        },
    }
    if opacity < 1:
        described["alphaMode"] = "BLEND"
    if paint.is_thin:
        described["doubleSided"] = True
    return described
