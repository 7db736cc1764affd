"""Clips as an MP4 video, drawn by MuJoCo without a screen.

Drawing happens in a process of its own, because MuJoCo chooses its graphics library once, when
it is first imported, and by then this process has long imported it.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from threading import Timer

from neuroanimator.animation.clip import Clip, check_drawable
from neuroanimator.errors import ArgumentError, ResourceError
from neuroanimator.executor.python_command import python_command
from neuroanimator.export.film.clip_bytes import pack_takes
from neuroanimator.export.film.options import DEFAULT_SIZE, checked_film
from neuroanimator.export.film.takes import Take
from neuroanimator.export.film.video_worker import NO_GRAPHICS
from neuroanimator.storage.unfinished import finish, unfinished
from neuroanimator.terminal import Bar, progress_bar
from neuroanimator.text import printable

BACKENDS = ("egl", "osmesa")
"""Graphics libraries that draw without a screen, tried in this order."""

HOW_TO_GET_GL = (
    "No OpenGL to draw with, so no video: install EGL or OSMesa (Debian: apt-get install libegl1 libosmesa6) "
    "and run again. Everything else works without."
)
"""What an error says where nothing can be drawn."""

NOT_WITH_THIS_GL = (
    "MUJOCO_GL={asked} asks to draw with {asked} alone, which does not work here{why}. "
    "Unset it, or set it to egl or osmesa."
)
"""What an error says where the graphics library that was asked for cannot draw."""

WORKER = "neuroanimator.export.film.video_worker"
"""The module that the drawing process runs."""

MAX_DRAWING = 3600
"""Time after which a drawing process is given up [s]."""

MAX_CLIPS = 64
"""The most clips filmed together: MuJoCo's picture has no room for many thousand shapes."""

MAX_COMPLAINT = 200
"""Characters of a drawing process's complaint that an error shows."""

UNEVEN_RATES = 1e-6
"""Share by which the rates of clips filmed together may differ."""


def write_video(
    clips: Clip | Sequence[Clip],
    path: str | Path,
    *,
    ghost: Clip | None = None,
    size: tuple[int, int] = DEFAULT_SIZE,
    camera: str = "follow",
) -> None:
    """Write one clip, or several seen together, to `path` as H.264 at their own rate.

    `size` is width and height [pixels]; `camera` is one of `options.CAMERAS`. Several clips are of one system and one
    rate, such as a school; the shorter ones stay at their last pose. A `ghost` is another motion of the same body, in
    one translucent colour. ResourceError says what to install if nothing can be drawn here.
    """
    together = [clips] if isinstance(clips, Clip) else list(clips)
    write_takes([Take(tuple(together), ghost)], path, size=size, camera=camera)


def write_takes(
    takes: Sequence[Take],
    path: str | Path,
    *,
    size: tuple[int, int] = DEFAULT_SIZE,
    camera: str = "follow",
    is_quick: bool = False,
) -> None:
    """Write `takes` one after another to `path`, as `write_video` does one; all are of one rate.

    What `is_quick` is drawn in a third of the time, with coarser edges and shadows.
    """
    path = Path(path)
    film = checked_film(size, camera, is_quick=is_quick)
    for take in takes:
        _check_together(take.everything)
    _check_rates([take.clips[0] for take in takes])
    content = pack_takes(takes, film)
    images = sum(take.frames + take.held for take in takes)
    try:
        with unfinished(path, path.suffix) as temporary:
            with progress_bar(f"drawing {path.name}", images) as bar:
                _draw(content, temporary, path.name, images, bar)
            finish(temporary, path)
    except OSError as error:
        raise ResourceError(f"Could not write {path}: {error.strerror}.") from error


def _check_together(clips: Sequence[Clip]) -> None:
    if not 1 <= len(clips) <= MAX_CLIPS:
        raise ArgumentError(f"clips: wanted 1 to {MAX_CLIPS} to film together, came {len(clips)}.")
    for clip in clips:
        check_drawable(clip)
    first = clips[0]
    for clip in clips[1:]:
        if (clip.name, clip.definition) != (first.name, first.definition):
            raise ArgumentError(
                f"clips: wanted several of one system, came {clip.name} beside {first.name}."
            )
    _check_rates(clips)


def _check_rates(clips: Sequence[Clip]) -> None:
    first = clips[0]
    for clip in clips[1:]:
        if abs(clip.rate - first.rate) > UNEVEN_RATES * first.rate:
            raise ArgumentError(
                f"clips: wanted one rate, came {clip.rate:g} beside {first.rate:g} a second."
            )


def _draw(content: bytes, temporary: Path, name: str, images: int, bar: Bar) -> None:
    """Draw with the first graphics library that works here; ResourceError if none does."""
    for backend in _backends():
        code, complaint = _run_drawing(content, temporary, backend, images, bar)
        if code == 0:
            return
        if code != NO_GRAPHICS:
            raise ResourceError(
                f"Drawing {name} failed: {complaint[:MAX_COMPLAINT]}. 'neuroanimator doctor' says more."
            )
    raise ResourceError(why_no_graphics())


def _run_drawing(content: bytes, out: Path, backend: str, images: int, bar: Bar) -> tuple[int, str]:
    """Return the drawing process's exit code and its last complaint; it ends whenever this function does."""
    command = python_command("-m", WORKER, str(out))
    with tempfile.TemporaryFile() as clips, tempfile.TemporaryFile() as complaints:
        clips.write(content)
        clips.seek(0)
        with subprocess.Popen(
            command,
            env=_environment(backend),
            stdin=clips,
            stdout=subprocess.PIPE,
            stderr=complaints,
        ) as process:
            alarm = Timer(MAX_DRAWING, process.kill)
            alarm.daemon = True
            alarm.start()
            try:
                assert process.stdout is not None
                for line in process.stdout:
                    _show_progress(bar, line, images)
                code = process.wait()
            finally:
                alarm.cancel()
                process.kill()
        complaints.seek(0)
        lines = complaints.read().decode(errors="replace").strip().splitlines()
    return code, lines[-1] if lines else "no message"


def _show_progress(bar: Bar, line: bytes, images: int) -> None:
    """Show the number of the image on a `line` of the drawing process, if it is one."""
    text = line.strip()
    if not text.isdigit():
        return
    done = int(text)
    bar.advance_to(done, "encoding" if done >= images else "")


def graphics_backend() -> str | None:
    """Return the first of EGL and OSMesa that can draw here; None if neither can."""
    command = python_command("-m", WORKER)
    for backend in _backends():
        trial = subprocess.run(
            command, env=_environment(backend), capture_output=True, timeout=MAX_DRAWING
        )
        if trial.returncode == 0:
            return backend
    return None


def why_no_graphics() -> str:
    """Return why nothing can be drawn here, and what helps."""
    asked = os.environ.get("MUJOCO_GL")
    if not asked:
        return HOW_TO_GET_GL
    why = ": it needs a display" if asked == "glfw" else ""
    return NOT_WITH_THIS_GL.format(asked=printable(asked), why=why)


def _environment(backend: str) -> dict[str, str]:
    """Return the environment of a process that draws with that graphics library."""
    return {**os.environ, "MUJOCO_GL": backend}


def _backends() -> tuple[str, ...]:
    """Return the graphics libraries to try: the one the user asks for, or all."""
    asked = os.environ.get("MUJOCO_GL")
    return (asked,) if asked else BACKENDS
