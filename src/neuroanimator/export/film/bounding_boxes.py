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
    lows = []
    highs = []
    for clip in clips:
        boxes = _boxes_of_moving(clip)
        lows.append(lasting(boxes.low, frames))
        highs.append(lasting(boxes.high, frames))
    return BoundingBoxes(np.min(lows, axis=0), np.max(highs, axis=0))


def lasting(rows: Float[np.ndarray, "N ..."], frames: int) -> Float[np.ndarray, "F ..."]:
    """Return the row of each of `frames`: after the end, the last one."""
    return rows[np.minimum(np.arange(frames), len(rows) - 1)]


def fixed_boxes(clip: Clip) -> BoundingBoxes:
    """Return the box of each shape that nothing moves: walls and posts, and the ground."""
    skeleton = clip.skeleton
    fixed = [i for i in range(len(skeleton.bones)) if not skeleton.is_moved(i)]
    lows, highs = _boxes_of_shapes(clip, fixed, frames=1)
    return BoundingBoxes(lows[:, 0], highs[:, 0])


def _boxes_of_moving(clip: Clip) -> BoundingBoxes:
    """Return the box around moving surfaces, shapes or skins; around the bones alone if they have none."""
    skeleton = clip.skeleton
    moving = [i for i in range(len(skeleton.bones)) if skeleton.is_moved(i)]
    lows, highs = _boxes_of_shapes(clip, moving, len(clip.times))
    if skeleton.shapes is not None:
        surface = _boxes_of_surface(skeleton.shapes, clip)
        lows = np.concatenate([lows, surface.low[None]])
        highs = np.concatenate([highs, surface.high[None]])
    if isinstance(skeleton.skin, MeshSkin):
        skin_lows, skin_highs = _boxes_of_skin(clip)
        lows = np.concatenate([lows, skin_lows])
        highs = np.concatenate([highs, skin_highs])
    if len(lows):
        return BoundingBoxes(lows.min(axis=0), highs.max(axis=0))
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


def _boxes_of_skin(
    clip: Clip,
) -> tuple[Float[np.ndarray, "N F 3"], Float[np.ndarray, "N F 3"]]:
    """Return the corners [m] of a box per bone, around the vertices that follow it most."""
    mesh = skin_mesh(clip.skeleton)
    main = mesh.main_bones
    positions, orientations = clip.skeleton.world_poses(clip.states)
    lows = []
    highs = []
    for number in np.unique(main).tolist():
        local = mesh.points_of(number, main == number)
        middle = (local.min(axis=0) + local.max(axis=0)) / 2
        axes = rotation_matrices(orientations[:, number])
        centre = positions[:, number] + axes @ middle
        half = np.abs(axes) @ (np.ptp(local, axis=0) / 2)
        lows.append(centre - half)
        highs.append(centre + half)
    return np.array(lows), np.array(highs)


def _boxes_of_shapes(
    clip: Clip, bones: Sequence[int], frames: int
) -> tuple[Float[np.ndarray, "N F 3"], Float[np.ndarray, "N F 3"]]:
    """Return the corners [m] of the boxes of all shapes of these bones in the first `frames`."""
    positions, orientations = clip.skeleton.world_poses(clip.states[:frames])
    lows = []
    highs = []
    for number in bones:
        for shape in clip.skeleton.bones[number].shapes:
            orientation = orientations[:, number]
            offset = np.broadcast_to(np.array(shape.position), (frames, 3))
            centre = positions[:, number] + rotate(orientation, offset)
            axes = rotation_matrices(orientation) @ rotation_matrices(np.array(shape.orientation))
            half = np.abs(axes) @ _half_sizes(shape)
            lows.append(centre - half)
            highs.append(centre + half)
    return np.reshape(lows, (-1, frames, 3)), np.reshape(highs, (-1, frames, 3))


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
