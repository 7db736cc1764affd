"""The parts of a model that MuJoCo's viewer draws, and their colours."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.physics.rigid.rows import rows_at

DRAWN_GROUPS = 3
"""Number of groups of geoms and skins that are drawn, from 0, as in MuJoCo's own viewer; others are for contact only."""


def is_shown(group: int, rgba: Float[np.ndarray, " 4"]) -> bool:
    """Return whether a viewer draws things of this group and colour."""
    return bool(group < DRAWN_GROUPS and rgba[3] > 0)


def colour_of(
    model: mujoco.MjModel, material: int, rgba: Float[np.ndarray, " 4"]
) -> Float[np.ndarray, " 4"]:
    """Return red, green, blue and opacity, 0 to 1, of a `material`, or `rgba` if it is -1.

    A texture counts by its mean, as triangles have no textures.
    """
    if material < 0:
        return np.clip(rgba, 0, 1)
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
    colour = np.array(model.mat_rgba[material], float)
    if texture >= 0:
        colour[:3] *= _mean_texel(model, texture)
    return np.clip(colour, 0, 1)


def _mean_texel(model: mujoco.MjModel, texture: int) -> Float[np.ndarray, " 3"]:
    """Return the mean colour of a texture, 0 to 1; with fewer than three channels the mean grey."""
    channels = int(model.tex_nchannel[texture])
    size = int(model.tex_height[texture]) * int(model.tex_width[texture])
    rows = rows_at(model.tex_adr[texture], size * channels)
    texels = np.asarray(model.tex_data[rows]).reshape(size, channels)
    mean = texels.mean(axis=0) / 255
    if channels < 3:
        return np.repeat(mean[:1], 3)
    return mean[:3]
