"""What MuJoCo's viewer draws of a model, and in which colour."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float

DRAWN_GROUPS = 3
"""Geoms and skins of groups 0 to 2 are drawn, as in MuJoCo's own viewer; higher groups are for contact only."""


def is_shown(group: int, rgba: Float[np.ndarray, " 4"]) -> bool:
    """Return whether a viewer draws what has this group and colour."""
    return bool(group < DRAWN_GROUPS and rgba[3] > 0)


def colour_of(
    model: mujoco.MjModel, material: int, rgba: Float[np.ndarray, " 4"]
) -> Float[np.ndarray, " 4"]:
    """Return the red, green, blue and opacity, 0 to 1, of what has this `material`, or `rgba` if that is -1.

    Of a texture they are the mean, for triangles have none.
    """
    if material < 0:
        return np.clip(rgba, 0, 1)
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
    colour = np.array(model.mat_rgba[material], float)
    if texture >= 0:
        colour[:3] *= _mean_texel(model, texture)
    return np.clip(colour, 0, 1)


def _mean_texel(model: mujoco.MjModel, texture: int) -> Float[np.ndarray, " 3"]:
    """Return the mean colour of a texture, 0 to 1; of a texture with fewer than three channels the mean grey."""
    channels = int(model.tex_nchannel[texture])
    size = int(model.tex_height[texture]) * int(model.tex_width[texture])
    first = int(model.tex_adr[texture])
    texels = np.asarray(model.tex_data[first : first + size * channels]).reshape(size, channels)
    mean = texels.mean(axis=0) / 255
    if channels < 3:
        return np.repeat(mean[:1], 3)
    return mean[:3]
