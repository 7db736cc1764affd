"""Scenes: MuJoCo models that show bodies in their surroundings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol, runtime_checkable

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import Clip
from neuroanimator.emulator.trust import EDGE
from neuroanimator.export.film.bounding_boxes import lasting
from neuroanimator.export.film.camera import FIELD_OF_VIEW, Shots

NEAREST = 0.02
"""Distance of the near clipping plane, over the camera's."""

FARTHEST = 60.0
"""Minimum distance of the far clipping plane, over the camera's."""

SHADOW_REACH = 3.0
"""Half the width of the shadowed area, over the size of the motion: a smaller one has finer shadows."""

GLOW = (1.0, 0.54, 0.12)
"""Colour of doubt (red, green, blue), as on the studio's stage."""

LOST = 3.0
"""Mean score at which a body fully has the colour of doubt, as on the studio's stage."""

MAX_GLOW = 0.7
"""Maximum share of the colour of doubt, so that the body stays recognisable."""

EMISSION = 0.2
"""Maximum emission of a body in doubt."""

SMOOTHED = 0.3
"""Time over which scores are averaged before they colour a body [s], against flicker."""


@runtime_checkable
class FilmScene(Protocol):
    """A MuJoCo model with the bodies of a take."""

    model: mujoco.MjModel
    data: mujoco.MjData
    doubt: float
    """Share of the colour of doubt that bodies have, 0 to 1."""

    def pose(self, states: Sequence[Float[np.ndarray, " S"]]) -> None:
        """Put each body of the take into its state, the ghost last."""

    def fill(self, scene: mujoco.MjvScene) -> None:
        """Change the shapes that MuJoCo has put into a picture."""


def frame_model(model: mujoco.MjModel, shots: Shots) -> None:
    """Fit a model's clipping distances to `shots`, and its shadows to the motion."""
    # MuJoCo measures these distances in the model's extent.
    extent = model.stat.extent
    model.vis.map.znear = NEAREST * shots.distance / extent
    model.vis.map.zfar = max(model.vis.map.zfar, FARTHEST * shots.distance / extent)
    model.vis.map.shadowclip = SHADOW_REACH * shots.size / extent
    model.vis.global_.fovy = FIELD_OF_VIEW


def doubts(clip: Clip, frames: int) -> Float[np.ndarray, " F"]:
    """Return the share of the colour of doubt, 0 to 1, in each of `frames`; 0 where trust is not shown."""
    if clip.trust is None:
        return np.zeros(frames)
    scores = np.minimum(clip.trust, 2 * LOST)
    width = max(round(SMOOTHED * clip.rate), 1)
    past = np.concatenate([np.full(width - 1, scores[0]), scores])
    smooth = np.convolve(past, np.full(width, 1 / width), mode="valid")
    return np.clip((lasting(smooth, frames) - EDGE) / (LOST - EDGE), 0, 1)


def glow(geoms: Iterable[mujoco.MjvGeom], doubt: float) -> None:
    """Mix a share `doubt` of the colour of doubt into shapes."""
    if doubt == 0:
        return
    share = MAX_GLOW * doubt
    for geom in geoms:
        geom.rgba[:3] = (1 - share) * geom.rgba[:3] + share * np.array(GLOW)
        geom.emission = max(geom.emission, EMISSION * share)
