"""Forward kinematics of a tree of links, as homogeneous matrices: few operations on many numbers, which compile quickly.

`Link.local_pose` does the same for one link, in quaternions.
"""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.links import Joint, Link, unit_quaternion
from neuroanimator.state.rotation import rotation_matrices

Matrix = Float[np.ndarray, "4 4"]
"""A homogeneous matrix, or a part of one."""


class MovedFrame(NamedTuple):
    """The motion of a joint: its matrix in its parent's frame is a sum of constant ones.

    For a hinge `still` + sin · `first` + cos · `second`, for a slide `still` + distance · `first`; for a ball `still` times
    its rotation; for a free joint its rotation and its position alone.
    """

    parent: int
    """Index of its parent frame; -1 for the world."""
    kind: str
    """One of `links.JOINT_KINDS`."""
    entry: int
    """First state entry the joint reads."""
    reference: float
    """Value of the entry at which a hinge or a slide is at zero."""
    still: Matrix
    first: Matrix
    second: Matrix


class CarriedLink(NamedTuple):
    """A link, and the frame that carries it."""

    frame: int
    """Index of the frame; -1 for a link that never moves."""
    matrix: Matrix
    """Matrix from the link to the frame."""


@dataclass(frozen=True)
class Kinematics:
    """A tree of links."""

    links: tuple[Link, ...]
    """Links, each after its parent."""
    parents: tuple[int, ...]
    """Index of the parent of each link; -1 for the world."""

    @cached_property
    def frames(self) -> list[MovedFrame]:
        """Motions of the joints, parents first."""
        return self._frames_and_links[0]

    @cached_property
    def carried(self) -> list[CarriedLink]:
        """Frame that carries each link."""
        return self._frames_and_links[1]

    @cached_property
    def _frames_and_links(self) -> tuple[list[MovedFrame], list[CarriedLink]]:
        frames: list[MovedFrame] = []
        carried: list[CarriedLink] = []
        for link, parent in zip(self.links, self.parents, strict=True):
            frame = -1
            matrix = np.eye(4)
            if parent >= 0:
                frame, matrix = carried[parent]
            matrix = matrix @ _fixed(link)
            for joint in link.joints:
                frames.append(_moved(joint, frame, matrix))
                frame = len(frames) - 1
                matrix = np.eye(4)
                if joint.kind == "ball":
                    matrix = _translation(-np.array(joint.anchor))
            carried.append(CarriedLink(frame, matrix))
        return frames, carried

    def transforms(self, states: Float[AnyArray, "... S"]) -> list[Float[AnyArray, "... 4 4"]]:
        """Return for each frame the matrix from the frame to the world, for states (..., S)."""
        of_axes = self._of_axes(states)
        transforms: list[Float[AnyArray, "... 4 4"]] = []
        for frame in self.frames:
            if frame.kind in ("hinge", "slide"):
                local = next(of_axes)
            else:
                local = _turned(frame, states)
            if frame.parent >= 0 and frame.kind != "free":
                local = product(transforms[frame.parent], local)
            transforms.append(local)
        return transforms

    def _of_axes(self, states: Float[AnyArray, "... S"]) -> Iterator[Float[AnyArray, "... 4 4"]]:
        """Yield the matrices of hinges and slides, in order, in their parents' frames; they are computed together."""
        frames = [frame for frame in self.frames if frame.kind in ("hinge", "slide")]
        if not frames:
            return
        xp = states.__array_namespace__()

        def constant(numbers: list[Any]) -> AnyArray:
            return xp.asarray(np.array(numbers), dtype=states.dtype)

        value = xp.stack([states[..., frame.entry] for frame in frames], axis=-1)
        value = value - constant([frame.reference for frame in frames])
        turns = constant([float(frame.kind == "hinge") for frame in frames])
        first = turns * xp.sin(value) + (1 - turns) * value
        matrices = (
            constant([frame.still for frame in frames])
            + first[..., None, None] * constant([frame.first for frame in frames])
            + xp.cos(value)[..., None, None] * constant([frame.second for frame in frames])
        )
        for number in range(len(frames)):
            yield matrices[..., number, :, :]


def product(
    left: Float[AnyArray, "*#B M K"], right: Float[AnyArray, "*#B K N"]
) -> Float[AnyArray, "*#B M N"]:
    """Return the matrix product of two small matrices, of many states at once.

    A sum of outer products is fused with the surrounding code: matmul, called for each state, takes six times as long.
    """
    count = left.shape[-1]
    terms = (left[..., :, k, None] * right[..., k, None, :] for k in range(count))
    return reduce(operator.add, terms)


def _moved(joint: Joint, parent: int, matrix: Matrix) -> MovedFrame:
    """Return the frame that `joint` moves, attached to the frame `parent` by `matrix`."""
    first = np.zeros((4, 4))
    second = np.zeros((4, 4))
    still = matrix
    if joint.kind == "slide":
        first[:3, 3] = joint.axis
    elif joint.kind == "hinge":
        # Rodrigues' formula: R = k kᵀ + sin · K + cos · (1 - k kᵀ)
        there = _translation(np.array(joint.anchor))
        back = _translation(-np.array(joint.anchor))
        x, y, z = joint.axis
        along = np.outer(joint.axis, joint.axis)
        first[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        second[:3, :3] = np.eye(3) - along
        middle = np.eye(4)
        middle[:3, :3] = along
        still = matrix @ there @ middle @ back
        first = there @ first @ back
        second = there @ second @ back
    elif joint.kind == "ball":
        still = matrix @ _translation(np.array(joint.anchor))
    return MovedFrame(
        parent, joint.kind, joint.entry, joint.reference, still, matrix @ first, matrix @ second
    )  # fmt: skip


def _turned(frame: MovedFrame, states: Float[AnyArray, "... S"]) -> Float[AnyArray, "... 4 4"]:
    """Return the matrix of a ball or a free joint."""
    xp = states.__array_namespace__()
    is_free = frame.kind == "free"
    first = frame.entry + 3 if is_free else frame.entry
    rotation = rotation_matrices(unit_quaternion(states, first))
    position = xp.zeros_like(states[..., :3])
    if is_free:
        position = states[..., frame.entry : frame.entry + 3]
    upper = xp.concat([rotation, position[..., None]], axis=-1)
    last = xp.asarray(np.array([[0, 0, 0, 1]]), dtype=states.dtype)
    whole = xp.concat([upper, xp.broadcast_to(last, (*upper.shape[:-2], 1, 4))], axis=-2)
    if is_free:
        return whole
    return product(xp.asarray(frame.still, dtype=states.dtype), whole)


def _fixed(link: Link) -> Matrix:
    """Return the matrix of a link in its parent's frame, with joints at their references."""
    matrix = _translation(np.array(link.offset))
    quaternion = np.array(link.orientation)
    matrix[:3, :3] = rotation_matrices(quaternion / np.linalg.norm(quaternion))
    return matrix


def _translation(offset: Float[np.ndarray, " 3"]) -> Matrix:
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix
