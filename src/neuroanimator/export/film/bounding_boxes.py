"""The room that moving bodies take, image by image, as boxes along the world's axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import Clip
from neuroanimator.appearance.skeleton import Shape
from neuroanimator.appearance.skin_mesh import skin_mesh
from neuroanimator.state.rotation import rotate, rotation_matrices


class BoundingBoxes(NamedTuple):
    """The room bodies take, image by image."""

    low: Float[np.ndarray, "F 3"]
    """The corners of the smallest coordinates [m]."""
    high: Float[np.ndarray, "F 3"]
    """The corners of the largest coordinates [m]."""

    @property
    def centres(self) -> Float[np.ndarray, "F 3"]:
        """The middles of the boxes [m]."""
        return (self.low + self.high) / 2

    @property
    def whole(self) -> BoundingBoxes:
        """The room the whole motion takes, as one image."""
        return BoundingBoxes(self.low.min(axis=0)[None], self.high.max(axis=0)[None])

    def width_and_height(
        self, azimuth: Float[np.ndarray, " G"]
    ) -> tuple[Float[np.ndarray, " F"], Float[np.ndarray, " F"]]:
        """Return how wide and how high [m] the boxes are to a camera that looks along `azimuth`, one or (F,) [rad]."""
        extent = self.high - self.low
        width = np.abs(np.sin(azimuth)) * extent[:, 0] + np.abs(np.cos(azimuth)) * extent[:, 1]
        return width, extent[:, 2]


def bounding_boxes(clips: Sequence[Clip]) -> BoundingBoxes:
    """Return the room that all that moves takes in every image; a clip that ends stays at its last."""
    frames = max(len(clip.times) for clip in clips)
    lows = []
    highs = []
    for clip in clips:
        boxes = _boxes_of_skeleton(clip) if clip.skeleton.skin is None else _boxes_of_skin(clip)
        lows.append(_held(boxes.low, frames))
        highs.append(_held(boxes.high, frames))
    return BoundingBoxes(np.min(lows, axis=0), np.max(highs, axis=0))


def fixed_boxes(clip: Clip) -> BoundingBoxes:
    """Return the room of each shape that nothing moves, a row each: walls and posts, and the ground."""
    skeleton = clip.skeleton
    positions, orientations = skeleton.world_poses(clip.states[:1])
    lows = [np.zeros((0, 3))]
    highs = [np.zeros((0, 3))]
    for number, bone in enumerate(skeleton.bones):
        if skeleton.is_moved(number):
            continue
        for shape in bone.shapes:
            centre, half = _room_of_shape(shape, positions[:, number], orientations[:, number])
            lows.append(centre - half)
            highs.append(centre + half)
    return BoundingBoxes(np.concatenate(lows), np.concatenate(highs))


def _room_of_shape(
    shape: Shape, position: Float[np.ndarray, "F 3"], orientation: Float[np.ndarray, "F 4"]
) -> tuple[Float[np.ndarray, "F 3"], Float[np.ndarray, "F 3"]]:
    """Return the middle of a shape and half its extent along the world's axes, where its bone is so posed."""
    offset = np.broadcast_to(np.array(shape.position), position.shape)
    centre = position + rotate(orientation, offset)
    shape_axes = rotation_matrices(np.array(shape.orientation))
    half = np.abs(rotation_matrices(orientation) @ shape_axes) @ half_sizes(shape)
    return centre, half


def _held(rows: Float[np.ndarray, "F 3"], frames: int) -> Float[np.ndarray, "{frames} 3"]:
    """Return `rows` with the last one repeated."""
    return np.concatenate([rows, np.repeat(rows[-1:], frames - len(rows), axis=0)])


def _boxes_of_skeleton(clip: Clip) -> BoundingBoxes:
    """Return the room of the shapes of all bones that are moved; of the bones alone, if those have none."""
    skeleton = clip.skeleton
    positions, orientations = skeleton.world_poses(clip.states)
    lows = []
    highs = []
    for number, bone in enumerate(skeleton.bones):
        if not skeleton.is_moved(number):
            continue
        position = positions[:, number]
        orientation = orientations[:, number]
        for shape in bone.shapes:
            centre, half = _room_of_shape(shape, position, orientation)
            lows.append(centre - half)
            highs.append(centre + half)
    if not lows:
        return BoundingBoxes(positions.min(axis=1), positions.max(axis=1))
    return BoundingBoxes(np.min(lows, axis=0), np.max(highs, axis=0))


def _boxes_of_skin(clip: Clip) -> BoundingBoxes:
    """Return the room of a skin: the bones', and as much more as the skin has around them at rest."""
    positions, _ = clip.skeleton.world_poses(clip.states)
    points = skin_mesh(clip.skeleton).points
    rest = np.array([bone.offset for bone in clip.skeleton.bones])
    above = (points.max(axis=0) - rest.max(axis=0)).min()
    below = (rest.min(axis=0) - points.min(axis=0)).min()
    around = float(max(above, below, 0.0))
    return BoundingBoxes(positions.min(axis=1) - around, positions.max(axis=1) + around)


def half_sizes(shape: Shape) -> Float[np.ndarray, " 3"]:
    """Return how far a shape reaches along its own axes [m]."""
    radius = shape.size[0]
    if shape.kind == "sphere":
        return np.full(3, radius)
    if shape.kind == "capsule":
        return np.array([radius, radius, radius + shape.size[1]])
    if shape.kind == "cylinder":
        return np.array([radius, radius, shape.size[1]])
    return np.array(shape.size)
