"""Options of a film: takes, the picture's size and the camera."""

from __future__ import annotations

from typing import NamedTuple

from neuroanimator.animation.clip import Clip
from neuroanimator.errors import ArgumentError

CAMERAS = {
    "follow": "moves along beside the body, a little above",
    "side": "moves along exactly beside it, level",
    "front": "moves ahead of it, looking back",
    "back": "moves behind it",
    "top": "moves along above it, looking down",
    "still": "stays still, with the whole motion in view",
}
"""Cameras by name, with descriptions."""

DEFAULT_SIZE = (1280, 720)
"""Default width and height of a picture [pixels]: 16:9 as screens are."""

MIN_SIDE = 32
"""Minimum width or height [pixels]: encoders want no less."""

MAX_SIDE = 4096
"""Maximum width or height [pixels]: beyond it, software rendering takes seconds a frame."""


class Film(NamedTuple):
    """How a motion is filmed."""

    size: tuple[int, int] = DEFAULT_SIZE
    """Width and height [pixels], both even, as H.264 wants them."""
    camera: str = "follow"
    """One of `CAMERAS`."""


class Take(NamedTuple):
    """Clips of one system shown together, until the longest ends."""

    clips: tuple[Clip, ...]
    ghost: Clip | None = None
    """Another motion of the first clip's body, drawn translucent at the same place and time."""
    caption: str = ""
    """A line below the picture; empty for none."""

    @property
    def frames(self) -> int:
        """Number of frames drawn."""
        return max(len(clip.times) for clip in self.everything)

    @property
    def everything(self) -> tuple[Clip, ...]:
        """All clips, the ghost last."""
        if self.ghost is None:
            return self.clips
        return (*self.clips, self.ghost)


def checked_film(size: tuple[int, int], camera: str) -> Film:
    """Return the film; ArgumentError says what is wrong with `size` [pixels] or `camera`."""
    width, height = size
    for side in (width, height):
        if side % 2 or not MIN_SIDE <= side <= MAX_SIDE:
            raise ArgumentError(
                f"size: wanted even numbers of pixels between {MIN_SIDE} and {MAX_SIDE}, "
                f"such as 1280x720, got {width}x{height}."
            )
    if camera not in CAMERAS:
        raise ArgumentError(f"No camera called '{camera[:40]}'. Cameras: {', '.join(CAMERAS)}.")
    return Film((width, height), camera)


def read_film(size: str, camera: str) -> Film:
    """Return the film of a size as typed, such as '1280x720', and the name of a camera."""
    width, cross, height = size.partition("x")
    if not (cross and _is_number(width) and _is_number(height)):
        raise ArgumentError(
            f"size: wanted width x height in pixels, such as 1280x720, got '{size[:40]}'."
        )
    if max(len(width), len(height)) > len(str(MAX_SIDE)):
        raise ArgumentError(f"size: wanted at most {MAX_SIDE} pixels a side, got '{size[:40]}'.")
    return checked_film((int(width), int(height)), camera)


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit()
