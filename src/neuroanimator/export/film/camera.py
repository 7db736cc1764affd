"""Where the camera is in every image: beside what moves, on one side of the water, as near as fits."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.animation.clip import Clip
from neuroanimator.export.film.bounding_boxes import BoundingBoxes, bounding_boxes, fixed_boxes
from neuroanimator.export.film.options import Film
from neuroanimator.export.film.takes import Take
from neuroanimator.state.rotation import heading_of

FIELD_OF_VIEW = 40.0
"""Angle of view from top to bottom [deg]: that of a 50 mm lens."""

WIDTH_SHARE = 0.5
"""Share of the picture's width that a single body fills."""

WIDTH_SHARE_OF_MANY = 0.72
"""Share of the picture's width that several bodies fill."""

HEIGHT_SHARE = 0.5
"""Share of the picture's height that bodies fill at most."""

SHARE_OF_MOTION = 0.75
"""Share of the picture's width and height that a whole motion fills before a camera that stands still."""

STAYING = 1.8
"""A motion that takes no more than this many times the body's own room is filmed by a camera that stands still."""

FORESHORTENED = 0.5
"""A long body seen end on is framed as if it were so wide, over its length."""

SMOOTHING = 0.8
"""Time over which the camera's path is smoothed [s]."""

MAX_LAG = 0.3
"""How far the camera may look beside the body, over its size."""

MIN_CLEARANCE = 0.12
"""Least height of the camera over the water, or depth under it, over the body's size."""

FLATTER_UNDER_WATER = 0.5
"""Share of its elevation that a camera under water keeps: the nearer the surface, the flatter it must look."""

EMERGED = 0.5
"""Share of the images in which something must be out of the water for a camera above it, if nothing leaps."""

LEAPING = 0.1
"""A body leaps if its middle comes so high over the water, over its size."""

MAX_GHOST_ROOM = 2.2
"""Maximum factor by which the camera moves away to keep a ghost that goes astray in the picture."""

MAX_HIDDEN = 0.01
"""Share of what is filmed that fixed things may hide before the camera tries another side."""

LOOKED_AT = 0.7
"""Share of a body's half sizes at which the eight points lie that are to be seen."""

MIN_SIZE = 1e-3
"""A body is never taken as smaller than this [m]."""


class View(NamedTuple):
    """From where a camera looks."""

    azimuth: float
    """The direction it looks in, from the body's [deg]: 90 is from its right side."""
    elevation: float
    """How far it looks up [deg]; down where negative."""


VIEWS = {
    "follow": View(68.0, -14.0),
    "side": View(90.0, 0.0),
    "front": View(180.0, -8.0),
    "back": View(0.0, -12.0),
    "top": View(90.0, -89.0),
    "still": View(68.0, -14.0),
}
"""What the cameras of `options.CAMERAS` do."""

SWAYING_VIEW = View(42.0, -20.0)
"""What "follow" does beside a body that sways from side to side: behind and above it, where its tail is seen to beat."""

SWAY = 0.05
"""A body sways if its parts move from side to side by more than this root mean square, over its length, and up and down less."""


class Shots(NamedTuple):
    """The camera in every image."""

    lookat: Float[np.ndarray, "F 3"]
    """What is in the middle of the picture [m]."""
    position: Float[np.ndarray, "F 3"]
    """Where the camera is [m]."""
    size: float
    """The size of what is filmed [m]."""
    is_under_water: bool

    @property
    def distance(self) -> float:
        """The largest distance of the camera [m]."""
        return float(np.linalg.norm(self.lookat - self.position, axis=1).max())

    def angles(self, frame: int) -> tuple[float, float, float]:
        """Return azimuth [deg], elevation [deg] and distance [m] in `frame`."""
        ahead = self.lookat[frame] - self.position[frame]
        distance = float(np.linalg.norm(ahead))
        azimuth = float(np.degrees(np.arctan2(ahead[1], ahead[0])))
        return azimuth, float(np.degrees(np.arcsin(ahead[2] / distance))), distance


class _Framing(NamedTuple):
    """What a camera has to bring into the picture."""

    boxes: BoundingBoxes
    azimuth: Float[np.ndarray, " F"]
    """The direction it looks in at each box [rad]."""
    width_share: float
    """Share of the picture's width to fill."""
    height_share: float
    """Share of the picture's height to fill."""


def shots_of(clips: Sequence[Clip], film: Film, surface: float | None = None) -> Shots:
    """Return the camera that `film` asks for, in front of what moves in `clips`.

    Where there is a water's `surface` [m], the camera stays on one side of it all along. The camera "follow" is on the
    side from which fixed things hide least of the motion.
    """
    boxes = bounding_boxes(clips)
    view = VIEWS[film.camera]
    if film.camera != "follow":
        return _shots_from(view, clips, boxes, film, surface)
    if all(_sways(clip) for clip in clips):
        view = SWAYING_VIEW
    obstacles = fixed_boxes(clips[0])
    found = []
    for azimuth in (view.azimuth, -view.azimuth, 180 - view.azimuth, view.azimuth - 180):
        side = view._replace(azimuth=azimuth)
        shots = _shots_from(side, clips, boxes, film, surface)
        hidden = hidden_share(shots.position, boxes, obstacles)
        if hidden <= MAX_HIDDEN:
            return shots
        found.append((hidden, shots))
    return min(found, key=lambda one: one[0])[1]


def hidden_share(
    positions: Float[np.ndarray, "F 3"], boxes: BoundingBoxes, obstacles: BoundingBoxes
) -> float:
    """Return the share of what is filmed, all images together, that the `obstacles` hide from the camera."""
    hidden = []
    for corner in itertools.product((-LOOKED_AT, LOOKED_AT), repeat=3):
        points = boxes.centres + np.array(corner) * (boxes.high - boxes.low) / 2
        hidden.append(_is_hidden(positions, points, obstacles))
    return float(np.mean(hidden))


def _is_hidden(
    positions: Float[np.ndarray, "F 3"],
    points: Float[np.ndarray, "F 3"],
    obstacles: BoundingBoxes,
) -> Bool[np.ndarray, " F"]:
    """Return whether one of the `obstacles` stands between the camera and a point, in every image."""
    ways = (points - positions)[:, None]
    safe = np.where(np.abs(ways) < MIN_SIZE, MIN_SIZE, ways)
    # Where the line of sight enters and leaves each pair of planes, as shares of its length (Kay and Kajiya, 1986).
    first = (obstacles.low - positions[:, None]) / safe
    second = (obstacles.high - positions[:, None]) / safe
    entry = np.minimum(first, second).max(axis=2)
    leaving = np.maximum(first, second).min(axis=2)
    return ((entry <= leaving) & (leaving > 0) & (entry < 1)).any(axis=1)


def _shots_from(
    view: View,
    clips: Sequence[Clip],
    boxes: BoundingBoxes,
    film: Film,
    surface: float | None,
) -> Shots:
    """Return the camera that looks from `view` at what moves in `boxes`."""
    frames = len(boxes.low)
    is_under_water = surface is not None and film.camera != "top" and not _emerges(boxes, surface)
    azimuth = _headings(clips[0], film, frames) + np.radians(view.azimuth)
    if film.camera == "still" or (film.camera == "follow" and _stays(clips, boxes, azimuth[:1])):
        framing = _Framing(boxes.whole, azimuth[:1], SHARE_OF_MOTION, SHARE_OF_MOTION)
        lookat = np.repeat(boxes.whole.centres, frames, axis=0)
    else:
        share = WIDTH_SHARE if len(clips) == 1 else WIDTH_SHARE_OF_MANY
        framing = _Framing(boxes, azimuth, share, HEIGHT_SHARE)
        lag = MAX_LAG * float(np.median(np.maximum(*boxes.width_and_height(azimuth))))
        lookat = camera_path(boxes.centres, round(clips[0].rate * SMOOTHING), lag)
    size, distance = _size_and_distance(framing, film)
    elevation = np.radians(view.elevation * (FLATTER_UNDER_WATER if is_under_water else 1.0))
    position = lookat - distance * _directions(azimuth, elevation)
    if surface is not None:
        clearance = MIN_CLEARANCE * size
        position[:, 2] = _on_one_side(position[:, 2], surface, clearance, is_under_water)
    return Shots(lookat, position, size, is_under_water)


def take_shots(take: Take, film: Film, surface: float | None = None) -> Shots:
    """Return the camera in every image of a take, with room for its ghost; at the end of its clips it stays."""
    shots = shots_of(take.clips, film, surface)
    lookat = shots.lookat
    position = shots.position
    if take.ghost is not None:
        astray = _distance_apart(take.clips[0], take.ghost)
        room = min(1 + astray / shots.size, MAX_GHOST_ROOM)
        position = lookat + room * (position - lookat)
    index = np.minimum(np.arange(take.frames), len(lookat) - 1)
    return shots._replace(lookat=lookat[index], position=position[index])


def _distance_apart(clip: Clip, ghost: Clip) -> float:
    """Return how far apart the middles of two motions of a body come [m]."""
    centres = bounding_boxes([clip]).centres
    others = bounding_boxes([ghost]).centres
    frames = min(len(centres), len(others))
    return float(np.linalg.norm(centres[:frames] - others[:frames], axis=1).max())


def _size_and_distance(framing: _Framing, film: Film) -> tuple[float, float]:
    """Return the size of what is filmed and the distance of the camera from its middle [m]."""
    width, height = framing.boxes.width_and_height(framing.azimuth)
    depth, _ = framing.boxes.width_and_height(framing.azimuth + np.pi / 2)
    usual_height = float(np.median(height))
    size = max(float(np.median(np.maximum(width, depth))), usual_height, MIN_SIZE)
    usual_width = max(float(np.median(width)), FORESHORTENED * size)
    toward_camera = height if film.camera == "top" else depth
    half_angle = np.tan(np.radians(FIELD_OF_VIEW) / 2)
    aspect = film.size[0] / film.size[1]
    distance = max(
        usual_width / framing.width_share / (2 * half_angle * aspect),
        usual_height / framing.height_share / (2 * half_angle),
    )
    return size, float(np.median(toward_camera)) / 2 + distance


def _directions(azimuth: Float[np.ndarray, " F"], elevation: float) -> Float[np.ndarray, "F 3"]:
    """Return the unit vectors in which cameras look at these angles [rad]."""
    x = np.cos(azimuth) * np.cos(elevation)
    y = np.sin(azimuth) * np.cos(elevation)
    z = np.full(len(azimuth), np.sin(elevation))
    return np.stack([x, y, z], axis=1)


def _headings(clip: Clip, film: Film, frames: int) -> Float[np.ndarray, " F"]:
    """Return where the body points for the camera [rad]: as at first, unless the camera goes ahead of it or behind."""
    headings = _body_headings(clip)
    if film.camera not in ("front", "back"):
        return np.repeat(headings[:1], frames)
    return smoothed(np.unwrap(headings)[:, None], round(clip.rate * SMOOTHING))[:, 0]


def _body_headings(clip: Clip) -> Float[np.ndarray, " F"]:
    """Return where the body points [rad]: the bone in the middle of a skin, else the first of those that move."""
    skeleton = clip.skeleton
    moving = [number for number in range(len(skeleton.bones)) if skeleton.is_moved(number)]
    bone = 0
    if moving:
        bone = moving[0] if skeleton.skin is None else moving[len(moving) // 2]
    joints = skeleton.bones[bone].joints
    if joints and joints[0].kind != "free":
        # An arm points nowhere: its own swing must not turn the camera.
        return np.zeros(len(clip.times))
    _, orientations = skeleton.world_poses(clip.states)
    return heading_of(orientations[:, bone])


def _sways(clip: Clip) -> bool:
    """Return whether a body with a skin beats from side to side, as a fish does, and not up and down, as a dolphin."""
    if clip.skeleton.skin is None:
        return False
    positions, _ = clip.skeleton.world_poses(clip.states)
    offsets = positions - positions.mean(axis=1, keepdims=True)
    headings = _body_headings(clip)[:, None]
    sideways = np.cos(headings) * offsets[..., 1] - np.sin(headings) * offsets[..., 0]
    to_the_side = float(sideways.std(axis=0).max())
    up_and_down = float(offsets[..., 2].std(axis=0).max())
    length = float(np.linalg.norm(offsets, axis=2).max())
    return to_the_side > max(SWAY * length, up_and_down)


def _stays(clips: Sequence[Clip], boxes: BoundingBoxes, azimuth: Float[np.ndarray, " 1"]) -> bool:
    """Return whether the motion stays where it is: of bodies fixed to the world, or of one in little more than its room."""
    if all(_is_anchored(clip) for clip in clips):
        return True
    if len(clips) > 1:
        return False
    width, height = boxes.width_and_height(np.repeat(azimuth, len(boxes.low)))
    whole_width, whole_height = boxes.whole.width_and_height(azimuth)
    own_size = max(float(np.median(width)), float(np.median(height)))
    return max(float(whole_width.max()), float(whole_height.max())) <= STAYING * own_size


def _is_anchored(clip: Clip) -> bool:
    """Return whether what moves hangs from a place that does not: an arm on its base."""
    skeleton = clip.skeleton
    positions, _ = skeleton.world_poses(clip.states)
    first = [
        number
        for number, bone in enumerate(skeleton.bones)
        if bone.is_moving and not skeleton.is_moved(bone.parent)
    ]
    return bool(first) and float(np.ptp(positions[:, first], axis=0).max()) < MIN_SIZE


def _emerges(boxes: BoundingBoxes, surface: float) -> bool:
    """Return whether the motion is one to be seen from above the water: a leap, or along the surface."""
    size = float(np.linalg.norm(boxes.high - boxes.low, axis=1).max())
    leaps = bool((boxes.centres[:, 2] > surface + LEAPING * size).any())
    return leaps or float((boxes.high[:, 2] > surface).mean()) > EMERGED


def _on_one_side(
    heights: Float[np.ndarray, " F"], surface: float, clearance: float, is_under_water: bool
) -> Float[np.ndarray, " F"]:
    """Return camera heights [m] bent smoothly away from the surface: never nearer than `clearance` [m]."""
    side = -1.0 if is_under_water else 1.0
    free = side * (heights - surface) - clearance
    bent = clearance * np.logaddexp(0.0, free / clearance)
    return surface + side * (clearance + bent)


def camera_path(
    path: Float[np.ndarray, "F 3"], frames: int, max_lag: float
) -> Float[np.ndarray, "F 3"]:
    """Return `path` [m] smoothed over up to `frames`, less if the camera would lag by more than `max_lag` [m]."""
    while frames > 0:
        smooth = smoothed(path, frames)
        if np.linalg.norm(smooth - path, axis=1).max() <= max_lag:
            return smooth
        frames //= 2
    return path


def smoothed(rows: Float[np.ndarray, "F K"], frames: int) -> Float[np.ndarray, "F K"]:
    """Return `rows` averaged twice over `frames` to either side, ends held by straight continuation."""
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
