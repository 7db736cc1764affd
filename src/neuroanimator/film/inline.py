"""Films inside a page that needs no other file."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import NamedTuple

from markupsafe import Markup

from neuroanimator.animation.clip import Clip, make_clip
from neuroanimator.animation.gauges import drawable
from neuroanimator.animation.motion import default_drive
from neuroanimator.control.synthesis.replay import Replay
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ResourceError
from neuroanimator.export.comparison import replay_clips
from neuroanimator.files.unfinished import temporary_folder
from neuroanimator.film.video import write_video
from neuroanimator.learn.evaluation.page import render
from neuroanimator.physics import tied_system

SIZE = (640, 360)
"""Width and height of a film in a page [pixels]: a few hundred kilobytes, drawn in seconds."""

MOTION_WORDS = "What 'animate' shows: the emulator's own motion."
"""Caption of the film of an emulator's motion."""

REPLAY_WORDS = (
    "What the controls do on the true physics, and in magenta what the emulator predicted."
)
"""Caption of the film of a replay."""

EMULATED_WORDS = "What the controls do on the emulator; there is no physics to replay them on."
"""Caption of the film of a replay without physics."""


class InlineFilm(NamedTuple):
    """A film that a notebook shows below the cell whose last line it is."""

    html: Markup

    def _repr_html_(self) -> str:
        return self.html


def show(clip: Clip, *, ghost: Clip | None = None) -> InlineFilm:
    """Return the film of `clip` for a notebook, with another motion of the same body as its `ghost`.

    Where nothing can be drawn, the notebook says so.
    """
    return InlineFilm(_drawn_html(clip, "", ghost))


def film_html(path: Path, words: str) -> Markup:
    """Return the film at `path`, and `words` about it, as part of a page."""
    content = base64.b64encode(path.read_bytes()).decode("ascii")
    return render("film.html", video=content, caption=words)


def replay_html(emulator: Emulator, replay: Replay) -> Markup:
    """Return the motion on the physics, the emulator's as a ghost, as part of a page; or a line that says why not."""
    clip, ghost = replay_clips(emulator, replay)
    return _drawn_html(clip, EMULATED_WORDS if ghost is None else REPLAY_WORDS, ghost)


def motion_html(emulator: Emulator) -> Markup:
    """Return the emulator's motion as part of a page; if nothing can be drawn, a line that says so."""
    states = default_drive(emulator, tied_system(emulator.spec)).motion(emulator)
    clip = drawable(make_clip(emulator, states, source="emulator"), emulator)
    return _drawn_html(clip, MOTION_WORDS)


def _drawn_html(clip: Clip, words: str, ghost: Clip | None = None) -> Markup:
    """Return the film of `clip` for a page; if nothing can be drawn, a line that says so."""
    with temporary_folder() as folder:
        path = folder / "motion.mp4"
        try:
            write_video(clip, path, ghost=ghost, size=SIZE)
        except ResourceError as error:
            return render("film.html", video="", caption=str(error))
        return film_html(path, words)
