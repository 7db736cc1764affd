"""The drawing process of `video`: states come in as .npy on stdin, an MP4 goes out.

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
    states = np.load(io.BytesIO(sys.stdin.buffer.read()), allow_pickle=False)
    model = load_mujoco(system).model
    data = mujoco.MjData(model)
    size = (int(width), int(height))
    writer = imageio_ffmpeg.write_frames(out, size, fps=float(rate), quality=QUALITY, macro_block_size=2)  # pyright: ignore[reportArgumentType]
    writer.send(None)
    with mujoco.Renderer(model, size[1], size[0]) as renderer:
        for state in states:
            data.qpos[:] = state[: model.nq]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera="side")
            writer.send(np.ascontiguousarray(renderer.render()))
    writer.close()


def load_mujoco(name: str) -> MujocoSystem:
    """Return the system called `name`, which must be MuJoCo's to be drawn by it."""
    system = load_system(name)
    assert isinstance(system, MujocoSystem)
    return system


if __name__ == "__main__":
    if len(sys.argv) > 1:
        draw(*sys.argv[1:])
    else:
        mujoco.GLContext(16, 16).make_current()
