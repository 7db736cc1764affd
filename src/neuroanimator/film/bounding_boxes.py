"""Axis-aligned bounding boxes of bodies, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import Clip
from neuroanimator.appearance.mesh_skin import MeshSkin
from neuroanimator.appearance.skeleton import Shape, Skeleton
from neuroanimator.appearance.skin_mesh import skin_mesh
from neuroanimator.film.options import Positions, Vector, held
from neuroanimator.state.rotation import rotation_matrices


class BoundingBoxes(NamedTuple):
    """Boxes along the world's axes, one per row."""

    low: Positions
    """Corners of the smallest coordinates [m]."""
    high: Positions
    """Corners of the largest coordinates [m]."""

    @property
    def centres(self) -> Positions:
        """The middles of the boxes [m]."""
        return (self.low + self.high) / 2

    @property
    def extents(self) -> Positions:
        """The sides of the boxes [m]."""
        return self.high - self.low

    @property
    def whole(self) -> BoundingBoxes:
        """The one box around all of them."""
        return BoundingBoxes(self.low.min(axis=0)[None], self.high.max(axis=0)[None])


class _Piece(NamedTuple):
    """A box fixed to a bone."""

    bone: int
    middle: Vector
    """Its middle in the bone's frame [m]."""
    axes: Float[np.ndarray, "3 3"]
    """Its own axes in the bone's frame, as columns."""
    half: Vector
    """Half its sides [m]."""


def bounding_boxes(clips: Sequence[Clip]) -> BoundingBoxes:
    """Return the box around all that moves in each frame; a clip that has ended stays at its last frame."""
    frames = max(len(clip.times) for clip in clips)
    corners = [held(_corners_of_moving(clip), frames) for clip in clips]
    return BoundingBoxes(np.min(corners, axis=0)[:, 0], np.max(corners, axis=0)[:, 1])


def fixed_boxes(clip: Clip) -> BoundingBoxes:
    """Return the box of each shape that nothing moves: walls and posts, and the ground."""
    pieces = _shape_pieces(clip.skeleton, is_moved=False)
    corners = _corners(clip.skeleton, clip.states[:1], pieces)
    return BoundingBoxes(*corners[0])


def _corners_of_moving(clip: Clip) -> Float[np.ndarray, "F 2 3"]:
    """Return the box around moving surfaces, shapes or skins; around the bones alone if they have none."""
    skeleton = clip.skeleton
    pieces = _shape_pieces(skeleton, is_moved=True)
    if isinstance(skeleton.skin, MeshSkin):
        pieces += _skin_pieces(skeleton)
    corners = _corners(skeleton, clip.states, pieces)
    if skeleton.shapes is not None:
        ends = [
            (nodes.min(axis=0), nodes.max(axis=0))
            for nodes in map(skeleton.shapes.decode, clip.states)
        ]
        corners = np.concatenate([corners, np.array(ends)[:, :, None]], axis=2)
    if not corners.size:
        positions, _ = skeleton.world_poses(clip.states)
        around = _thickness(skeleton)
        corners = np.stack([positions - around, positions + around], axis=1)
    return np.stack([corners[:, 0].min(axis=1), corners[:, 1].max(axis=1)], axis=1)


def _thickness(skeleton: Skeleton) -> float:
    """Return the distance by which a skin at rest reaches beyond its bones [m]; 0 without one."""
    if skeleton.skin is None:
        return 0.0
    points = skin_mesh(skeleton).points
    rest = np.array([bone.offset for bone in skeleton.bones])
    beyond = [points.max(axis=0) - rest.max(axis=0), rest.min(axis=0) - points.min(axis=0)]
    return max(float(np.min(beyond, axis=1).max()), 0.0)


def _shape_pieces(skeleton: Skeleton, *, is_moved: bool) -> list[_Piece]:
    """Return the boxes of the shapes that something moves, or of all others."""
    pieces = []
    for number, bone in enumerate(skeleton.bones):
        if skeleton.is_moved(number) == is_moved:
            for shape in bone.shapes:
                axes = rotation_matrices(np.array(shape.orientation))
                pieces.append(_Piece(number, np.array(shape.position), axes, _half_sizes(shape)))
    return pieces


def _skin_pieces(skeleton: Skeleton) -> list[_Piece]:
    """Return a box per bone, around the points of the skin that follow it most."""
    mesh = skin_mesh(skeleton)
    main = mesh.main_bones
    pieces = []
    for number in np.unique(main).tolist():
        local = mesh.points_of(number, main == number)
        middle = (local.min(axis=0) + local.max(axis=0)) / 2
        pieces.append(_Piece(number, middle, np.eye(3), np.ptp(local, axis=0) / 2))
    return pieces


def _corners(
    skeleton: Skeleton, states: Float[np.ndarray, "F S"], pieces: Sequence[_Piece]
) -> Float[np.ndarray, "F 2 N 3"]:
    """Return the corners [m] of the box around each piece in each state."""
    positions, orientations = skeleton.world_poses(states)
    corners = np.zeros((len(states), 2, len(pieces), 3))
    for number, piece in enumerate(pieces):
        axes = rotation_matrices(orientations[:, piece.bone])
        centre = positions[:, piece.bone] + axes @ piece.middle
        half = np.abs(axes @ piece.axes) @ piece.half
        corners[:, 0, number] = centre - half
        corners[:, 1, number] = centre + half
    return corners


def _half_sizes(shape: Shape) -> Vector:
    """Return half the shape's extent along its own axes [m]."""
    if shape.kind in ("box", "ellipsoid"):
        return np.array(shape.size)
    half = np.full(3, shape.size[0])
    if shape.kind == "capsule":
        half[2] += shape.size[1]
    if shape.kind == "cylinder":
        half[2] = shape.size[1]
    return half
