"""Export of an emulator's worst cases: a film of bodies or gauges, or curves."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import Clip, make_clip
from neuroanimator.emulator.checks import MAX_MAGNITUDE
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.export.comparison import drawn_pair
from neuroanimator.files.atomic import write_whole
from neuroanimator.film.options import Take, held
from neuroanimator.film.video import write_takes
from neuroanimator.learn.evaluation.figures import draw_segments
from neuroanimator.learn.evaluation.plots import svg_text
from neuroanimator.learn.evaluation.weakness.inspection import Inspection
from neuroanimator.text import short_number

FORMATS = (".mp4", ".png", ".svg")
"""Suffixes of files of worst cases."""

SIZE = (640, 360)
"""Width and height of the film [pixels]: small enough for a page, and drawn in seconds."""

SLOWER = 2.0
"""Factor of slow motion: errors arise within a super step or two."""

RATE = 16.0
"""Frame rate of the film [Hz]."""

HELD_SECONDS = 0.5
"""Time for which the film holds the end of each case [s]."""

WORST_TITLE = "The worst cases as a film"
"""Heading of the film in a report."""

WORST_WORDS = (
    "The unseen segments with the largest errors, half as fast as they happen: the physics, and in magenta the emulator "
    "from the same state under the same controls. Off by: root mean square error, over how far runs get in this time."
)
"""Caption of the film in a report."""

DPI = 130
"""Resolution of a PNG file [pixels per inch]."""


def check_worst_path(path: Path) -> None:
    """Raise ArgumentError for a file name that worst cases cannot be written to."""
    if path.suffix not in FORMATS:
        raise ArgumentError(f"worst: '{path.name}' ends in none of {', '.join(FORMATS)}.")


def write_worst(
    emulators: Emulator | Sequence[Emulator],
    inspections: Inspection | Sequence[Inspection],
    path: str | Path,
) -> None:
    """Write the worst segments that `na.inspect` found of one emulator, or of several, to `path`.

    `.mp4` is a film: the physics, and the emulator as a translucent ghost in the same place, at half speed.
    Systems without bodies are shown as gauges. `.svg` and `.png` are curves of the most erroneous numbers. Raises
    ArgumentError for other suffixes; ResourceError if nothing can be drawn.
    """
    path = Path(path)
    several = [emulators] if isinstance(emulators, Emulator) else list(emulators)
    found = [inspections] if isinstance(inspections, Inspection) else list(inspections)
    check_worst_path(path)
    if path.suffix == ".mp4":
        takes = []
        for emulator, inspection in zip(several, found, strict=True):
            takes += _takes(emulator, inspection)
        write_takes(takes, path, size=SIZE)
        return
    segments = [segment for inspection in found for segment in inspection.worst]
    figure = draw_segments(segments, found[0].truth_name)
    if path.suffix == ".svg":
        write_whole(path, svg_text(figure).encode())
        return
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=DPI)
    write_whole(path, content.getvalue())


def _takes(emulator: Emulator, inspection: Inspection) -> list[Take]:
    takes = []
    for number, segment in enumerate(inspection.worst, start=1):
        physics = _slow_clip(emulator, segment.physics, "physics")
        emulated = _slow_clip(emulator, segment.emulated, "emulator")
        shown, ghost = drawn_pair(physics, emulated, emulator)
        caption = (
            f"{emulator.system}, n = {emulator.substeps}, worst {number} of {len(inspection.worst)}: off by "
            f"{short_number(segment.error)}, most of all in {segment.component}. Magenta: the emulator"
        )
        takes.append(Take((shown,), ghost, caption))
    return takes


def _slow_clip(emulator: Emulator, states: Float[np.ndarray, "T1 S"], source: str) -> Clip:
    """Return the clip of a segment in slow motion, with its end held."""
    clip = make_clip(emulator, _sound(states), rate=SLOWER * RATE, source=source)
    shown = held(clip.states, len(clip.states) + round(HELD_SECONDS * RATE))
    return replace(clip, states=shown, times=np.arange(len(shown)) / RATE)


def _sound(states: Float[np.ndarray, "T1 S"]) -> Float[np.ndarray, "T1 S"]:
    """Return a trajectory that stays at its last usable state once its numbers become unusable."""
    with np.errstate(invalid="ignore"):
        is_sound = (np.abs(states) < MAX_MAGNITUDE).all(axis=1)
    last = len(states) if is_sound.all() else int(np.argmin(is_sound))
    return held(states[: max(last, 1)], len(states))
