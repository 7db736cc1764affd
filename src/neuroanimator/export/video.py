"""A clip as an MP4 video, drawn by MuJoCo without a screen.

Drawing happens in a process of its own, because MuJoCo chooses its graphics library once, when
it is first imported, and by then this process has long imported it.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.errors import ResourceError
from neuroanimator.files import canonical_json
from neuroanimator.unfinished import finish, unfinished

BACKENDS = ("egl", "osmesa")
"""Ways to draw without a screen, tried in this order."""

HOW_TO_GET_GL = (
    "No OpenGL to draw with, so no video: install EGL or OSMesa (Debian: apt-get install libegl1 libosmesa6) "
    "and run again. Everything else works without."
)

LONGEST_DRAWING = 3600
"""[s] A drawing process is given up after this time."""


def write_video(clip: Clip, path: Path, *, width: int = 960, height: int = 720) -> None:
    """Write `clip` to `path` as H.264 at its own rate; ResourceError says what to install if it cannot be drawn."""
    backend = graphics_backend()
    if backend is None:
        raise ResourceError(HOW_TO_GET_GL)
    content = io.BytesIO()
    skeleton = np.array(canonical_json(clip.skeleton.to_json()))
    np.savez(content, states=clip.states, definition=np.array(clip.definition), skeleton=skeleton)
    arguments = [clip.name, str(clip.rate), str(width), str(height)]
    try:
        with unfinished(path, path.suffix) as temporary:
            result = _run("neuroanimator.export.draw", [str(temporary), *arguments], backend, content.getvalue())
            if result.returncode != 0:
                lines = result.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
                raise ResourceError(f"Drawing {path.name} failed: {lines[-1][:200]}. 'neuroanimator doctor' says more.")
            finish(temporary, path)
    except OSError as error:
        raise ResourceError(f"Could not write {path}: {error.strerror}.") from error


def graphics_backend() -> str | None:
    """Return the first of EGL and OSMesa that can draw here; None if neither can."""
    asked = os.environ.get("MUJOCO_GL")
    for backend in (asked,) if asked else BACKENDS:
        if _run("neuroanimator.export.draw", [], backend).returncode == 0:
            return backend
    return None


def _run(module: str, arguments: list[str], backend: str, content: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", module, *arguments],
        env={**os.environ, "MUJOCO_GL": backend},
        input=content,
        capture_output=True,
        timeout=LONGEST_DRAWING,
    )
