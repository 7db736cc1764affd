"""Axis-aligned bounding boxes of bodies, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import Clip
from neuroanimator.appearance.mesh_skin import MeshSkin
from neuroanimator.appearance.shapes import Shapes
from neuroanimator.appearance.skeleton import Shape
from neuroanimator.appearance.skin_mesh import skin_mesh
from neuroanimator.state.rotation import rotate, rotation_matrices


class BoundingBoxes(NamedTuple):
    """Boxes along the world's axes, one per row."""

    low: Float[np.ndarray, "F 3"]
    """Corners of the smallest coordinates [m]."""
    high: Float[np.ndarray, "F 3"]
    """Corners of the largest coordinates [m]."""

    @property
    def centres(self) -> Float[np.ndarray, "F 3"]:
        """The middles of the boxes [m]."""
        return (self.low + self.high) / 2

    @property
    def whole(self) -> BoundingBoxes:
        """The one box around all of them."""
        return BoundingBoxes(self.low.min(axis=0)[None], self.high.max(axis=0)[None])

    @property
    def sizes(self) -> Float[np.ndarray, " F"]:
        """The longest sides of the boxes [m]."""
        return (self.high - self.low).max(axis=1)


def bounding_boxes(clips: Sequence[Clip]) -> BoundingBoxes:
    """Return the box around all that moves in each frame; a clip that has ended stays at its last frame."""
    frames = max(len(clip.times) for clip in clips)
    boxes = []
    for clip in clips:
        box = _boxes_of_moving(clip)
        boxes.append(BoundingBoxes(lasting(box.low, frames), lasting(box.high, frames)))
    return _around(boxes)


def _around(boxes: Sequence[BoundingBoxes]) -> BoundingBoxes:
    """Return the boxes around several in each frame."""
    lows = [box.low for box in boxes]
    highs = [box.high for box in boxes]
    return BoundingBoxes(np.min(lows, axis=0), np.max(highs, axis=0))


def lasting(rows: Float[np.ndarray, "N ..."], frames: int) -> Float[np.ndarray, "F ..."]:
    """Return the row of each of `frames`: after the end, the last one."""
    return rows[np.minimum(np.arange(frames), len(rows) - 1)]


def fixed_boxes(clip: Clip) -> BoundingBoxes:
    """Return the box of each shape that nothing moves: walls and posts, and the ground."""
    skeleton = clip.skeleton
    fixed = [i for i in range(len(skeleton.bones)) if not skeleton.is_moved(i)]
    boxes = _boxes_of_shapes(clip, fixed, frames=1)
    lows = [box.low for box in boxes]
    highs = [box.high for box in boxes]
    return BoundingBoxes(np.reshape(lows, (-1, 3)), np.reshape(highs, (-1, 3)))


def _boxes_of_moving(clip: Clip) -> BoundingBoxes:
    """Return the box around moving surfaces, shapes or skins; around the bones alone if they have none."""
    skeleton = clip.skeleton
    moving = [i for i in range(len(skeleton.bones)) if skeleton.is_moved(i)]
    boxes = _boxes_of_shapes(clip, moving, len(clip.times))
    if skeleton.shapes is not None:
        boxes.append(_boxes_of_surface(skeleton.shapes, clip))
    if isinstance(skeleton.skin, MeshSkin):
        boxes += _boxes_of_skin(clip)
    if boxes:
        return _around(boxes)
    positions, _ = skeleton.world_poses(clip.states)
    around = 0.0
    if skeleton.skin is not None:
        # Beyond the bones by as much as the skin is at rest.
        points = skin_mesh(skeleton).points
        rest = np.array([bone.offset for bone in skeleton.bones])
        above = (points.max(axis=0) - rest.max(axis=0)).min()
        below = (rest.min(axis=0) - points.min(axis=0)).min()
        around = float(max(above, below, 0.0))
    return BoundingBoxes(positions.min(axis=1) - around, positions.max(axis=1) + around)


def _boxes_of_surface(surface: Shapes, clip: Clip) -> BoundingBoxes:
    """Return the box around the surface of a soft body."""
    nodes = (surface.decode(state) for state in clip.states)
    corners = np.array([(points.min(axis=0), points.max(axis=0)) for points in nodes])
    return BoundingBoxes(corners[:, 0], corners[:, 1])


def _boxes_of_skin(clip: Clip) -> list[BoundingBoxes]:
    """Return the boxes around the vertices that follow each bone most."""
    mesh = skin_mesh(clip.skeleton)
    main = mesh.main_bones
    positions, orientations = clip.skeleton.world_poses(clip.states)
    boxes = []
    for number in np.unique(main).tolist():
        local = mesh.points_of(number, main == number)
        middle = (local.min(axis=0) + local.max(axis=0)) / 2
        axes = rotation_matrices(orientations[:, number])
        centre = positions[:, number] + axes @ middle
        half = np.abs(axes) @ (np.ptp(local, axis=0) / 2)
        boxes.append(BoundingBoxes(centre - half, centre + half))
    return boxes


def _boxes_of_shapes(clip: Clip, bones: Sequence[int], frames: int) -> list[BoundingBoxes]:
    """Return the boxes of all shapes of these bones in the first `frames`."""
    positions, orientations = clip.skeleton.world_poses(clip.states[:frames])
    boxes = []
    for number in bones:
        for shape in clip.skeleton.bones[number].shapes:
            orientation = orientations[:, number]
            offset = np.broadcast_to(np.array(shape.position), (frames, 3))
            centre = positions[:, number] + rotate(orientation, offset)
            axes = rotation_matrices(orientation) @ rotation_matrices(np.array(shape.orientation))
            half = np.abs(axes) @ _half_sizes(shape)
            boxes.append(BoundingBoxes(centre - half, centre + half))
    return boxes


def _half_sizes(shape: Shape) -> Float[np.ndarray, " 3"]:
    """Return half the shape's extent along its own axes [m]."""
    radius = shape.size[0]
    if shape.kind == "sphere":
        return np.full(3, radius)
    if shape.kind == "capsule":
        return np.array([radius, radius, radius + shape.size[1]])
    if shape.kind == "cylinder":
        return np.array([radius, radius, shape.size[1]])
    return np.array(shape.size)
