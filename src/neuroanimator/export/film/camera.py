"""Where the camera is in every image: beside what moves, on one side of the water, as near as fits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.appearance.skeleton import Shape
from neuroanimator.appearance.skin_mesh import skin_mesh
from neuroanimator.export.film.options import Film
from neuroanimator.state.rotation import heading_of, rotate, rotation_matrices

FIELD = 40.0
"""[deg] Angle of view from top to bottom: that of a 50 mm lens."""
SHARE, SHARE_OF_HEIGHT = 0.36, 0.5
"""Of the picture's width and height that a single body fills."""
SHARE_OF_MANY, SHARE_OF_MOTION = 0.6, 0.75
"""The same of several bodies, and of a whole motion before a camera that stands still."""
STAYS = 1.8
"""A motion that takes no more than this many times the body's own room is filmed by a camera that stands still."""
FORESHORTENED = 0.5
"""A long body seen end on is framed as if it were so wide, over its length."""
FOLLOWING = 0.8
"""[s] Over which the camera's way is smoothed."""
LAG = 0.3
"""Farthest the camera may look beside the body, over its size."""
CLEARANCE = 0.12
"""Least height of the camera over the water, or depth under it, over the body's size."""
EMERGED = 0.5
"""Share of the images in which something must be out of the water for a camera above it, if nothing leaps."""
LEAPING = 0.1
"""A body leaps if its middle comes so high over the water, over its size."""
NEAREST = 1e-3
"""[m] A body is never taken as smaller."""


class View(NamedTuple):
    """From where a camera looks."""

    azimuth: float
    """[deg] Of the direction it looks in, from the body's: 90 is from its right side."""
    elevation: float
    """[deg] It looks down where negative."""


VIEWS = {
    "follow": View(68.0, -14.0),
    "side": View(90.0, 0.0),
    "front": View(180.0, -8.0),
    "back": View(0.0, -12.0),
    "top": View(90.0, -89.0),
    "still": View(68.0, -14.0),
}
"""What the cameras of `CAMERAS` do."""


class Boxes(NamedTuple):
    """The room bodies take, image by image."""

    low: np.ndarray
    """(F, 3) [m]"""
    high: np.ndarray
    """(F, 3) [m]"""

    @property
    def centres(self) -> np.ndarray:
        """(F, 3) [m]"""
        return (self.low + self.high) / 2

    @property
    def whole(self) -> Boxes:
        """The room the whole motion takes, as one image."""
        return Boxes(self.low.min(axis=0)[None], self.high.max(axis=0)[None])


class Shots(NamedTuple):
    """The camera in every image."""

    lookat: np.ndarray
    """(F, 3) [m] What is in the middle of the picture."""
    position: np.ndarray
    """(F, 3) [m] Where the camera is."""
    size: float
    """[m] Of what is filmed."""
    is_under_water: bool

    @property
    def distance(self) -> float:
        """[m] Of the camera, the largest."""
        return float(np.linalg.norm(self.lookat - self.position, axis=1).max())

    def angles(self, frame: int) -> tuple[float, float, float]:
        """Return azimuth [deg], elevation [deg] and distance [m] in `frame`."""
        ahead = self.lookat[frame] - self.position[frame]
        distance = float(np.linalg.norm(ahead))
        azimuth = float(np.degrees(np.arctan2(ahead[1], ahead[0])))
        return azimuth, float(np.degrees(np.arcsin(ahead[2] / distance))), distance


def shots_of(clips: Sequence[Clip], film: Film, surface: float | None = None) -> Shots:
    """Return the camera that `film` asks for, in front of what moves in `clips`.

    Where there is a water's `surface` [m], the camera stays on one side of it all along.
    """
    boxes = room_of(clips)
    view = VIEWS[film.camera]
    frames, rate = len(boxes.low), clips[0].rate
    is_under_water = surface is not None and film.camera != "top" and not _emerges(boxes, surface)
    heading = np.repeat(_heading(clips[0])[:1], frames)
    if film.camera in ("front", "back"):
        heading = smoothed(np.unwrap(_heading(clips[0]))[:, None], round(rate * FOLLOWING))[:, 0]
    azimuth = heading + np.radians(view.azimuth)
    width, height = _seen(boxes, azimuth)
    is_still = film.camera == "still" or (
        film.camera == "follow" and _stays(clips, boxes, azimuth[:1])
    )
    share = SHARE if len(clips) == 1 else SHARE_OF_MANY
    share_of_height = SHARE_OF_HEIGHT
    lookat = camera_way(
        boxes.centres, round(rate * FOLLOWING), LAG * float(np.median(np.maximum(width, height)))
    )
    if is_still:
        boxes = boxes.whole
        azimuth_of_all = azimuth[:1]
        share = share_of_height = SHARE_OF_MOTION
        lookat = np.repeat(boxes.centres, frames, axis=0)
    else:
        azimuth_of_all = azimuth
    width, height = _seen(boxes, azimuth_of_all)
    depth, _ = _seen(boxes, azimuth_of_all + np.pi / 2)
    size = max(float(np.median(np.maximum(width, depth))), float(np.median(height)), NEAREST)
    wide = max(float(np.median(width)), FORESHORTENED * size)
    nearer = float(np.median(height if film.camera == "top" else depth)) / 2
    distance = nearer + _distance(film, wide / share, float(np.median(height)) / share_of_height)
    shallower = 0.5 if is_under_water else 1.0  # the nearer the surface, the flatter
    elevation = np.radians(view.elevation * shallower)
    ahead = np.stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation)], axis=1
    )
    ahead = np.concatenate([ahead, np.full((frames, 1), np.sin(elevation))], axis=1)
    position = lookat - distance * ahead
    if surface is not None:
        position[:, 2] = _on_one_side(position[:, 2], surface, CLEARANCE * size, is_under_water)
    return Shots(lookat, position, size, is_under_water)


def room_of(clips: Sequence[Clip]) -> Boxes:
    """Return the room that all that moves takes in every image; a clip that ends stays at its last."""
    frames = max(len(clip.times) for clip in clips)
    lows, highs = [], []
    for clip in clips:
        box = _room(clip)
        lows.append(_held(box.low, frames))
        highs.append(_held(box.high, frames))
    return Boxes(np.min(lows, axis=0), np.max(highs, axis=0))


def _held(rows: np.ndarray, frames: int) -> np.ndarray:
    return np.concatenate([rows, np.repeat(rows[-1:], frames - len(rows), axis=0)])


def _room(clip: Clip) -> Boxes:
    skeleton = clip.skeleton
    positions, orientations = skeleton.world_poses(clip.states)
    if skeleton.skin is not None:
        return _room_of_skin(clip, positions)
    lows, highs = [], []
    for i, bone in enumerate(skeleton.bones):
        if not skeleton.is_moved(i):
            continue
        for shape in bone.shapes:
            centre = positions[:, i] + rotate(
                orientations[:, i], np.broadcast_to(np.array(shape.position), positions[:, i].shape)
            )
            axes = rotation_matrices(orientations[:, i]) @ rotation_matrices(
                np.array(shape.orientation)
            )
            reach = np.abs(axes) @ half_sizes(shape)
            lows.append(centre - reach)
            highs.append(centre + reach)
    if not lows:
        return Boxes(positions.min(axis=1), positions.max(axis=1))
    return Boxes(np.min(lows, axis=0), np.max(highs, axis=0))


def _room_of_skin(clip: Clip, positions: np.ndarray) -> Boxes:
    """Return the room of a skin: the bones', and as much more as the skin has around them at rest."""
    points = skin_mesh(clip.skeleton).points
    rest = np.array([bone.offset for bone in clip.skeleton.bones])
    around = float(
        max(
            (points.max(axis=0) - rest.max(axis=0)).min(),
            (rest.min(axis=0) - points.min(axis=0)).min(),
            0.0,
        )
    )
    return Boxes(positions.min(axis=1) - around, positions.max(axis=1) + around)


def half_sizes(shape: Shape) -> np.ndarray:
    """Return (3,) [m] how far a shape reaches along its own axes."""
    first = shape.size[0]
    if shape.kind == "sphere":
        return np.full(3, first)
    if shape.kind == "capsule":
        return np.array([first, first, first + shape.size[1]])
    if shape.kind == "cylinder":
        return np.array([first, first, shape.size[1]])
    return np.array(shape.size)


def _heading(clip: Clip) -> np.ndarray:
    """Return (F,) [rad] where the body points: the bone in the middle of those that move."""
    moving = [i for i in range(len(clip.skeleton.bones)) if clip.skeleton.is_moved(i)]
    bone = (
        moving[len(moving) // 2]
        if clip.skeleton.skin is not None and moving
        else (moving or [0])[0]
    )
    root = clip.skeleton.bones[bone]
    if root.joints and root.joints[0].kind != "free":
        return np.zeros(
            len(clip.times)
        )  # an arm points nowhere: its own swing must not turn the camera
    return heading_of(clip.skeleton.world_poses(clip.states)[1][:, bone])


def _seen(boxes: Boxes, azimuth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (F,) [m] how wide and how high `boxes` are to a camera that looks along `azimuth` [rad]."""
    extent = boxes.high - boxes.low
    width = np.abs(np.sin(azimuth)) * extent[:, 0] + np.abs(np.cos(azimuth)) * extent[:, 1]
    return width, extent[:, 2]


def _stays(clips: Sequence[Clip], boxes: Boxes, azimuth: np.ndarray) -> bool:
    """Return whether the motion stays where it is: of bodies fixed to the world, or in little more than their room."""
    if all(_is_anchored(clip) for clip in clips):
        return True
    one, whole = _seen(boxes, np.repeat(azimuth, len(boxes.low))), _seen(boxes.whole, azimuth)
    own = max(float(np.median(one[0])), float(np.median(one[1])))
    return max(float(whole[0].max()), float(whole[1].max())) <= STAYS * own


def _is_anchored(clip: Clip) -> bool:
    """Return whether what moves hangs from a place that does not: an arm on its base."""
    bones = clip.skeleton.bones
    positions, _ = clip.skeleton.world_poses(clip.states)
    first = [
        i
        for i, bone in enumerate(bones)
        if bone.is_moving and not clip.skeleton.is_moved(bone.parent)
    ]
    return bool(first) and float(np.ptp(positions[:, first], axis=0).max()) < NEAREST


def _distance(film: Film, width: float, height: float) -> float:
    """Return the distance [m] at which the picture is at least so `width` and `height` [m]."""
    half = np.tan(np.radians(FIELD) / 2)
    aspect = film.size[0] / film.size[1]
    return max(width / (2 * half * aspect), height / (2 * half))


def _emerges(boxes: Boxes, surface: float) -> bool:
    """Return whether the motion is one to be seen from above the water: a leap, or along the surface."""
    size = float(np.linalg.norm(boxes.high - boxes.low, axis=1).max())
    leaps = bool((boxes.centres[:, 2] > surface + LEAPING * size).any())
    return leaps or float((boxes.high[:, 2] > surface).mean()) > EMERGED


def _on_one_side(
    heights: np.ndarray, surface: float, clearance: float, is_under_water: bool
) -> np.ndarray:
    """Return camera heights [m] bent smoothly away from the surface: never nearer than `clearance`."""
    side = -1.0 if is_under_water else 1.0
    free = side * (heights - surface) - clearance
    bent = clearance * np.logaddexp(0.0, free / clearance)
    return surface + side * (clearance + bent)


def camera_way(ways: np.ndarray, frames: int, lag: float) -> np.ndarray:
    """Return ways (F, 3) [m] smoothed over up to `frames`, less if the camera would lag by more than `lag` [m]."""
    while frames > 0:
        found = smoothed(ways, frames)
        if np.linalg.norm(found - ways, axis=1).max() <= lag:
            return found
        frames //= 2
    return ways


def smoothed(ways: np.ndarray, frames: int) -> np.ndarray:
    """Return ways (F, K) averaged twice over `frames`, ends held by straight continuation."""
    zeros = np.zeros((1, ways.shape[1]))
    for _ in range(2):
        before = (
            2 * ways[0] - ways[1 : frames + 1][::-1]
            if len(ways) > frames
            else np.repeat(ways[:1], frames, axis=0)
        )
        after = (
            2 * ways[-1] - ways[-frames - 1 : -1][::-1]
            if len(ways) > frames
            else np.repeat(ways[-1:], frames, 0)
        )
        total = np.cumsum(np.concatenate([zeros, before, ways, after]), axis=0)
        ways = (total[2 * frames + 1 :] - total[: -2 * frames - 1]) / (2 * frames + 1)
    return ways
