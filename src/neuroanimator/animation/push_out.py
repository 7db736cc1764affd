"""Clips of soft bodies whose surface stays out of colliders, for drawing.

A push is no sum of the body's shapes, so the clip gets additional shapes: anything that draws a surface by its shapes
draws this one, too. The part of a push that the body's shapes span goes into their amplitudes, the rest into new shapes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.animation.clip import Clip
from neuroanimator.appearance.shapes import Shapes
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.state.shape_contacts import ShapeContacts

TOLERANCE = 5e-4
"""Maximum distance of a node from where it was pushed to [m]: half the depth that is promised."""

FIRST_COUNT = 8
"""Number of new shapes tried first, doubled until they suffice."""

FACE_ROUNDS = 8
"""Maximum number of rounds in which the corners of a face are pushed because its middle is inside."""

CHUNK = 32
"""Number of frames decoded at a time."""

MAX_NUMBERS = 100_000_000
"""Maximum number of coordinates pushed, in all frames together: memory."""


def push_out(clip: Clip, emulator: Emulator) -> Clip:
    """Return `clip` with all surface nodes outside of colliders, to 1 mm; `clip` itself if they already are.

    Its states are longer than the emulator's: it is for drawing only. Raises ArgumentError for a clip that is too long.
    """
    contacts = emulator.frame.shape_contacts
    if contacts is None:
        return clip
    return keep_out(clip, contacts)


def keep_out(clip: Clip, contacts: ShapeContacts) -> Clip:
    """Return the clip of `push_out`, for a body with the given `contacts`."""
    shapes = clip.skeleton.shapes
    if shapes is None:
        return clip
    touched, pushes = _pushes(clip.states, shapes, contacts)
    if not len(touched):
        return clip
    count = len(shapes.mean)
    amplitudes = clip.states[:, shapes.amplitudes].copy()
    told = shapes.project(pushes)
    amplitudes[touched] += told
    modes, weights = _shapes_of(pushes - np.tensordot(told, shapes.modes, axes=1))
    new = np.zeros((len(clip.states), len(modes)))
    new[touched] = weights
    own = replace(
        shapes,
        modes=np.concatenate([shapes.modes, modes.reshape(-1, count, 3)]),
        first=clip.states.shape[1],
    )
    states = np.concatenate([clip.states, amplitudes, new], axis=1)
    return replace(clip, states=states, skeleton=replace(clip.skeleton, shapes=own))


def _pushes(
    states: Float[np.ndarray, "F S"], shapes: Shapes, contacts: ShapeContacts
) -> tuple[np.ndarray, Float[np.ndarray, "P N 3"]]:
    """Return the frames in which nodes are inside of colliders, and the displacements that bring them out [m].

    Displacements are in the body's own frame.
    """
    frames: list[int] = []
    pushes: list[np.ndarray] = []
    for first in range(0, len(states), CHUNK):
        some = states[first : first + CHUNK]
        points = shapes.unplaced(some)
        moved = np.abs(contacts.pushed_out(points, some) - points)
        inside = moved.max(axis=(1, 2)) > TOLERANCE
        outside = _with_faces(points[inside], some[inside], shapes.faces, contacts)
        frames += (first + np.flatnonzero(inside)).tolist()
        pushes += list((outside - points[inside]).astype(np.float32))
        if len(pushes) * points[0].size > MAX_NUMBERS:
            raise ArgumentError(
                f"push-out: more than {MAX_NUMBERS:,} coordinates in contact. Shorten the clip, or leave push-out out."
            )
    count = len(shapes.mean)
    return np.array(frames, int), np.reshape(pushes, (len(frames), count, 3)).astype(float)


def _with_faces(
    points: Float[np.ndarray, "P N 3"],
    states: Float[np.ndarray, "P S"],
    faces: Int[np.ndarray, "F 3"],
    contacts: ShapeContacts,
) -> Float[np.ndarray, "P N 3"]:
    """Return nodes outside of colliders, far enough that the middles of faces between them are outside, too.

    After the first round only faces with a moved corner are checked.
    """
    points = contacts.pushed_out(points, states)
    doubtful = faces
    for _ in range(FACE_ROUNDS):
        middles = points[:, doubtful].mean(axis=2)
        pushes = contacts.pushed_out(middles, states) - middles
        is_pushed = np.abs(pushes).max(axis=2) > 0
        if not is_pushed.any():
            break
        total = np.zeros_like(points)
        count = np.zeros(points.shape[:2])
        for number in np.flatnonzero(is_pushed.any(axis=1)):
            for corner in doubtful.T:
                np.add.at(total[number], corner, pushes[number])
                np.add.at(count[number], corner, is_pushed[number])
        moved = np.flatnonzero(count.any(axis=0))
        steps = total[:, moved] / np.maximum(count[:, moved], 1)[..., None]
        points[:, moved] = contacts.pushed_out(points[:, moved] + steps, states)
        doubtful = faces[np.isin(faces, moved).any(axis=1)]
    return contacts.pushed_out(points, states)


def _shapes_of(
    pushes: Float[np.ndarray, "P N 3"],
) -> tuple[Float[np.ndarray, "R X"], Float[np.ndarray, "P R"]]:
    """Return shapes of root mean square 1 per node, and their amplitudes in each row, equal to `pushes` to `TOLERANCE`."""
    count = pushes.shape[1]
    rows = pushes.reshape(len(pushes), -1)
    left, sizes, modes = np.linalg.svd(rows, full_matrices=False)
    weights = left * sizes
    enough = min(FIRST_COUNT, len(sizes))
    while enough < len(sizes):
        missing = rows - weights[:, :enough] @ modes[:enough]
        if np.linalg.norm(missing.reshape(pushes.shape), axis=2).max() <= TOLERANCE:
            break
        enough = min(2 * enough, len(sizes))
    return modes[:enough] * np.sqrt(count), weights[:, :enough] / np.sqrt(count)
