"""A clip as an MP4 video, drawn by MuJoCo without a screen."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.errors import ResourceError

BACKENDS = ("egl", "osmesa")
"""Ways to draw without a screen, tried in this order."""

HOW_TO_GET_GL = (
    "No OpenGL to draw with, so no video: install EGL or OSMesa (Debian: apt-get install libegl1 libosmesa6) "
    "and run again. Everything else works without."
)


def graphics_backend() -> str | None:
    """Return the first of EGL and OSMesa that can draw here, tried in a process of its own; None if neither."""
    asked = os.environ.get("MUJOCO_GL")
    for backend in (asked,) if asked else BACKENDS:
        probe = "import mujoco; mujoco.GLContext(16, 16).make_current()"
        result = subprocess.run(
            [sys.executable, "-c", probe],
            env={**os.environ, "MUJOCO_GL": backend},
            capture_output=True,
            timeout=60,
        )
        if result.returncode == 0:
            return backend
    return None


def write_video(clip: Clip, path: Path, *, width: int = 640, height: int = 640) -> None:
    """Write `clip` to `path` as H.264 at its own rate; ResourceError says what to install if it cannot be drawn."""
    backend = graphics_backend()
    if backend is None:
        raise ResourceError(HOW_TO_GET_GL)
    os.environ["MUJOCO_GL"] = backend  # read by MuJoCo when it is first imported for drawing
    frames = draw_frames(clip, width, height)
    _encode(frames, clip.rate, path)


def draw_frames(clip: Clip, width: int, height: int) -> np.ndarray:
    """Return the frames (F, height, width, 3) of `clip` as bytes."""
    import mujoco

    from neuroanimator.systems import load_system
    from neuroanimator.systems.mujoco import MujocoSystem

    system = load_system(clip.name)
    assert isinstance(system, MujocoSystem)
    data = mujoco.MjData(system.model)
    frames = np.empty((len(clip.states), height, width, 3), np.uint8)
    with mujoco.Renderer(system.model, height, width) as renderer:
        for frame, state in zip(frames, clip.states, strict=True):
            data.qpos[:] = state[: system.model.nq]
            mujoco.mj_forward(system.model, data)
            renderer.update_scene(data, camera="side")
            frame[:] = renderer.render()
    return frames


def _encode(frames: np.ndarray, rate: float, path: Path) -> None:
    import imageio_ffmpeg

    path.parent.mkdir(parents=True, exist_ok=True)
    size = (frames.shape[2], frames.shape[1])
    options = ["-movflags", "+faststart"]
    writer = imageio_ffmpeg.write_frames(str(path), size, fps=rate, quality=8, output_params=options)
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()
