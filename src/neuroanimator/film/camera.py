"""The camera of a film: beside the moving body, close enough that it fills a good share of the picture."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view

from neuroanimator.animation.clip import Clip
from neuroanimator.film.bounding_boxes import BoundingBoxes, bounding_boxes, fixed_boxes
from neuroanimator.film.options import CAMERAS, Film, Positions, Take, Vector, held
from neuroanimator.state.rotation import heading_of

FIELD_OF_VIEW = 40.0
"""Vertical angle of view [deg]: that of a 50 mm lens."""

BODY_SHARE = 0.5
"""Share of the picture's width, or of its height, that a body fills."""

MAX_SHARE = 0.7
"""Share of the picture's width, or of its height, that a body fills in the frame where it is largest."""

SURFACE_SHARE = 0.65
"""The same as `BODY_SHARE` for a body with a surface of shapes, whose folds should be visible."""

MOTION_SHARE = 0.85
"""Share of the picture's width, or of its height, that several bodies fill, or a motion before a fixed camera."""

STAYING = 2.1
"""Size of the whole motion, over the body's largest, up to which the camera stays fixed: an arm may swing all around."""

SMOOTHING = 0.8
"""Time over which the camera's path is smoothed [s]."""

MAX_LAG = 0.3
"""Maximum distance of the look-at point from the body's middle, over the body's size."""

CLEARANCE = 0.12
"""Minimum distance of the camera from the water's surface, over the body's size."""

FLATTER_UNDER_WATER = 0.5
"""Share of its elevation that a camera keeps under water: near the surface it must be flatter."""

EMERGED = 0.5
"""Share of frames with something out of the water above which the camera is above it, too, if nothing leaps."""

LEAPING = 0.1
"""Height of a body's middle over the water above which it leaps, over its size."""

MAX_GHOST_ROOM = 2.2
"""Maximum factor by which the camera moves away to keep a ghost in the picture."""

MAX_HIDDEN = 0.01
"""Maximum share of the motion that fixed things may hide before another side is tried."""

LOOKED_AT = 0.7
"""Position of the eight points of a body that should be visible, over its half sizes."""

MIN_SIZE = 1e-3
"""Minimum size of a body [m]."""


SIDES = (48.0, -48.0, 132.0, -132.0, 68.0, -68.0, 112.0, -112.0)
"""Azimuths that the camera "follow" may have [deg], the preferred first."""


class Shots(NamedTuple):
    """The camera in every frame."""

    lookat: Positions
    """The middle of the picture [m]."""
    position: Positions
    """Position of the camera [m]."""
    size: float
    """Size of the filmed body or motion [m]."""
    is_under_water: bool

    @property
    def distance(self) -> float:
        """Largest distance of the camera [m]."""
        return float(np.linalg.norm(self.lookat - self.position, axis=1).max())

    def angles(self, frame: int) -> tuple[float, float, float]:
        """Return azimuth [deg], elevation [deg] and distance [m] in `frame`."""
        ahead = self.lookat[frame] - self.position[frame]
        distance = float(np.linalg.norm(ahead))
        azimuth = float(np.degrees(np.arctan2(ahead[1], ahead[0])))
        return azimuth, float(np.degrees(np.arcsin(ahead[2] / distance))), distance


def take_shots(take: Take, film: Film, surface: float | None = None) -> Shots:
    """Return the camera that `film` asks for, with room for the ghost; after the end of the clips it stays.

    It stays on one side of the water's `surface` [m]. The camera "follow" takes the side where fixed things hide the
    least of the motion.
    """
    boxes = bounding_boxes(take.clips)
    obstacles = fixed_boxes(take.clips[0])
    sides = SIDES if film.camera == "follow" else (CAMERAS[film.camera].azimuth,)
    choices = [_shots_from(side, take.clips, boxes, film, surface) for side in sides]
    shots = min(
        choices, key=lambda shots: max(hidden_share(shots.position, boxes, obstacles), MAX_HIDDEN)
    )
    position = shots.position
    if take.ghost is not None:
        others = bounding_boxes([take.ghost]).centres
        frames = min(len(position), len(others))
        apart = np.linalg.norm(boxes.centres[:frames] - others[:frames], axis=1).max()
        room = min(1 + apart / shots.size, MAX_GHOST_ROOM)
        position = shots.lookat + room * (position - shots.lookat)
    return shots._replace(
        lookat=held(shots.lookat, take.frames), position=held(position, take.frames)
    )


def hidden_share(positions: Positions, boxes: BoundingBoxes, obstacles: BoundingBoxes) -> float:
    """Return the share of the motion, over all frames, that the `obstacles` hide from the camera."""
    eye = positions[:, None]
    hidden = []
    for corner in itertools.product((-LOOKED_AT, LOOKED_AT), repeat=3):
        points = boxes.centres + np.array(corner) * boxes.extents / 2
        sight = points[:, None] - eye
        sight[np.abs(sight) < MIN_SIZE] = MIN_SIZE
        # Where the line of sight crosses each pair of planes, as shares of its length (Kay and Kajiya, 1986).
        crossings = np.stack([obstacles.low - eye, obstacles.high - eye]) / sight
        entry = crossings.min(axis=0).max(axis=2)
        leaving = crossings.max(axis=0).min(axis=2)
        hidden.append(((entry <= leaving) & (leaving > 0) & (entry < 1)).any(axis=1))
    return float(np.mean(hidden))


def _shots_from(
    side: float, clips: Sequence[Clip], boxes: BoundingBoxes, film: Film, surface: float | None
) -> Shots:
    """Return the camera that looks from an azimuth of `side` [deg] at what moves in `boxes`."""
    # Distance: the body, or the whole motion, fills its share of the picture.
    whole = boxes.whole
    lengths = boxes.extents.max(axis=1)
    size = max(float(np.median(lengths)), MIN_SIZE)
    share = BODY_SHARE
    largest = MAX_SHARE
    if clips[0].skeleton.shapes is not None:
        share = SURFACE_SHARE
        largest = MOTION_SHARE
    if len(clips) > 1:
        share = MOTION_SHARE
    filling = [(np.median(boxes.extents, axis=0), share), (boxes.extents.max(axis=0), largest)]
    # Middle of the picture: still before a motion in place, else along with the body.
    is_in_place = len(clips) == 1 and whole.extents.max() <= STAYING * lengths.max()
    if film.camera == "still" or (film.camera == "follow" and is_in_place):
        lookat = np.repeat(whole.centres, len(lengths), axis=0)
        filling.append((whole.extents[0], MOTION_SHARE))
    else:
        lookat = camera_path(boxes.centres, round(clips[0].rate * SMOOTHING), MAX_LAG * size)
    distance = max(_distance(extent, share, film) for extent, share in filling)
    # Direction: flatter under water, and clear of its surface.
    is_under_water = surface is not None and film.camera != "top" and not _emerges(boxes, surface)
    elevation = np.radians(CAMERAS[film.camera].elevation)
    if is_under_water:
        elevation *= FLATTER_UNDER_WATER
    azimuth = _headings(clips[0], film, len(lengths)) + np.radians(side)
    level = np.cos(elevation)
    ahead = [
        level * np.cos(azimuth),
        level * np.sin(azimuth),
        np.full_like(azimuth, np.sin(elevation)),
    ]
    position = lookat - distance * np.stack(ahead, axis=1)
    if surface is not None:
        clearance = CLEARANCE * size * (-1 if is_under_water else 1)
        # The path bends smoothly away from the surface.
        free = (position[:, 2] - surface) / clearance - 1
        position[:, 2] = surface + clearance * (1 + np.logaddexp(0.0, free))
    return Shots(lookat, position, size, is_under_water)


def _distance(extent: Vector, share: float, film: Film) -> float:
    """Return the distance [m] from which a box fills this share of the picture's width or height."""
    width, depth, height = extent.tolist()
    length = max(width, depth)
    upright = length if film.camera == "top" else height
    aspect = film.size[0] / film.size[1]
    half_angle = np.tan(np.radians(FIELD_OF_VIEW) / 2)
    far = max(length / aspect, upright, MIN_SIZE) / share / (2 * half_angle)
    return far + min(width, depth) / 2


def _headings(clip: Clip, film: Film, frames: int) -> Float[np.ndarray, " F"]:
    """Return the body's heading for the camera [rad]: the first one, unless the camera is ahead or behind.

    It is that of the bone in the middle of a skin, else of the first that moves.
    """
    skeleton = clip.skeleton
    moving = [number for number in range(len(skeleton.bones)) if skeleton.is_moved(number)] or [0]
    bone = moving[0] if skeleton.skin is None else moving[len(moving) // 2]
    joints = skeleton.bones[bone].joints
    if joints and joints[0].kind != "free":
        # An arm has no heading: its swing must not turn the camera.
        return np.zeros(frames)
    _, orientations = skeleton.world_poses(clip.states)
    headings = heading_of(orientations[:, bone])
    if film.camera not in ("front", "back"):
        return np.full(frames, headings[0])
    smooth = smoothed(np.unwrap(headings)[:, None], round(clip.rate * SMOOTHING))
    return held(smooth[:, 0], frames)


def _emerges(boxes: BoundingBoxes, surface: float) -> bool:
    """Return whether the motion should be seen from above the water: a leap, or along the surface."""
    size = np.linalg.norm(boxes.extents, axis=1).max()
    leaps = (boxes.centres[:, 2] > surface + LEAPING * size).any()
    return bool(leaps or (boxes.high[:, 2] > surface).mean() > EMERGED)


def camera_path(path: Positions, frames: int, max_lag: float) -> Positions:
    """Return `path` [m] smoothed over up to `frames`, less if the camera would lag by more than `max_lag` [m]."""
    while frames > 0:
        smooth = smoothed(path, frames)
        if np.linalg.norm(smooth - path, axis=1).max() <= max_lag:
            return smooth
        frames //= 2
    return path


def smoothed(rows: Float[np.ndarray, "F K"], frames: int) -> Float[np.ndarray, "F K"]:
    """Return `rows` averaged twice over `frames` to either side, with linear extrapolation at the ends."""
    around = ((frames, frames), (0, 0))
    for _ in range(2):
        if len(rows) > frames:
            longer = np.pad(rows, around, mode="reflect", reflect_type="odd")
        else:
            longer = np.pad(rows, around, mode="edge")
        rows = sliding_window_view(longer, 2 * frames + 1, axis=0).mean(axis=-1)
    return rows
