"""The drawing process of `video`: states come in as .npz on stdin, an MP4 goes out.

Without arguments it only tries whether drawing works at all.
"""

from __future__ import annotations

import io
import sys

import imageio_ffmpeg
import mujoco
import numpy as np

from neuroanimator.systems import load_system
from neuroanimator.systems.mujoco import MujocoSystem

QUALITY = 8
"""Of 10; sharp edges, about 100 kB for two seconds."""


def draw(out: str, system: str, rate: str, width: str, height: str) -> None:
    """Write the video; all arguments as text, from the command line."""
    content = np.load(io.BytesIO(sys.stdin.buffer.read()), allow_pickle=False)
    model = load_mujoco(system, str(content["definition"])).model
    data, camera = mujoco.MjData(model), camera_of(model)
    model.vis.global_.offwidth, model.vis.global_.offheight = int(width), int(height)
    size = (int(width), int(height))
    writer = imageio_ffmpeg.write_frames(out, size, fps=float(rate), quality=QUALITY, macro_block_size=2)  # pyright: ignore[reportArgumentType]
    writer.send(None)
    with mujoco.Renderer(model, size[1], size[0]) as renderer:
        for state in content["states"]:
            data.qpos[:] = state[: model.nq]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera=camera)
            writer.send(np.ascontiguousarray(renderer.render()))
    writer.close()


def camera_of(model: mujoco.MjModel) -> str | mujoco.MjvCamera:
    """Return the camera `side` if the model has it, else one that follows the first body."""
    if any(model.camera(i).name == "side" for i in range(model.ncam)):
        return "side"
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, min(1, model.nbody - 1)
    return camera


def load_mujoco(name: str, definition: str) -> MujocoSystem:
    """Return the system called `name`, which must be MuJoCo's to be drawn by it."""
    system = load_system(name, definition)
    assert isinstance(system, MujocoSystem)
    return system


if __name__ == "__main__":
    if len(sys.argv) > 1:
        draw(*sys.argv[1:])
    else:
        mujoco.GLContext(16, 16).make_current()
