"""Films inside a page that needs no other file."""

from __future__ import annotations

import base64
import html
import tempfile
from pathlib import Path

from neuroanimator.animation.clip import make_clip
from neuroanimator.animation.gauges import drawable
from neuroanimator.animation.motion import default_motion
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ResourceError
from neuroanimator.export.film.video import write_video

SIZE = (640, 360)
"""Width and height of a film in a page [pixels]: a few hundred kilobytes, drawn in seconds."""

MOTION_WORDS = "What 'animate' shows: the emulator's own motion."
"""What stands below it."""


def film_html(path: Path, words: str) -> str:
    """Return the film at `path`, and `words` about it, as part of a page."""
    content = base64.b64encode(path.read_bytes()).decode("ascii")
    source = f"data:video/mp4;base64,{content}"
    return (
        f'<video controls loop muted playsinline src="{source}"></video><p>{html.escape(words)}</p>'
    )


def motion_html(emulator: Emulator) -> str:
    """Return what the emulator does, as part of a page; where nothing can be drawn, a line that says so."""
    states = default_motion(emulator)
    clip = drawable(make_clip(emulator, states, source="emulator"), emulator)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "motion.mp4"
        try:
            write_video(clip, path, size=SIZE)
        except ResourceError as error:
            return f"<p>{html.escape(str(error))}</p>"
        return film_html(path, MOTION_WORDS)
