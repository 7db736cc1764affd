"""The camera of a film: beside the moving body, close enough that it fills a good share of the picture."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.animation.clip import Clip
from neuroanimator.export.film.bounding_boxes import (
    BoundingBoxes,
    bounding_boxes,
    fixed_boxes,
    lasting,
)
from neuroanimator.export.film.options import Film, Take
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


class ViewDirection(NamedTuple):
    """A direction to look in."""

    azimuth: float
    """Angle from the body's own direction [deg]: 90 is from its right side."""
    elevation: float
    """Angle above the horizon [deg]; negative when looking down."""


VIEWS = {
    "follow": ViewDirection(48.0, -17.0),
    "side": ViewDirection(90.0, 0.0),
    "front": ViewDirection(180.0, -8.0),
    "back": ViewDirection(0.0, -12.0),
    "top": ViewDirection(90.0, -89.0),
    "still": ViewDirection(48.0, -17.0),
}
"""The views of `options.CAMERAS`."""


Positions = Float[np.ndarray, "F 3"]
"""A point in every frame [m]."""

SIDES = (48.0, -48.0, 132.0, -132.0, 68.0, -68.0, 112.0, -112.0)
"""Azimuths that the camera "follow" may have [deg], the preferred first."""


class Shots(NamedTuple):
    """The camera in every frame."""

    lookat: Positions
    """The middle of the picture."""
    position: Positions
    """Position of the camera."""
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
    """Return the camera of a take, with room for its ghost; after the end of its clips it stays."""
    shots = shots_of(take.clips, film, surface)
    position = shots.position
    if take.ghost is not None:
        centres = bounding_boxes(take.clips[:1]).centres
        others = bounding_boxes([take.ghost]).centres
        frames = min(len(centres), len(others))
        apart = float(np.linalg.norm(centres[:frames] - others[:frames], axis=1).max())
        room = min(1 + apart / shots.size, MAX_GHOST_ROOM)
        position = shots.lookat + room * (position - shots.lookat)
    return shots._replace(
        lookat=lasting(shots.lookat, take.frames), position=lasting(position, take.frames)
    )


def shots_of(clips: Sequence[Clip], film: Film, surface: float | None = None) -> Shots:
    """Return the camera that `film` asks for, in front of what moves in `clips`.

    It stays on one side of the water's `surface` [m]. The camera "follow" takes the side where fixed things hide the
    least of the motion.
    """
    boxes = bounding_boxes(clips)
    view = VIEWS[film.camera]
    if film.camera != "follow":
        return _shots_from(view, clips, boxes, film, surface)
    obstacles = fixed_boxes(clips[0])
    sides = []
    for azimuth in SIDES:
        shots = _shots_from(view._replace(azimuth=azimuth), clips, boxes, film, surface)
        hidden = max(hidden_share(shots.position, boxes, obstacles), MAX_HIDDEN)
        sides.append((hidden, shots))
    return min(sides, key=lambda side: side[0])[1]


def hidden_share(positions: Positions, boxes: BoundingBoxes, obstacles: BoundingBoxes) -> float:
    """Return the share of the motion, over all frames, that the `obstacles` hide from the camera."""
    hidden = []
    for corner in itertools.product((-LOOKED_AT, LOOKED_AT), repeat=3):
        points = boxes.centres + np.array(corner) * (boxes.high - boxes.low) / 2
        hidden.append(_is_hidden(positions, points, obstacles))
    return float(np.mean(hidden))


def _is_hidden(
    positions: Positions, points: Positions, obstacles: BoundingBoxes
) -> Bool[np.ndarray, " F"]:
    """Return for each frame whether an obstacle is between the camera and a point."""
    sight = (points - positions)[:, None]
    safe = np.where(np.abs(sight) < MIN_SIZE, MIN_SIZE, sight)
    # Where the line of sight enters and leaves each pair of planes, as shares of its length (Kay and Kajiya, 1986).
    first = (obstacles.low - positions[:, None]) / safe
    second = (obstacles.high - positions[:, None]) / safe
    entry = np.minimum(first, second).max(axis=2)
    leaving = np.maximum(first, second).min(axis=2)
    return ((entry <= leaving) & (leaving > 0) & (entry < 1)).any(axis=1)


def _shots_from(
    view: ViewDirection,
    clips: Sequence[Clip],
    boxes: BoundingBoxes,
    film: Film,
    surface: float | None,
) -> Shots:
    """Return the camera that looks from `view` at what moves in `boxes`."""
    is_under_water = surface is not None and film.camera != "top" and not _emerges(boxes, surface)
    azimuth = _headings(clips[0], film, len(boxes.low)) + np.radians(view.azimuth)
    size = max(float(np.median(boxes.sizes)), MIN_SIZE)
    is_in_place = len(clips) == 1 and boxes.whole.sizes[0] <= STAYING * boxes.sizes.max()
    extents = boxes.high - boxes.low
    share = BODY_SHARE
    largest = MAX_SHARE
    if clips[0].skeleton.shapes is not None:
        share = SURFACE_SHARE
        largest = MOTION_SHARE
    if len(clips) > 1:
        share = MOTION_SHARE
    usual = _distance(np.median(extents, axis=0), share, film)
    distance = max(usual, _distance(extents.max(axis=0), largest, film))
    if film.camera == "still" or (film.camera == "follow" and is_in_place):
        lookat = np.repeat(boxes.whole.centres, len(boxes.low), axis=0)
        distance = max(
            distance, _distance((boxes.whole.high - boxes.whole.low)[0], MOTION_SHARE, film)
        )
    else:
        lookat = camera_path(boxes.centres, round(clips[0].rate * SMOOTHING), MAX_LAG * size)
    elevation = np.radians(view.elevation * (FLATTER_UNDER_WATER if is_under_water else 1.0))
    level = np.cos(elevation) * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    ahead = np.column_stack([level, np.full(len(level), np.sin(elevation))])
    position = lookat - distance * ahead
    if surface is not None:
        side = -1.0 if is_under_water else 1.0
        clearance = CLEARANCE * size
        # The path bends smoothly away from the surface.
        free = side * (position[:, 2] - surface) / clearance - 1
        position[:, 2] = surface + side * clearance * (1 + np.logaddexp(0.0, free))
    return Shots(lookat, position, size, is_under_water)


def _distance(extent: Float[np.ndarray, " 3"], share: float, film: Film) -> float:
    """Return the distance [m] from which a box fills this share of the picture's width or height."""
    width, depth, height = extent.tolist()
    length = max(width, depth)
    upright = length if film.camera == "top" else height
    aspect = film.size[0] / film.size[1]
    half_angle = np.tan(np.radians(FIELD_OF_VIEW) / 2)
    far = max(length / aspect, upright, MIN_SIZE) / share / (2 * half_angle)
    return far + min(width, depth) / 2


def _headings(clip: Clip, film: Film, frames: int) -> Float[np.ndarray, " F"]:
    """Return the body's heading for the camera [rad]: the first one, unless the camera is ahead or behind."""
    headings = _body_headings(clip)
    if film.camera not in ("front", "back"):
        return np.repeat(headings[:1], frames)
    smooth = smoothed(np.unwrap(headings)[:, None], round(clip.rate * SMOOTHING))[:, 0]
    return lasting(smooth, frames)


def _body_headings(clip: Clip) -> Float[np.ndarray, " F"]:
    """Return the heading [rad] of the bone in the middle of a skin, else of the first that moves."""
    skeleton = clip.skeleton
    moving = [number for number in range(len(skeleton.bones)) if skeleton.is_moved(number)]
    bone = 0
    if moving:
        bone = moving[0] if skeleton.skin is None else moving[len(moving) // 2]
    joints = skeleton.bones[bone].joints
    if joints and joints[0].kind != "free":
        # An arm has no heading: its swing must not turn the camera.
        return np.zeros(len(clip.times))
    _, orientations = skeleton.world_poses(clip.states)
    return heading_of(orientations[:, bone])


def _emerges(boxes: BoundingBoxes, surface: float) -> bool:
    """Return whether the motion should be seen from above the water: a leap, or along the surface."""
    size = float(np.linalg.norm(boxes.high - boxes.low, axis=1).max())
    leaps = bool((boxes.centres[:, 2] > surface + LEAPING * size).any())
    return leaps or float((boxes.high[:, 2] > surface).mean()) > EMERGED


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
    zeros = np.zeros((1, rows.shape[1]))
    for _ in range(2):
        if len(rows) > frames:
            before = 2 * rows[0] - rows[1 : frames + 1][::-1]
            after = 2 * rows[-1] - rows[-frames - 1 : -1][::-1]
        else:
            before = np.repeat(rows[:1], frames, axis=0)
            after = np.repeat(rows[-1:], frames, axis=0)
        total = np.cumsum(np.concatenate([zeros, before, rows, after]), axis=0)
        rows = (total[2 * frames + 1 :] - total[: -2 * frames - 1]) / (2 * frames + 1)
    return rows
