"""Clips drawn image by image by MuJoCo and encoded as they come: what the drawing process does."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import imageio_ffmpeg
import mujoco
import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.export.film.camera import FIELD, Shots, shots_of
from neuroanimator.export.film.options import Film
from neuroanimator.export.film.reel import unpacked
from neuroanimator.export.film.stage import Setting, Stage
from neuroanimator.systems import carried_system
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem

SAMPLES = 8
"""Points a pixel is sampled at; OpenGL gives as many as it has, software 4."""
SHADOW_MAP = 4096
"""[texels] A side of the shadow map: shadows have edges finer than a pixel."""
ENCODER = ["-preset", "veryfast", "-crf", "18", "-movflags", "+faststart"]
"""H.264 without visible loss; slower presets make files a fifth smaller and take as long as drawing."""
NEAREST, MAX_DISTANCE = 0.05, 60.0
"""What is seen, over the camera's distance."""
LIGHT, SHADOWED = 3.0, 1.6
"""Distance of a directional light that goes along, and half the width of where its shadows fall, over the distance of
the camera and the size of what is filmed."""
CRAMPED = 3.0
"""Shadows also fall on so much around a body that rests on scenery, over its size."""


@runtime_checkable
class Scene(Protocol):
    """What is filmed."""

    model: mujoco.MjModel
    data: mujoco.MjData
    shots: Shots

    def prepare(self, scene: mujoco.MjvScene) -> None:
        """Set how `scene` is drawn."""

    def pose(self, frame: int) -> None:
        """Put everything where it is in `frame`."""

    def fill(self, scene: mujoco.MjvScene) -> None:
        """Change what MuJoCo has put into `scene`."""


class RigidScene:
    """A system's own MuJoCo model; of several clips, the others' bodies in the same place."""

    def __init__(self, system: MujocoSystem, clips: Sequence[Clip], film: Film):
        self.model = copy.deepcopy(system.model)
        self.shots = shots_of(clips, film)
        self._states = [clip.states[:, : self.model.nq] for clip in clips]
        self._datas = [mujoco.MjData(self.model) for _ in clips]
        self.data = self._datas[0]
        extent, distance = self.model.stat.extent, self.shots.distance
        farthest = max(self.model.vis.map.zfar * extent, MAX_DISTANCE * distance)
        self.model.vis.map.znear = NEAREST * distance / extent
        self.model.vis.map.zfar = farthest / extent
        self.model.vis.map.shadowclip = CRAMPED * self.shots.size / extent
        self.model.vis.global_.fovy = FIELD
        directional = self.model.light_type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        self._lights = np.flatnonzero(directional & (self.model.light_bodyid == 0))

    def prepare(self, scene: mujoco.MjvScene) -> None:
        """Leave it as it is."""

    def pose(self, frame: int) -> None:
        """Put the joints, and lights as far away as the sun, where they are in `frame`."""
        for light in self._lights:
            direction = self.model.light_dir[light]
            self.model.light_pos[light] = (
                self.shots.lookat[frame] - direction * LIGHT * self.shots.distance
            )
        for states, data in zip(self._states, self._datas, strict=True):
            data.qpos[:] = states[min(frame, len(states) - 1)]
            mujoco.mj_forward(self.model, data)

    def fill(self, scene: mujoco.MjvScene) -> None:
        """Add the bodies of the other clips, without their scenery."""
        for data in self._datas[1:]:
            moving = mujoco.mjtCatBit.mjCAT_DYNAMIC
            mujoco.mjv_addGeoms(
                self.model, data, mujoco.MjvOption(), mujoco.MjvPerturb(), moving, scene
            )


def shoot(out: str, content: bytes) -> None:
    """Write the video of `packed` clips to `out`, and the number of each image on stdout as it is done."""
    clips, film = unpacked(content)
    scene = scene_of(clips, film)
    width, height = film.size
    visual = scene.model.vis
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.quality.offsamples, visual.quality.shadowsize = SAMPLES, SHADOW_MAP
    writer = imageio_ffmpeg.write_frames(
        out,
        film.size,
        fps=clips[0].rate,  # pyright: ignore[reportArgumentType]
        quality=None,  # pyright: ignore[reportArgumentType]
        macro_block_size=2,
        output_params=ENCODER,
    )
    writer.send(None)
    with mujoco.Renderer(scene.model, height, width) as renderer:
        scene.prepare(renderer.scene)
        for frame in range(len(scene.shots.lookat)):
            scene.pose(frame)
            renderer.update_scene(scene.data, camera=_camera(scene.shots, frame))
            scene.fill(renderer.scene)
            writer.send(np.ascontiguousarray(renderer.render()))
            print(frame + 1, flush=True)
    writer.close()


def _camera(shots: Shots, frame: int) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.lookat[:] = shots.lookat[frame]
    camera.azimuth, camera.elevation, camera.distance = shots.angles(frame)
    return camera


def scene_of(clips: Sequence[Clip], film: Film) -> Scene:
    """Return what is filmed of `clips`: rigid bodies as MuJoCo has them, others as their skeletons have them."""
    system = carried_system(clips[0].name, clips[0].definition)
    if isinstance(system, MujocoSystem):
        return RigidScene(system, clips, film)
    surface, ground = None, False
    if isinstance(system, DeformableSystem):
        surface = system.body.water.surface if system.body.water else None
        ground = system.body.ground is not None
    return Stage(clips, film, Setting(surface, ground))
