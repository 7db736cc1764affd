"""Find the shapes of a soft body: simulate it under random motions of its movers, and keep the leading singular vectors.

Snapshots go through a singular value decomposition of few rows at a time: the result for earlier ones, and new ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.appearance.shapes import Shapes
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import ArgumentError
from neuroanimator.physics.soft.mirror import odd_modes, reflected
from neuroanimator.physics.soft.soft_body import Points
from neuroanimator.physics.soft.soft_scene import Motion, SoftScene
from neuroanimator.physics.soft.throws import random_roots
from neuroanimator.state.parameters import draw_parameters, nominal_values
from neuroanimator.state.rotation import to_world_axes
from neuroanimator.state.shape_contacts import FREE, placement_of
from neuroanimator.state.structure import Mirror
from neuroanimator.terminal import progress_bar

SEED = 0
"""Seed of the random paths of movers and of random parameters."""

SETTLING = 12.0
"""Time in which a body comes to rest under its weight, if it is stopped every `BLOCK` frames [s]."""

RUN = 16.0
"""Duration of each run [s]."""

BLOCK = 16
"""Number of frames simulated at once."""

BLOCKS = 3
"""Number of blocks whose snapshots are processed at once."""

THROW = 3
"""Number of blocks after which a free body is placed elsewhere, at rest or thrown."""

FARTHEST = 100.0
"""Distance, over the size of the body, at which a motion has diverged."""

EVERY = 2
"""Number of frames between snapshots of a run."""

SPARE = 32
"""Number of additional shapes kept while snapshots are processed."""

SWEEPS = 3
"""Number of iterations that bring a random subspace closer to that of the leading singular vectors."""

MIN_SQUARE = 1e-12
"""Square of a singular value, over that of the largest, below which it counts as noise."""

TINY = 1e-300
"""Length added to divisors."""


class RestingShapes(NamedTuple):
    """The shapes of a body, and its state of rest."""

    shapes: Shapes
    rest: Float[np.ndarray, " S"]
    """State of rest, including its movers."""


def find_shapes(definition: SoftDefinition | FlexDefinition, scene: SoftScene) -> RestingShapes:
    """Return the shapes of the body of `scene`, and its state of rest.

    Raises ArgumentError if the physics diverges in every run.
    """
    rng = np.random.default_rng(SEED)
    dt = definition.substeps * definition.physics.step
    steps = round(dt / scene.finding_step)
    settling = round(SETTLING / dt)
    frames = round(RUN / dt)
    with progress_bar("finding shapes", settling + frames) as bar:
        rest = _settled(scene, dt, steps, settling, bar.advance_to)
        centre = scene.centre(rest)
        mean = rest - centre
        if scene.mirror is not None:
            mean = (mean + reflected(mean, scene.mirror)) / 2
        paths, rates = _random_paths(scene, rng, frames, dt)
        parameters = draw_parameters(scene.parameters, rng, scene.runs).T
        sketch = Sketch(definition.shapes + SPARE)
        snapshots: list[np.ndarray] = []
        still = np.zeros_like(mean)
        motion = _side_by_side(Motion(mean, still, centre), scene.runs)
        controls = scene.random_controls(rng, scene.runs, frames, dt)
        active = np.zeros((scene.runs, len(scene.muscles)))
        for first in range(0, frames, BLOCK):
            if scene.anchor == FREE and first % (THROW * BLOCK) == 0:
                motion = _thrown(scene, rng, mean, centre, paths[first], motion)
            block = paths[first : first + BLOCK + 1]
            muscles, followed = scene.contracted(active, controls[:, first : first + BLOCK], dt)
            active = followed[:, -1]
            played = scene.play(motion, block, dt, steps, parameters, muscles)
            positions, velocities = (np.moveaxis(part, -1, 1) for part in played)
            movers = np.moveaxis(block[1:], -1, 1)
            moving = rates[first : first + BLOCK]
            own = scene.own_motion(positions, velocities, movers, moving, mean, motion.origin.T)
            motion = Motion(played[0][-1], played[1][-1], motion.origin).recentred()
            away = own.positions - mean.astype(own.positions.dtype)
            fits = (np.abs(away) < FARTHEST * scene.size).all(axis=(0, 2, 3))  # False for NaN
            if not fits.any():
                raise ArgumentError(
                    f"physics: the body flies apart at a step of {scene.finding_step:g} s while its movers wander. "
                    "Use smaller steps, or slower movers."
                )
            if not fits.all():
                motion = Motion(*(part[..., fits] for part in motion))
                away = away[:, fits]
                paths = paths[..., fits]
                rates = rates[:, fits]
                parameters = parameters[:, fits]
                controls = controls[fits]
                active = active[fits]
            snapshots.append(away[::EVERY].reshape(-1, mean.size))
            if len(snapshots) == BLOCKS or first + BLOCK >= frames:
                shown = np.concatenate(snapshots)
                if scene.mirror is not None:
                    images = reflected(shown.reshape(len(shown), *mean.shape), scene.mirror)
                    shown = np.concatenate([shown, images.reshape(shown.shape)])
                sketch.add(shown)
                snapshots.clear()
            bar.advance_to(settling + min(first + BLOCK, frames))
    modes = sketch.leading(definition.shapes) * np.sqrt(len(mean))
    if scene.mirror is not None:
        modes = _sorted_modes(modes.reshape(-1, *mean.shape), scene.mirror)
    at_rest = scene.state_at_rest(centre)
    shapes = Shapes(
        mean,
        modes.reshape(-1, *mean.shape).astype(float),
        scene.faces,
        len(at_rest),
        placement_of(scene.movers.turning, scene.anchor),
    )
    others = np.zeros(2 * len(modes) + len(scene.muscles))
    return RestingShapes(
        shapes, np.concatenate([at_rest, others, nominal_values(scene.parameters)])
    )


def _sorted_modes(modes: Float[np.ndarray, "K N 3"], mirror: Mirror) -> Float[np.ndarray, "K N 3"]:
    """Return the modes, each exactly odd or even in the mirror: those found from motions and their images are nearly so."""
    images = reflected(modes, mirror)
    signs = np.where(odd_modes(modes, mirror), -1, 1)[:, None, None]
    exact = (modes + signs * images) / 2
    return exact / np.sqrt((exact**2).sum(axis=2).mean(axis=1))[:, None, None]


def _settled(
    scene: SoftScene, dt: float, steps: int, frames: int, on_frames: Callable[[int], None]
) -> Points:
    """Return the positions of nodes [m] after the body has hung from movers at rest, or lain on the ground.

    `on_frames` is called with the number of frames done.
    """
    positions = scene.positions
    still = np.zeros_like(positions)
    origin = np.array([0.0, 0.0, scene.rest_height])
    for first in range(0, frames, BLOCK):
        count = min(BLOCK, frames - first)
        paths = np.repeat(scene.movers.rest[None], count + 1, axis=0)
        path, _ = scene.play(Motion(positions, still, origin), paths, dt, steps)
        positions = path[-1].astype(float)
        on_frames(first + count)
    return positions + origin


def _random_paths(
    scene: SoftScene, rng: np.random.Generator, frames: int, dt: float
) -> tuple[Float[np.ndarray, "F D L"], Float[np.ndarray, "T L R"]]:
    """Return (poses of movers, beginning at rest; their rates)."""
    starts = np.repeat(scene.movers.rest[None], scene.runs, axis=0)
    still = np.zeros((scene.runs, scene.movers.rate_size))
    rates = scene.random_paths(rng, starts, still, frames, dt)
    return np.moveaxis(scene.movers.paths(starts, rates, dt), 0, -1), np.moveaxis(rates, 0, 1)


def _side_by_side(motion: Motion, count: int) -> Motion:
    return Motion(*(np.repeat(part[..., None], count, axis=-1) for part in motion))


def _thrown(
    scene: SoftScene,
    rng: np.random.Generator,
    mean: Points,
    centre: Float[np.ndarray, " 3"],
    movers: Float[np.ndarray, "D L"],
    motion: Motion,
) -> Motion:
    """Return the free body, lane by lane, at rest at `centre` or thrown; as in `motion` if movers leave no room."""
    parts = [np.array(part) for part in motion]
    for lane, root in enumerate(random_roots(scene, rng, mean, centre, movers.T)):
        if root is not None:
            parts[0][..., lane] = to_world_axes(root[3:7], mean)
            parts[1][..., lane] = root[7:10] + to_world_axes(root[3:7], np.cross(root[10:], mean))
            parts[2][..., lane] = root[:3]
    return Motion(*parts)


class Sketch:
    """The leading right singular vectors of rows that arrive in blocks (Brand, Fast Low-Rank Modifications, 2006)."""

    def __init__(self, rank: int):
        self.rank = rank
        self._mixtures: Float[np.ndarray, "R D"] | None = None
        """Orthonormal mixtures of all rows, with the smallest loss of explained variance."""

    def add(self, rows: Float[np.ndarray, "B D"]) -> None:
        """Add `rows`."""
        if self._mixtures is not None:
            rows = np.concatenate([self._mixtures, rows])
        if len(rows) > self.rank:
            leading = _leading_subspace((rows @ rows.T).astype(float), self.rank)
            rows = leading.T.astype(np.float32) @ rows
        self._mixtures = rows

    def leading(self, count: int) -> Float[np.ndarray, "K D"]:
        """Return the first `count` singular vectors, or all if there are fewer."""
        assert self._mixtures is not None
        rows = self._mixtures.astype(float)
        squares, left = np.linalg.eigh(rows @ rows.T)
        known = int((squares > MIN_SQUARE * squares[-1]).sum())
        kept = min(count, known)
        return (left[:, ::-1][:, :kept].T @ rows) / np.sqrt(squares[::-1][:kept, None])


def _leading_subspace(matrix: Float[np.ndarray, "R R"], count: int) -> Float[np.ndarray, "R k"]:
    """Return orthonormal vectors that approximately span the leading eigenvectors of a symmetric matrix.

    By subspace iteration from random vectors (Halko, Martinsson and Tropp, 2011).
    """
    subspace = np.random.default_rng(0).normal(size=(len(matrix), count))
    for _ in range(SWEEPS):
        subspace = _orthonormal(matrix @ subspace)
    return subspace


def _orthonormal(vectors: Float[np.ndarray, "R k"]) -> Float[np.ndarray, "R k"]:
    """Return orthonormal columns that span those of `vectors`, by two passes of the modified Gram-Schmidt method.

    LAPACK's threads wait for each other at every column, which takes a hundred times as long when cores are busy.
    """
    rows = np.ascontiguousarray(vectors.T)
    for _ in range(2):
        for place, row in enumerate(rows):
            row /= np.sqrt((row * row).sum()) + TINY
            after = rows[place + 1 :]
            after -= (after * row).sum(axis=1)[:, None] * row
    return rows.T
