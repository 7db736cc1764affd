"""Scenes: MuJoCo models that show bodies in their surroundings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import Clip
from neuroanimator.emulator.trust import EDGE
from neuroanimator.export.ghost import GHOST_RGBA
from neuroanimator.film.camera import FIELD_OF_VIEW, Shots
from neuroanimator.film.options import held

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


OPTIONS = (mujoco.MjvOption(), mujoco.MjvPerturb())
"""How MuJoCo draws: its defaults, and nothing is pulled."""


class FilmScene(ABC):
    """A MuJoCo model with the bodies of a take."""

    doubt = 0.0
    """Share of the colour of doubt that bodies have, 0 to 1."""

    def __init__(self, model: mujoco.MjModel, shots: Shots):
        """Fit the model's clipping distances to `shots`, and its shadows to the motion."""
        self.model = model
        self.data = mujoco.MjData(model)
        # MuJoCo measures these distances in the model's extent.
        visual = model.vis
        extent = model.stat.extent
        visual.map.znear = NEAREST * shots.distance / extent
        visual.map.zfar = max(visual.map.zfar, FARTHEST * shots.distance / extent)
        visual.map.shadowclip = SHADOW_REACH * shots.size / extent
        visual.global_.fovy = FIELD_OF_VIEW

    @abstractmethod
    def pose(self, states: Sequence[Float[np.ndarray, " S"]]) -> None:
        """Put each body of the take into its state, the ghost last."""

    def fill(self, picture: mujoco.MjvScene) -> None:
        """Change the shapes that MuJoCo has put into a picture: what moves glows in doubt, planes cast no shadows."""
        share = MAX_GLOW * self.doubt
        for geom in picture.geoms[: picture.ngeom]:
            if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
                # A plane's shadow on itself is speckled far from the middle of the shadow map.
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR
            elif share and geom.category == mujoco.mjtCatBit.mjCAT_DYNAMIC and not is_ghost(geom):
                geom.rgba[:3] = (1 - share) * geom.rgba[:3] + share * np.array(GLOW)
                geom.emission = max(geom.emission, EMISSION * share)


def is_ghost(geom: mujoco.MjvGeom) -> bool:
    """Return whether a shape in a picture has the colour of ghosts."""
    return np.array_equal(geom.rgba, np.array(GHOST_RGBA, np.float32))


def doubts(clip: Clip, frames: int) -> Float[np.ndarray, " F"]:
    """Return the share of the colour of doubt, 0 to 1, in each of `frames`; 0 where trust is not shown."""
    if clip.trust is None:
        return np.zeros(frames)
    scores = np.minimum(clip.trust, 2 * LOST)
    width = max(round(SMOOTHED * clip.rate), 1)
    past = np.pad(scores, (width - 1, 0), mode="edge")
    smooth = np.convolve(past, np.full(width, 1 / width), mode="valid")
    return np.clip((held(smooth, frames) - EDGE) / (LOST - EDGE), 0, 1)
