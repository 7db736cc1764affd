"""Options of a film: takes, the picture's size and the camera."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped, UInt8

from neuroanimator.animation.clip import Clip
from neuroanimator.errors import ArgumentError

Picture = UInt8[np.ndarray, "H W 3"]
"""Red, green and blue of every pixel."""

Positions = Float[np.ndarray, "F 3"]
"""A point in each frame [m]."""

Vector = Float[np.ndarray, " 3"]
"""A point, a direction or the sides of a box [m]."""


class Camera(NamedTuple):
    """Where a camera is, and in which direction it looks."""

    about: str
    """What it does, for the command line's help."""
    azimuth: float
    """Angle from the body's own direction [deg]: 90 is from its right side."""
    elevation: float
    """Angle above the horizon [deg]; negative when looking down."""


CAMERAS = {
    "follow": Camera("moves along beside the body, a little above", 48.0, -17.0),
    "side": Camera("moves along exactly beside it, level", 90.0, 0.0),
    "front": Camera("moves ahead of it, looking back", 180.0, -8.0),
    "back": Camera("moves behind it", 0.0, -12.0),
    "top": Camera("moves along above it, looking down", 90.0, -89.0),
    "still": Camera("stays still, with the whole motion in view", 48.0, -17.0),
}
"""Cameras by name."""

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
    sides = re.fullmatch("([0-9]+)x([0-9]+)", size)
    if sides is None:
        raise ArgumentError(
            f"size: wanted width x height in pixels, such as 1280x720, got '{size[:40]}'."
        )
    width, height = sides.groups()
    if max(len(width), len(height)) > len(str(MAX_SIDE)):
        raise ArgumentError(f"size: wanted at most {MAX_SIDE} pixels a side, got '{size[:40]}'.")
    return checked_film((int(width), int(height)), camera)


def held(rows: Shaped[np.ndarray, "T ..."], frames: int) -> Shaped[np.ndarray, "F ..."]:
    """Return `rows` for each of `frames`: after their end the last one stays."""
    return rows[np.minimum(np.arange(frames), len(rows) - 1)]
