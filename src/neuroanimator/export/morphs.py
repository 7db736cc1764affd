"""The surface of a soft body as a mesh with morph targets: the shapes of the emulator, fitted again to a motion.

    amplitudes (F, K) of all frames → singular value decomposition → targets that move the points, most important first
    normals (F, N, 3) of some frames → the same → targets that turn the normals

A motion of some seconds needs fewer shapes than the emulator has. Normals are not a linear function of the points, and
deserve targets of their own: for a cape that flaps wildly, twenty leave an rms error of 19°, and the derivatives of
the normals along the points' targets one of 46°.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.appearance.loft import Surface, normals_of
from neuroanimator.appearance.shapes import Shapes

CLOTH_RGBA = (0.74, 0.25, 0.21, 1.0)
"""Red, green, blue (sRGB) and opacity of a surface."""

TOLERANCE = 2.5e-4
"""Rms distance of the nodes, in the worst frame, below which no target is added, over the body's size."""

NORMAL_TOLERANCE = 0.05
"""The same for their normals, which have length 1."""

MAX_BYTES = 64
"""Maximum number of bytes per coordinate in all targets that move points: with normals and motion, 2 MB for 5,000 nodes."""

MAX_NORMALS = 20
"""Maximum number of targets that turn normals."""

SAMPLES = 128
"""Maximum number of frames to which the normals' targets are fitted."""

CHUNK = 32
"""Number of frames decoded at a time."""

LIMITS = {1: (np.int8, 2**7 - 1), 2: (np.int16, 2**15 - 1)}
"""Integer type, and the value that stands for 1, by number of bytes."""


class MorphTarget(NamedTuple):
    """Changes of all nodes, or of their normals, at a weight of 1: integers, the largest of which stands for 1."""

    whole: Int[np.ndarray, "N 3"]
    """Integers of one or two bytes."""

    @property
    def deltas(self) -> Float[np.ndarray, "N 3"]:
        """The changes, at most 1."""
        _, limit = LIMITS[self.whole.itemsize]
        return self.whole / limit


@dataclass(frozen=True, eq=False)
class Morphs:
    """A mesh and its targets. Weights of those that move nodes are between 0 and 1: Blender and gltfpack clip others."""

    points: Float[np.ndarray, "N 3"]
    """Nodes at zero weights, in the anchor's frame [m]."""
    scale: float
    """Distance by which a 1 in a target moves a node at a weight of 1 [m]."""
    normals: Float[np.ndarray, "N 3"]
    """Normals at the nodes, of length 1."""
    triangles: Int[np.ndarray, "M 3"]
    """Numbers of nodes, counterclockwise from outside."""
    moving: tuple[MorphTarget, ...]
    """Targets that move the nodes."""
    turning: tuple[MorphTarget, ...]
    """Targets that turn the normals; their weights, of any size, follow the others'."""
    error: float
    """Rms distance of the nodes, in the worst frame, from their true positions [m]."""


class SurfaceNode(NamedTuple):
    """A surface in motion."""

    morphs: Morphs
    positions: Float[np.ndarray, "F 3"]
    """Positions of the anchor [m]."""
    orientations: Float[np.ndarray, "F 4"] | None
    """Its quaternions; None for an anchor that does not turn."""
    weights: Float[np.ndarray, "F W"]
    """Weights of the targets, in their order."""


def surface_nodes(shapes: Shapes, motions: Sequence[Float[np.ndarray, "_ S"]]) -> list[SurfaceNode]:
    """Return the surface in each of the `motions`, with shared targets."""
    states = np.concatenate(motions)
    amplitudes = states[:, shapes.amplitudes]
    mean_amplitudes = amplitudes.mean(axis=0)
    mean = shapes.mean + np.tensordot(mean_amplitudes, shapes.modes, axes=1)
    tolerance = TOLERANCE * float(np.ptp(mean, axis=0).max())
    moving, distances, error = _moving_targets(shapes, amplitudes - mean_amplitudes, tolerance)
    least = distances.min(axis=0)
    points = mean
    for low, target in zip(least, moving, strict=True):
        points = points + low * target.deltas
    scale = float(np.ptp(distances, axis=0).max(initial=0.0)) or 1.0
    weights = (distances - least) / scale
    # Blender keeps the angles between these normals and the mesh's own, so they must be the same.
    normals = surface_normals(shapes, points)
    turning, turns = _turning_targets(shapes, states, normals)
    morphs = Morphs(points, scale, normals, shapes.faces, moving, turning, error)
    all_weights = np.concatenate([weights, turns], axis=1)
    ends = np.cumsum([len(motion) for motion in motions])[:-1]
    nodes = []
    for motion, of_motion in zip(motions, np.split(all_weights, ends), strict=True):
        positions = shapes.placement.origin(motion)
        orientations = shapes.placement.quaternions(motion)
        nodes.append(SurfaceNode(morphs, positions, orientations, of_motion))
    return nodes


def surface_normals(
    shapes: Shapes, points: Float[np.ndarray, "*F N 3"]
) -> Float[np.ndarray, "*F N 3"]:
    """Return the unit normals of a surface with its nodes at `points`; arbitrary for inner nodes, which have none."""
    frames = points.reshape(-1, *shapes.mean.shape)
    normals = np.array([normals_of(Surface(frame, shapes.faces)) for frame in frames])
    within = np.setdiff1d(np.arange(len(shapes.mean)), shapes.faces)
    normals[:, within] = (0.0, 0.0, 1.0)
    return normals.reshape(points.shape)


def _moving_targets(
    shapes: Shapes, amplitudes: Float[np.ndarray, "F K"], tolerance: float
) -> tuple[tuple[MorphTarget, ...], Float[np.ndarray, "F R"], float]:
    """Return the targets that move the nodes, their distances [m], and the remaining distance [m].

    Each byte is spent where it removes most error: on one more target, or on a finer one.
    """
    left, sizes, mixtures = np.linalg.svd(amplitudes, full_matrices=False)
    paths = left * sizes
    modes = np.tensordot(mixtures, shapes.modes, axes=1)
    # Modes are orthogonal and of root mean square 1, so squares add up. Rounding has a mean square error of step² / 12.
    _, limit = LIMITS[1]
    steps = np.abs(modes).max(axis=(1, 2)) / limit
    rounding = 3 * steps[:, None] ** 2 / 12
    squares = paths.T**2
    rewards = np.concatenate([squares * (1 - rounding), squares * rounding])
    order = np.argsort(-rewards.sum(axis=1), kind="stable")[:MAX_BYTES]
    errors = _errors_left(squares.sum(axis=0), rewards[order])
    enough = _least_enough(errors, tolerance)
    numbers, byte_counts = np.unique(order[:enough] % len(sizes), return_counts=True)
    targets = []
    distances = [np.zeros((len(amplitudes), 0))]
    for number, byte_count in zip(numbers, byte_counts, strict=True):
        target, scale = _rounded(modes[number], int(byte_count))
        targets.append(target)
        distances.append(scale * paths[:, number : number + 1])
    return tuple(targets), np.concatenate(distances, axis=1), float(errors[enough])


def _turning_targets(
    shapes: Shapes, states: Float[np.ndarray, "F S"], base: Float[np.ndarray, "N 3"]
) -> tuple[tuple[MorphTarget, ...], Float[np.ndarray, "F Q"]]:
    """Return the targets that turn the normals, which are `base` without them, and their weights in all `states`."""
    count = len(shapes.mean)
    chosen = np.linspace(0, len(states) - 1, min(len(states), SAMPLES)).round().astype(int)
    samples = surface_normals(shapes, shapes.unplaced(states[chosen]))
    changes = (samples - base).reshape(len(samples), -1)
    # Only the first singular vectors of a few long rows are needed: from the products of the rows.
    powers, left = np.linalg.eigh(changes @ changes.T)
    powers = np.maximum(powers[::-1][:MAX_NORMALS], 0)
    left = left[:, ::-1][:, :MAX_NORMALS]
    errors = _errors_left((changes**2).sum(axis=1) / count, (left**2 * powers).T / count)
    enough = _least_enough(errors, NORMAL_TOLERANCE)
    used = left[:, :enough].T @ changes / np.sqrt(powers[:enough, None])
    weights = np.zeros((len(states), len(used)))
    for first in range(0, len(states), CHUNK):
        frames = slice(first, first + CHUNK)
        normals = surface_normals(shapes, shapes.unplaced(states[frames]))
        weights[frames] = (normals - base).reshape(len(normals), -1) @ used.T
    targets = []
    for number, mode in enumerate(used):
        target, scale = _rounded(mode.reshape(count, 3), 1)
        targets.append(target)
        weights[:, number] *= scale
    return tuple(targets), weights


def _errors_left(
    squares: Float[np.ndarray, " F"], rewards: Float[np.ndarray, "R F"]
) -> Float[np.ndarray, " _"]:
    """Return the error in the worst frame after subtracting none, one and so on of the `rewards` from its square."""
    taken = np.cumsum(rewards, axis=0)
    left = np.concatenate([squares[None], squares - taken])
    return np.sqrt(np.maximum(left, 0).max(axis=1))


def _least_enough(errors: Float[np.ndarray, " _"], tolerance: float) -> int:
    """Return the index of the first of the `errors` within the tolerance; of the last if there is none."""
    within = np.flatnonzero(errors <= tolerance)
    return int(within[0]) if len(within) else len(errors) - 1


def _rounded(mode: Float[np.ndarray, "N 3"], byte_count: int) -> tuple[MorphTarget, float]:
    """Return a target in integers of `byte_count` bytes, and the weight at which it is the `mode`."""
    kind, limit = LIMITS[byte_count]
    largest = float(np.abs(mode).max())
    whole = np.round(mode / largest * limit).astype(kind)
    return MorphTarget(whole), largest
