"""Rigid bodies as their own MuJoCo model draws them, on a floor where it has none."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import NamedTuple, final

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.export.ghost import GHOST_GROWTH, GHOST_RGBA
from neuroanimator.film.bounding_boxes import bounding_boxes
from neuroanimator.film.camera import Shots
from neuroanimator.film.options import Take, Vector
from neuroanimator.film.scene import OPTIONS, FilmScene
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.physics.rigid.warnings import warnings_counted

FLOOR_DEPTH = 0.08
"""Depth of a floor under the lowest point of the motion, over the body's size."""

FLOOR_HALF_WIDTH = 1.5
"""Half the width of a floor, over the distance up to which things are drawn: it ends level."""

FLOOR_COLOUR = (0.78, 0.8, 0.83, 1.0)
"""Red, green, blue and opacity of a floor."""

STAND_COLOUR = (0.6, 0.64, 0.67, 1.0)
"""Red, green, blue and opacity of the stand of what a hinge holds in the air."""

BEHIND = 0.09
"""Distance of a stand's post behind the body, over its size."""

AXLE_RADIUS, POST_RADIUS, FOOT_RADIUS, FOOT_HEIGHT = 0.012, 0.018, 0.13, 0.016
"""Measures of a stand, over the body's size."""

HEADLIGHT = 0.2
"""Maximum brightness of the camera's headlight beside other lights: a floor seen from above must not glare."""

GROUND_TYPES = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
"""Shapes that only ground has."""


class _Decor(NamedTuple):
    """A floor or a part of a stand: a plane at its start, or a rod between its ends."""

    radius: float
    """Radius, or half the width of a plane [m]."""
    start: Vector
    end: Vector | None = None

    def add_to(self, picture: mujoco.MjvScene) -> None:
        """Add its shape to a picture."""
        shape = picture.geoms[picture.ngeom]
        picture.ngeom += 1
        kind = mujoco.mjtGeom.mjGEOM_CYLINDER
        colour = STAND_COLOUR
        if self.end is None:
            kind = mujoco.mjtGeom.mjGEOM_PLANE
            colour = FLOOR_COLOUR
        size = np.array([self.radius, self.radius, 1.0])
        mujoco.mjv_initGeom(
            shape, kind, size, self.start, np.eye(3).ravel(), np.array(colour, np.float32)
        )
        if self.end is None:
            shape.category = mujoco.mjtCatBit.mjCAT_DECOR
            shape.specular = 0
        else:
            mujoco.mjv_connector(shape, kind, self.radius, self.start, self.end)


@final
class RigidScene(FilmScene):
    """A system's own model, with the bodies of further clips, and the ghost, drawn into it."""

    def __init__(self, system: MujocoSystem, take: Take, shots: Shots):
        super().__init__(copy.deepcopy(system.model), shots)
        others = [mujoco.MjData(self.model) for _ in take.everything[1:]]
        self._datas = [self.data, *others]
        self._has_ghost = take.ghost is not None
        self._decor: list[_Decor] = []
        if lacks_ground(self.model, shots.size):
            floor = shots.lookat.mean(axis=0)
            floor[2] = bounding_boxes(take.clips).low[:, 2].min() - FLOOR_DEPTH * shots.size
            farthest = self.model.vis.map.zfar * self.model.stat.extent
            plane = _Decor(FLOOR_HALF_WIDTH * farthest, floor)
            self._decor = [plane, *_stand(self.model, self.data, shots, floor[2])]
            _light_evenly(self.model)

    def pose(self, states: Sequence[Float[np.ndarray, " S"]]) -> None:
        """Set the joints to `states`."""
        with warnings_counted:
            for state, data in zip(states, self._datas, strict=True):
                data.qpos[:] = state[: self.model.nq]
                mujoco.mj_forward(self.model, data)

    def fill(self, picture: mujoco.MjvScene) -> None:
        """Add the bodies of the other clips, without their scenery, and the floor."""
        super().fill(picture)
        first = picture.ngeom
        for data in self._datas[1:]:
            mujoco.mjv_addGeoms(self.model, data, *OPTIONS, mujoco.mjtCatBit.mjCAT_DYNAMIC, picture)
        if self._has_ghost:
            for geom in picture.geoms[first : picture.ngeom]:
                geom.matid = -1
                geom.rgba[:] = GHOST_RGBA
                geom.size[:] *= GHOST_GROWTH
        for part in self._decor[: picture.maxgeom - picture.ngeom]:
            part.add_to(picture)


def _stand(model: mujoco.MjModel, data: mujoco.MjData, shots: Shots, floor: float) -> list[_Decor]:
    """Return the stand behind a body that a hinge holds in the air, as on the studio's stage; nothing for any other."""
    is_held = model.njnt > 0 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_HINGE
    is_bare = 0 not in model.geom_bodyid
    if not (is_held and is_bare and model.body_parentid[model.jnt_bodyid[0]] == 0):
        return []
    mujoco.mj_kinematics(model, data)
    pivot = data.xanchor[0]
    axis = data.xaxis[0]
    size = shots.size
    ahead = shots.lookat[0] - shots.position[0]
    top = pivot + np.copysign(BEHIND * size, axis @ ahead) * axis
    ground = np.array([*top[:2], floor])
    plate = np.array([*top[:2], floor + FOOT_HEIGHT * size])
    return [
        _Decor(AXLE_RADIUS * size, pivot, top),
        _Decor(POST_RADIUS * size, ground, top),
        _Decor(FOOT_RADIUS * size, ground, plate),
    ]


def _light_evenly(model: mujoco.MjModel) -> None:
    """Make the lights directional: lamps would leave a bright spot on the floor."""
    is_fixed = model.light_bodyid == 0
    model.light_type[is_fixed] = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    if is_fixed.any():
        diffuse = model.vis.headlight.diffuse
        diffuse[:] = np.minimum(diffuse, HEADLIGHT)


def lacks_ground(model: mujoco.MjModel, size: float) -> bool:
    """Return whether `model` has no ground for a body of `size` [m]: no plane, no terrain and no broad block."""
    is_ground = np.isin(model.geom_type, GROUND_TYPES)
    is_fixed = model.body_weldid[model.geom_bodyid] == 0
    is_broad = is_fixed & (model.geom_rbound > size)
    return not (is_ground | is_broad).any()
