"""The drawing process of `video`: states come in as .npz on stdin, an MP4 goes out.

Without arguments it only tries whether drawing works at all.
"""

from __future__ import annotations

import io
import json
import sys
from typing import Protocol

import imageio_ffmpeg
import mujoco
import numpy as np

from neuroanimator.export.stage import Setting, Stage
from neuroanimator.systems import carried_system
from neuroanimator.systems.deformable import DeformableSystem
from neuroanimator.systems.mujoco import MujocoSystem
from neuroanimator.systems.skeleton import Skeleton
from neuroanimator.systems.system import System

QUALITY = 8
"""Of 10; sharp edges, about 100 kB for two seconds."""


class Scene(Protocol):
    """What is filmed."""

    model: mujoco.MjModel

    def prepare(self, scene: mujoco.MjvScene) -> None:
        """Set how `scene` is drawn."""

    def pose(self, data: mujoco.MjData, frame: int) -> None:
        """Put everything where it is in `frame`."""

    def camera(self, frame: int) -> str | mujoco.MjvCamera:
        """Return the camera in `frame`."""


class RigidScene:
    """A system's own MuJoCo model."""

    def __init__(self, system: MujocoSystem, states: np.ndarray):
        self.model, self.states, self._camera = system.model, states, camera_of(system.model)

    def prepare(self, scene: mujoco.MjvScene) -> None:
        """Leave it as it is."""

    def pose(self, data: mujoco.MjData, frame: int) -> None:
        """Put the joints where they are in `frame`."""
        data.qpos[:] = self.states[frame][: self.model.nq]

    def camera(self, frame: int) -> str | mujoco.MjvCamera:
        """Return the model's camera."""
        return self._camera


def draw(out: str, system: str, rate: str, width: str, height: str) -> None:
    """Write the video; all arguments as text, from the command line."""
    content = np.load(io.BytesIO(sys.stdin.buffer.read()), allow_pickle=False)
    skeleton = Skeleton.from_json(json.loads(str(content["skeleton"])))
    scene = scene_of(carried_system(system, str(content["definition"])), skeleton, content["states"], float(rate))
    model, size = scene.model, (int(width), int(height))
    data = mujoco.MjData(model)
    model.vis.global_.offwidth, model.vis.global_.offheight = size
    writer = imageio_ffmpeg.write_frames(out, size, fps=float(rate), quality=QUALITY, macro_block_size=2)  # pyright: ignore[reportArgumentType]
    writer.send(None)
    with mujoco.Renderer(model, size[1], size[0]) as renderer:
        scene.prepare(renderer.scene)
        for frame in range(len(content["states"])):
            scene.pose(data, frame)
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera=scene.camera(frame))
            writer.send(np.ascontiguousarray(renderer.render()))
    writer.close()


def scene_of(system: System, skeleton: Skeleton, states: np.ndarray, rate: float) -> Scene:
    """Return what is filmed of `states` (F, S): rigid bodies as MuJoCo has them, others as their skeleton has them."""
    if isinstance(system, MujocoSystem):
        return RigidScene(system, states)
    surface, ground = None, False
    if isinstance(system, DeformableSystem):
        surface = system.body.water.surface if system.body.water else None
        ground = system.body.ground is not None
    return Stage(skeleton, states, rate, Setting(surface, ground))


def camera_of(model: mujoco.MjModel) -> str | mujoco.MjvCamera:
    """Return the camera `side` if the model has it, else one that follows the first body."""
    if any(model.camera(i).name == "side" for i in range(model.ncam)):
        return "side"
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, min(1, model.nbody - 1)
    return camera


if __name__ == "__main__":
    if len(sys.argv) > 1:
        draw(*sys.argv[1:])
    else:
        mujoco.GLContext(16, 16).make_current()
