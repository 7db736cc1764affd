"""Rigid bodies as their own MuJoCo model draws them, on a floor where it has none."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import final

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.export.film.bounding_boxes import bounding_boxes
from neuroanimator.export.film.camera import Shots
from neuroanimator.export.film.options import Take
from neuroanimator.export.film.scene import frame_model, glow
from neuroanimator.export.ghost import GHOST_GROWTH, GHOST_RGBA
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.rigid.warnings import warnings_counted

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

_Rod = tuple[float, np.ndarray, np.ndarray]
"""A part of a stand: its radius and its ends (3,) [m]."""

HEADLIGHT = 0.2
"""Maximum brightness of the camera's headlight beside other lights: a floor seen from above must not glare."""

GROUND_TYPES = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
"""Shapes that only ground has."""


@final
class RigidScene:
    """A system's own model, with the bodies of further clips, and the ghost, drawn into it."""

    def __init__(self, system: MujocoSystem, take: Take, shots: Shots):
        self.model = copy.deepcopy(system.model)
        self.doubt = 0.0
        self._has_ghost = take.ghost is not None
        self._datas = [mujoco.MjData(self.model) for _ in take.everything]
        self.data = self._datas[0]
        frame_model(self.model, shots)
        self._option = mujoco.MjvOption()
        self._perturbation = mujoco.MjvPerturb()
        self._floor_place: Float[np.ndarray, " 3"] | None = None
        self._stand: list[_Rod] = []
        farthest = self.model.vis.map.zfar * self.model.stat.extent
        self._floor_size = FLOOR_HALF_WIDTH * farthest
        if lacks_ground(self.model, shots.size):
            lowest = float(bounding_boxes(take.clips).low[:, 2].min())
            x, y, _ = shots.lookat.mean(axis=0)
            self._floor_place = np.array([x, y, lowest - FLOOR_DEPTH * shots.size])
            self._stand = _stand(self.model, shots, self._floor_place[2])
            _light_evenly(self.model)

    def pose(self, states: Sequence[Float[np.ndarray, " S"]]) -> None:
        """Set the joints to `states`."""
        with warnings_counted:
            for state, data in zip(states, self._datas, strict=True):
                data.qpos[:] = state[: self.model.nq]
                mujoco.mj_forward(self.model, data)

    def fill(self, scene: mujoco.MjvScene) -> None:
        """Add the bodies of the other clips, without their scenery, and the floor."""
        own = [scene.geoms[number] for number in range(scene.ngeom)]
        for geom in own:
            if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
                # A plane's shadow on itself is speckled far from the middle of the shadow map.
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        moving = mujoco.mjtCatBit.mjCAT_DYNAMIC
        glow([geom for geom in own if geom.category == moving], self.doubt)
        before = scene.ngeom
        for data in self._datas[1:]:
            before = scene.ngeom
            mujoco.mjv_addGeoms(self.model, data, self._option, self._perturbation, moving, scene)
        if self._has_ghost:
            for number in range(before, scene.ngeom):
                geom = scene.geoms[number]
                geom.matid = -1
                geom.rgba[:] = GHOST_RGBA
                geom.size[:] *= GHOST_GROWTH
        if self._floor_place is not None and scene.ngeom < scene.maxgeom:
            self._add_floor(scene, self._floor_place)

    def _add_floor(self, scene: mujoco.MjvScene, place: Float[np.ndarray, " 3"]) -> None:
        floor = _added(scene, mujoco.mjtGeom.mjGEOM_PLANE, FLOOR_COLOUR)
        floor.pos[:] = place
        floor.size[:] = (self._floor_size, self._floor_size, 1.0)
        floor.category = mujoco.mjtCatBit.mjCAT_DECOR
        floor.specular = 0
        for radius, start, end in self._stand[: scene.maxgeom - scene.ngeom]:
            rod = _added(scene, mujoco.mjtGeom.mjGEOM_CYLINDER, STAND_COLOUR)
            mujoco.mjv_connector(rod, rod.type, radius, start, end)


def _added(
    scene: mujoco.MjvScene, kind: mujoco.mjtGeom, colour: tuple[float, ...]
) -> mujoco.MjvGeom:
    """Return a new shape in a picture, at the origin."""
    shape = scene.geoms[scene.ngeom]
    scene.ngeom += 1
    rgba = np.array(colour, np.float32)
    mujoco.mjv_initGeom(shape, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
    return shape


def _stand(model: mujoco.MjModel, shots: Shots, floor: float) -> list[_Rod]:
    """Return the stand behind a body that a hinge holds in the air, as on the studio's stage; nothing for any other."""
    is_held = model.njnt > 0 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_HINGE
    is_bare = 0 not in model.geom_bodyid
    if not (is_held and is_bare and model.body_parentid[model.jnt_bodyid[0]] == 0):
        return []
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    pivot, axis = data.xanchor[0], data.xaxis[0]
    ahead = shots.lookat[0] - shots.position[0]
    top = pivot + np.copysign(BEHIND * shots.size, axis @ ahead) * axis
    ground = np.array([*top[:2], floor])
    plate = np.array([*top[:2], floor + FOOT_HEIGHT * shots.size])
    return [
        (AXLE_RADIUS * shots.size, pivot, top),
        (POST_RADIUS * shots.size, ground, top),
        (FOOT_RADIUS * shots.size, ground, plate),
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
