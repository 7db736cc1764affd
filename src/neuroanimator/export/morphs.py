"""The surface of a soft body as a mesh with morph targets: the shapes of the emulator, fitted again to a motion.

    amplitudes (F, K) of all frames → singular value decomposition → targets that move the points, most important first
    normals (F, N, 3) of the frames that the others tell least → targets that turn the normals

A motion of some seconds needs fewer shapes than the emulator has. Normals are not a linear function of the points, and
deserve targets of their own. Engines and packers cut off weights below 0 and above 1, or keep the normals that a target
leads to and not the change. Frames mixed with weights between 0 and 1 are right in all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.appearance.colour import linear_of
from neuroanimator.appearance.loft import Surface, normals_of
from neuroanimator.appearance.shapes import Shapes

TOLERANCE = 2.5e-4
"""Rms distance of the nodes, in the worst frame, below which no target is added, over the body's size."""

NORMAL_TOLERANCE = 0.05
"""The same for their normals, which have length 1."""

MAX_BYTES = 61
"""Maximum number of bytes per coordinate in all targets that move points: with normals and motion, 2 MB for 5,000 nodes."""

MAX_NORMALS = 22
"""Maximum number of targets that turn normals."""

ROUNDS = 3
"""Number of times that normals' targets are fitted to their weights, which takes them from single frames to mixtures."""

SWEEPS = 100
"""Number of times that each weight of normals is set to the best one beside the others."""

SAMPLES = 128
"""Maximum number of frames to which the normals' targets are fitted."""

CHUNK = 32
"""Number of frames decoded at a time."""


class MorphTarget(NamedTuple):
    """Changes of all nodes, or of their normals, at a weight of 1: integers, the largest of which stands for 1."""

    whole: Int[np.ndarray, "N 3"]
    """Integers of one or two bytes."""

    @property
    def deltas(self) -> Float[np.ndarray, "N 3"]:
        """The changes, at most 1."""
        return self.whole / np.iinfo(self.whole.dtype).max


@dataclass(frozen=True, eq=False)
class Morphs:
    """A mesh and its targets. Weights are between 0 and 1: Blender and gltfpack clip others."""

    points: Float[np.ndarray, "N 3"]
    """Mean positions of the nodes, in the anchor's frame: those at zero weights [m]."""
    scale: float
    """Distance by which a 1 in a target moves a node at a weight of 1 [m]."""
    normals: Float[np.ndarray, "N 3"]
    """Normals at the nodes, of length 1."""
    colours: Float[np.ndarray, "N 3"] | None
    """Red, green and blue (linear) at the nodes; None for one colour."""
    triangles: Int[np.ndarray, "M 3"]
    """Numbers of nodes, counterclockwise from outside."""
    moving: tuple[MorphTarget, ...]
    """Targets that move the nodes; the first, with the same weight always, to where all others have the weight 0."""
    turning: tuple[MorphTarget, ...]
    """Targets that turn the normals; their weights follow the others'."""
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
    points = shapes.mean + np.tensordot(mean_amplitudes, shapes.modes, axes=1)
    tolerance = TOLERANCE * float(np.ptp(points, axis=0).max())
    moving, distances, error = _moving_targets(shapes, amplitudes - mean_amplitudes, tolerance)
    scale = float(distances.max(initial=0.0)) or 1.0
    # Blender keeps the angles between these normals and the mesh's own, so they must be the same.
    normals = surface_normals(shapes, points)
    turning, turns = _turning_targets(shapes, states, normals)
    colours = shapes.colours
    if colours is not None:
        colours = linear_of(colours)
    morphs = Morphs(points, scale, normals, colours, shapes.faces, moving, turning, error)
    all_weights = np.concatenate([distances / scale, turns], axis=1)
    ends = np.cumsum([len(motion) for motion in motions])[:-1]
    place = shapes.placement
    return [
        SurfaceNode(morphs, place.origin(motion), place.quaternions(motion), of_motion)
        for motion, of_motion in zip(motions, np.split(all_weights, ends), strict=True)
    ]


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
    """Return the targets that move the nodes, their distances, which are not negative [m], and the remaining distance [m].

    Each byte is spent where it removes most error: on one more target, or on a finer one.
    """
    left, sizes, mixtures = np.linalg.svd(amplitudes, full_matrices=False)
    paths = left * sizes
    modes = np.tensordot(mixtures, shapes.modes, axes=1)
    # Modes are orthogonal and of root mean square 1, so squares add up. Rounding has a mean square error of step² / 12.
    steps = np.abs(modes).max(axis=(1, 2)) / np.iinfo(np.int8).max
    rounding = 3 * steps[:, None] ** 2 / 12
    squares = paths.T**2
    rewards = np.concatenate([squares * (1 - rounding), squares * rounding])
    order = np.argsort(-rewards.sum(axis=1), kind="stable")[:MAX_BYTES]
    left = -np.cumsum(np.concatenate([-squares.sum(axis=0)[None], rewards[order]]), axis=0)
    errors = np.sqrt(np.maximum(left, 0).max(axis=1))
    within = np.flatnonzero(errors <= tolerance)
    enough = int(within[0]) if len(within) else len(errors) - 1
    numbers, byte_counts = np.unique(order[:enough] % len(sizes), return_counts=True)
    if not len(numbers):
        return (), np.zeros((len(amplitudes), 0)), float(errors[0])
    targets = []
    distances = [np.zeros(len(amplitudes))]
    lowest = np.zeros(shapes.mean.shape)
    for number, byte_count in zip(numbers, byte_counts, strict=True):
        target, size = _rounded(modes[number], int(byte_count))
        targets.append(target)
        least = size * paths[:, number].min()
        distances.append(size * paths[:, number] - least)
        lowest += least * target.deltas
    first, size = _rounded(lowest, 2)
    distances[0] += size
    return (first, *targets), np.stack(distances, axis=1), float(errors[enough])


def _turning_targets(
    shapes: Shapes, states: Float[np.ndarray, "F S"], base: Float[np.ndarray, "N 3"]
) -> tuple[tuple[MorphTarget, ...], Float[np.ndarray, "F Q"]]:
    """Return the targets that turn the normals, which are `base` without them, and their weights in all `states`.

    Each begins as the change in the sampled frame that the others tell worst.
    """
    every = np.linspace(0, len(states) - 1, min(len(states), SAMPLES)).round().astype(int)
    changes = _normal_changes(shapes, states[every], base)
    # Choose frames.
    used: list[int] = []
    weights = np.zeros((len(every), 0))
    while True:
        left = changes - weights @ changes[used]
        errors = (left**2).sum(axis=1) / len(base)
        errors[used] = 0
        worst = int(np.argmax(errors))
        if len(used) == MAX_NORMALS or errors[worst] <= NORMAL_TOLERANCE**2:
            break
        used.append(worst)
        weights = _mixed(changes @ changes[used].T, changes[used])
    # Fit targets to weights.
    kept = changes[used]
    for _ in range(ROUNDS):
        kept = np.clip(np.linalg.pinv(weights) @ changes, -1, 1)
        weights = _mixed(changes @ kept.T, kept)
    # Fit weights of all frames.
    along = np.zeros((len(states), len(used)))
    for first in range(0, len(states), CHUNK):
        frames = slice(first, first + CHUNK)
        along[frames] = _normal_changes(shapes, states[frames], base) @ kept.T
    targets = tuple(_whole(row.reshape(base.shape), 1) for row in kept)
    return targets, _mixed(along, kept)


def _normal_changes(
    shapes: Shapes, states: Float[np.ndarray, "F S"], base: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "F M"]:
    normals = surface_normals(shapes, shapes.unplaced(states))
    return (normals - base).reshape(len(states), -1)


def _mixed(
    along: Float[np.ndarray, "F Q"], vectors: Float[np.ndarray, "Q M"]
) -> Float[np.ndarray, "F Q"]:
    """Return the best weights between 0 and 1 of `vectors` for rows whose products with them are `along`.

    By coordinate descent.
    """
    products = vectors @ vectors.T
    weights = np.zeros_like(along)
    for _ in range(SWEEPS):
        for number, row in enumerate(products):
            step = (along[:, number] - weights @ row) / max(row[number], 1e-12)
            weights[:, number] = np.clip(weights[:, number] + step, 0, 1)
    return weights


def _rounded(mode: Float[np.ndarray, "N 3"], byte_count: int) -> tuple[MorphTarget, float]:
    """Return a target in integers of `byte_count` bytes, and the weight at which it is the `mode`."""
    largest = float(np.abs(mode).max())
    return _whole(mode / largest, byte_count), largest


def _whole(deltas: Float[np.ndarray, "N 3"], byte_count: int) -> MorphTarget:
    """Return changes of at most 1 as a target in integers of `byte_count` bytes."""
    kind = np.dtype(f"i{byte_count}")
    return MorphTarget(np.round(deltas * np.iinfo(kind).max).astype(kind))
