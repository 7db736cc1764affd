"""Clips as an MP4 video, drawn by MuJoCo without a screen and encoded by ffmpeg."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import imageio_ffmpeg

from neuroanimator.animation.clip import Clip, together
from neuroanimator.errors import ArgumentError, ResourceError
from neuroanimator.files.unfinished import finish, unfinished
from neuroanimator.film.graphics import needed_graphics
from neuroanimator.film.options import DEFAULT_SIZE, Film, Picture, Take, checked_film
from neuroanimator.terminal import progress_bar
from neuroanimator.text import printable

MAX_CLIPS = 64
"""Maximum number of clips filmed together: a picture cannot hold many thousand shapes."""

MAX_COMPLAINT = 200
"""Maximum number of characters of ffmpeg's message that an error shows."""

UNEVEN_RATES = 1e-6
"""Largest relative difference of the rates of clips filmed together."""

ENCODING = (
    "-c:v",
    "libx264",
    "-pix_fmt",
    "yuv420p",
    "-preset",
    "superfast",
    "-crf",
    "20",
    "-movflags",
    "+faststart",
)
"""ffmpeg's options: a constant rate factor of 20 shows no loss; a slower preset would take as long as drawing."""


def write_video(
    clips: Clip | Sequence[Clip],
    path: str | Path,
    *,
    ghost: Clip | None = None,
    size: tuple[int, int] = DEFAULT_SIZE,
    camera: str = "follow",
) -> None:
    """Write one clip, or several seen together, to `path` as H.264 at their own rate.

    `size` is width and height [pixels]; `camera` is one of `options.CAMERAS`. Several clips, such as a school, have one
    system and one rate; shorter ones stay at their last pose. A `ghost` is another motion of the same body, in one
    translucent colour. ResourceError says what to install if nothing can be drawn here.
    """
    takes = [Take(tuple(together(clips, ghost)), ghost)]
    write_takes(takes, path, size=size, camera=camera)


def write_takes(
    takes: Sequence[Take],
    path: str | Path,
    *,
    size: tuple[int, int] = DEFAULT_SIZE,
    camera: str = "follow",
) -> None:
    """Write `takes` one after another to `path`, as `write_video` does one; all have one rate."""
    path = Path(path)
    film = checked_film(size, camera)
    rate = takes[0].clips[0].rate
    for take in takes:
        _check_together(take, rate)
    needed_graphics()
    from neuroanimator.film.drawing import draw_takes

    count = sum(take.frames for take in takes)
    try:
        with unfinished(path, path.suffix) as temporary:
            with progress_bar(f"drawing {path.name}", count) as bar:
                _encode(draw_takes(takes, film, bar), temporary, film, rate)
            finish(temporary, path)
    except OSError as error:
        raise ResourceError(f"Could not write {path}: {error.strerror}.") from error


def _encode(images: Iterable[Picture], out: Path, film: Film, rate: float) -> None:
    """Write `images` to `out` as they arrive, `rate` a second."""
    width, height = film.size
    source = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{rate:.9g}")
    program = (imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y")
    command = [*program, *source, "-i", "-", *ENCODING, str(out)]
    with tempfile.TemporaryFile() as complaints:
        # In a session of its own: Ctrl-C in a terminal is for this process.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stderr=complaints, start_new_session=True
        )
        assert process.stdin is not None
        try:
            # If it ends early, it says why.
            with suppress(BrokenPipeError), process.stdin:
                for image in images:
                    process.stdin.write(image.tobytes())
            code = process.wait()
        finally:
            process.kill()
            process.wait()
        complaints.seek(0)
        lines = complaints.read().decode(errors="replace").strip().splitlines()
    if code:
        reason = lines[-1] if lines else f"ffmpeg ended with {code}"
        raise ResourceError(f"The film was not written: {printable(reason)[:MAX_COMPLAINT]}.")


def _check_together(take: Take, rate: float) -> None:
    """Raise ArgumentError for clips that are neither of one system nor a surface alone, or not of this `rate`."""
    clips = together(take.clips, take.ghost)
    if len(clips) > MAX_CLIPS:
        raise ArgumentError(f"clips: wanted 1 to {MAX_CLIPS} to film together, got {len(clips)}.")
    first = clips[0]
    for clip in clips:
        has_parts = any(bone.shapes for bone in clip.skeleton.bones)
        is_garment = clip.skeleton.shapes is not None and not has_parts
        if not is_garment and (clip.name, clip.definition) != (first.name, first.definition):
            raise ArgumentError(
                f"clips: wanted clips of one system, got {first.name} and {clip.name}."
            )
        if abs(clip.rate - rate) > UNEVEN_RATES * rate:
            raise ArgumentError(
                f"clips: wanted one rate, got {rate:g} and {clip.rate:g} frames a second."
            )
