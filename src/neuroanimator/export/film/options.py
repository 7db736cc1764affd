"""How a motion is filmed: the picture's size and the camera, as users say it."""

from __future__ import annotations

from typing import NamedTuple

from neuroanimator.errors import ArgumentError

CAMERAS = {
    "follow": "goes along at the body's side, a little above, or behind one that sways",
    "side": "goes along exactly beside it, level",
    "front": "goes ahead of it and looks back",
    "back": "goes behind it",
    "top": "goes along above it and looks down",
    "still": "stays where it is, with the whole motion in view",
}
"""Cameras by name, and what each does."""

DEFAULT_SIZE = (1280, 720)
"""Width and height of a picture if nothing else is said [pixels]: 16:9 as screens are."""

MIN_SIDE = 32
"""Least width or height [pixels]: no encoder likes less."""

MAX_SIDE = 4096
"""Greatest width or height [pixels]: software that draws more takes seconds an image."""


class Film(NamedTuple):
    """How a motion is filmed."""

    size: tuple[int, int] = DEFAULT_SIZE
    """Width and height [pixels], both even, as H.264 wants them."""
    camera: str = "follow"
    """One of `CAMERAS`."""
    is_quick: bool = False
    """Whether it is drawn in a third of the time, with coarser edges and shadows."""


def checked_film(size: tuple[int, int], camera: str, *, is_quick: bool = False) -> Film:
    """Return the film; ArgumentError says what is wrong with `size` [pixels] or `camera`."""
    width, height = size
    for side in (width, height):
        if side % 2 or not MIN_SIDE <= side <= MAX_SIDE:
            raise ArgumentError(
                f"size: wanted even numbers of pixels between {MIN_SIDE} and {MAX_SIDE}, "
                f"such as 1280x720, came {width}x{height}."
            )
    if camera not in CAMERAS:
        raise ArgumentError(f"No camera called '{camera[:40]}'. Cameras: {', '.join(CAMERAS)}.")
    return Film((width, height), camera, is_quick)


def read_film(size: str, camera: str) -> Film:
    """Return the film of a size as typed, such as '1280x720', and the name of a camera."""
    width, cross, height = size.partition("x")
    if not (cross and _is_number(width) and _is_number(height)):
        raise ArgumentError(
            f"size: wanted width x height in pixels, such as 1280x720, came '{size[:40]}'."
        )
    if max(len(width), len(height)) > len(str(MAX_SIDE)):
        raise ArgumentError(f"size: wanted at most {MAX_SIDE} pixels a side, came '{size[:40]}'.")
    return checked_film((int(width), int(height)), camera)


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit()
