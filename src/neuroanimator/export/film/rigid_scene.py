"""A film's scene of rigid bodies: the system's own MuJoCo model, with the camera and lights of the film."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from neuroanimator.export.film.bounding_boxes import bounding_boxes
from neuroanimator.export.film.camera import FIELD_OF_VIEW, take_shots
from neuroanimator.export.film.options import Film
from neuroanimator.export.film.studio_floor import (
    StudioFloor,
    lacks_ground,
    lowest_of_fixed,
    pivots_of,
)
from neuroanimator.export.film.takes import Take
from neuroanimator.export.film.trust_shown import doubts, glow
from neuroanimator.export.ghost import GHOST_GROWTH, GHOST_RGBA
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.rigid.warnings import warnings_counted

NEAREST = 0.05
"""How near something is still drawn, over the camera's distance."""

FARTHEST = 60.0
"""How far away something is still drawn at least, over the camera's distance."""

LIGHT_DISTANCE = 3.0
"""Distance of a directional light that goes along, over the camera's."""

SHADOW_REACH = 3.0
"""Half the width of where shadows fall around a body that rests on scenery, over its size."""


class RigidScene:
    """A system's own MuJoCo model; of several clips, the others' bodies in the same place, and the ghost among them."""

    def __init__(self, system: MujocoSystem, take: Take, film: Film):
        self.model = copy.deepcopy(system.model)
        self.shots = take_shots(take, film)
        self._has_ghost = take.ghost is not None
        self._doubts = np.stack([doubts(clip, take.frames) for clip in take.clips])
        moves = self.model.body_weldid[self.model.geom_bodyid] != 0
        self._owners = {int(mujoco.mjtObj.mjOBJ_GEOM): np.where(moves, 0, -1)}
        self._frame = 0
        clips = take.everything
        self._states = [clip.states[:, : self.model.nq] for clip in clips]
        self._datas = [mujoco.MjData(self.model) for _ in clips]
        self.data = self._datas[0]
        # MuJoCo counts these distances in the model's extent.
        extent = self.model.stat.extent
        distance = self.shots.distance
        farthest = max(self.model.vis.map.zfar * extent, FARTHEST * distance)
        self.model.vis.map.znear = NEAREST * distance / extent
        self.model.vis.map.zfar = farthest / extent
        self.model.vis.map.shadowclip = SHADOW_REACH * self.shots.size / extent
        self.model.vis.global_.fovy = FIELD_OF_VIEW
        self._floor = self._floor_under(take)
        is_directional = self.model.light_type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        is_of_the_world = self.model.light_bodyid == 0
        self._lights = np.flatnonzero(is_directional & is_of_the_world)

    def _floor_under(self, take: Take) -> StudioFloor | None:
        """Return a floor where the model has none: nothing is to hang in an empty sky."""
        if not lacks_ground(self.model, self.shots.size):
            return None
        mujoco.mj_forward(self.model, self.data)
        lowest = float(bounding_boxes(take.clips).low[:, 2].min())
        lowest = min(lowest, lowest_of_fixed(self.model, self.data))
        pivots = pivots_of(self.model, self.data)
        return StudioFloor(self.model, pivots, lowest, self.shots)

    def prepare(self, scene: mujoco.MjvScene) -> None:
        """Let the floor fade, if it is ours."""
        if self._floor is not None:
            self._floor.prepare(scene)

    def pose(self, frame: int) -> None:
        """Put the joints, and lights as far away as the sun, where they are in `frame`."""
        self._frame = frame
        for light in self._lights:
            direction = self.model.light_dir[light]
            offset = direction * LIGHT_DISTANCE * self.shots.distance
            self.model.light_pos[light] = self.shots.lookat[frame] - offset
        with warnings_counted:
            for states, data in zip(self._states, self._datas, strict=True):
                data.qpos[:] = states[min(frame, len(states) - 1)]
                mujoco.mj_forward(self.model, data)

    def fill(self, scene: mujoco.MjvScene) -> None:
        """Add the bodies of the other clips, without their scenery, and the floor; let no plane cast shadows on itself."""
        for number in range(scene.ngeom):
            geom = scene.geoms[number]
            if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
                # Far from the middle of the shadow map it would be strewn with specks.
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        glow(scene, self._owners, self._doubts[:1, self._frame])
        option = mujoco.MjvOption()
        perturbation = mujoco.MjvPerturb()
        moving = mujoco.mjtCatBit.mjCAT_DYNAMIC
        before = scene.ngeom
        for data in self._datas[1:]:
            before = scene.ngeom
            mujoco.mjv_addGeoms(self.model, data, option, perturbation, moving, scene)
        if self._has_ghost:
            for number in range(before, scene.ngeom):
                geom = scene.geoms[number]
                geom.matid = -1
                geom.rgba[:] = GHOST_RGBA
                geom.size[:] *= GHOST_GROWTH
        if self._floor is not None:
            self._floor.fill(scene, self.shots.lookat[self._frame])
