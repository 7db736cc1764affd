"""Find the shapes of a soft body: run it under random motions of what moves it, and take what explains most.

Snapshots go through a singular value decomposition of few rows at a time: what is kept of all before, and the new ones.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.appearance.shapes import Shapes
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.soft.flex_scene import FlexScene
from neuroanimator.systems.soft.program import LANES
from neuroanimator.systems.soft.scene import Motion, Scene, anchor_of
from neuroanimator.terminal import progress_bar

SETTLING = 12.0
"""Time in which a cloth comes to rest under weight, if it is stopped every `BLOCK` frames [s]."""

RUN = 16.0
"""Time of each run [s]."""

WAVES = 3
"""Number of sinusoids in a mover's path along an axis."""

FREQUENCIES = (0.05, 0.5)
"""Lowest and highest of their frequencies [Hz]."""

BLOCK = 16
"""Number of frames simulated at once."""

BLOCKS = 3
"""Number of blocks whose snapshots are taken into account at once."""

FARTHEST = 100.0
"""Distance over the size of the body at which a motion has diverged."""

EVERY = 2
"""Distance of snapshots within a run, in frames."""

SPARE = 32
"""Number of shapes kept beyond those wanted while snapshots come in."""

STARTS = 768
"""Number of states kept, for runs to begin from."""


class Found:
    """The shapes of a body, its state of rest, and states its motions may begin from."""

    def __init__(self, shapes: Shapes, starts: Float[np.ndarray, "P S"]):
        self.shapes = shapes
        self.starts = starts
        """The first is that of rest."""


def find_shapes(
    definition: SoftDefinition | FlexDefinition, scene: Scene | FlexScene, seed: int = 0
) -> Found:
    """Return the shapes of the body of `scene`, and states its motions may begin from.

    Raises ArgumentError if the physics diverges.
    """
    rng = np.random.default_rng(seed)
    dt = definition.substeps * definition.physics.step
    step = scene.finding_step
    steps = round(dt / step)
    anchor = scene.anchor
    settling = round(SETTLING / dt)
    frames = round(RUN / dt)
    with progress_bar("finding shapes", settling + frames) as bar:
        rest = _settled(scene, dt, steps, settling)
        bar.advance_to(settling)
        mean = rest.positions - anchor_of(anchor, scene.rest[None])
        paths = random_paths(definition, scene, rng, frames, dt)[..., : scene.runs]
        sketch = Sketch(definition.shapes + SPARE)
        kept = []
        snapshots = []
        motion = _side_by_side(rest, scene.runs)
        for first in range(0, frames, BLOCK):
            block = paths[first : first + BLOCK + 1]
            positions, velocities = scene.play(motion, block, dt, steps)
            moving = np.diff(block, axis=0) / dt
            away = positions - anchor_of(anchor, block[1:])[:, None] - mean[..., None]
            relative = velocities - anchor_of(anchor, moving)[:, None]
            fits = (np.abs(away) < FARTHEST * scene.size).all(axis=(0, 1, 2))  # false for NaN too
            if not fits.any():
                raise ArgumentError(
                    f"physics: the body flies apart in steps of {step:g} s while its movers "
                    "wander. Take smaller steps, or let movers be slower."
                )
            motion = Motion(positions[-1][..., fits], velocities[-1][..., fits])
            paths = paths[..., fits]
            block = block[..., fits]
            moving = moving[..., fits]
            away = away[..., fits]
            relative = relative[..., fits]
            snapshots.append(_rows(away[::EVERY]))
            if len(snapshots) == BLOCKS or first + BLOCK >= frames:
                sketch.add(np.concatenate(snapshots))
                snapshots.clear()
            kept.append(_thinned(rng, block[1:], moving, away, relative, STARTS * BLOCK // frames))
            bar.advance_to(settling + min(first + BLOCK, frames))
    count = len(rest.positions)
    modes = sketch.leading(definition.shapes) * np.sqrt(count)
    first = 6 * len(scene.movers)
    shapes = Shapes(
        mean,
        modes.reshape(-1, count, 3).astype(float),
        scene.faces,
        first,
        3 * anchor if anchor >= 0 else -1,
    )
    still = np.zeros(first + 2 * len(modes))
    still[: first // 2] = scene.rest.ravel()
    starts = [still[None]]
    for movers, moving, away, relative in kept:
        amplitudes = shapes.project(away)
        rates = shapes.project(relative)
        starts.append(np.concatenate([movers, moving, amplitudes, rates], axis=1))
    return Found(shapes, np.concatenate(starts))


def _settled(scene: Scene | FlexScene, dt: float, steps: int, frames: int) -> Motion:
    """Return the body after it has hung from movers at rest."""
    positions = scene.positions
    motion = Motion(positions, np.zeros_like(positions))
    for first in range(0, frames, BLOCK):
        count = min(BLOCK, frames - first)
        paths = np.repeat(scene.rest[None], count + 1, axis=0)
        path, _ = scene.play(motion, paths, dt, steps)
        motion = Motion(path[-1].astype(float), np.zeros_like(positions))
    return motion


def random_paths(
    definition: SoftDefinition | FlexDefinition,
    scene: Scene | FlexScene,
    rng: np.random.Generator,
    frames: int,
    dt: float,
) -> Float[np.ndarray, "F M 3 L"]:
    """Return positions [m] of movers that begin at rest and follow random waves no faster than they may."""
    shape = (WAVES, 1, *scene.rest.shape, LANES)
    frequency = rng.uniform(*FREQUENCIES, shape)
    phase = rng.uniform(0, 2 * np.pi, shape)
    times = np.arange(frames + 1).reshape(1, -1, 1, 1, 1) * dt
    waves = np.sin(2 * np.pi * frequency * times + phase).sum(axis=0) / np.sqrt(WAVES / 2)
    reach = np.array([mover.reach for mover in scene.movers])
    wanted = scene.rest[..., None] + reach[..., None] * waves
    largest = dt * np.array([mover.speed for mover in scene.movers])[..., None]
    paths = [np.repeat(scene.rest[..., None], LANES, axis=-1)]
    for target in wanted[1:]:
        paths.append(paths[-1] + np.clip(target - paths[-1], -largest, largest))
    return np.stack(paths)


def _side_by_side(motion: Motion, count: int) -> Motion:
    return Motion(*(np.repeat(part[..., None], count, axis=-1) for part in motion))


def _rows(away: Float[np.ndarray, "F N 3 L"]) -> Float[np.ndarray, "R D"]:
    rows = np.moveaxis(away, -1, 1)
    return rows.reshape(rows.shape[0] * rows.shape[1], -1).astype(np.float32)


def _thinned(
    rng: np.random.Generator,
    movers: Float[np.ndarray, "F M 3 L"],
    moving: Float[np.ndarray, "F M 3 L"],
    away: Float[np.ndarray, "F N 3 L"],
    relative: Float[np.ndarray, "F N 3 L"],
    count: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return `count` random moments: movers' positions and velocities (count, 3M), nodes' (count, N, 3)."""
    frames = rng.integers(0, len(away), count)
    lanes = rng.integers(0, away.shape[-1], count)
    of_movers = [part[frames, :, :, lanes].reshape(count, -1) for part in (movers, moving)]
    of_nodes = [part[frames, :, :, lanes].astype(np.float32) for part in (away, relative)]
    return of_movers[0], of_movers[1], of_nodes[0], of_nodes[1]


class Sketch:
    """The leading right singular vectors of rows that come in blocks (Brand, Fast Low-Rank Modifications, 2006)."""

    def __init__(self, rank: int):
        self.rank = rank
        self._weighted: Float[np.ndarray, "R D"] | None = None
        """Singular vectors times their singular values."""

    def add(self, rows: Float[np.ndarray, "B D"]) -> None:
        """Take `rows` into account."""
        if self._weighted is not None:
            rows = np.concatenate([self._weighted, rows])
        _, vectors = np.linalg.eigh((rows @ rows.T).astype(float))
        leading = vectors[:, ::-1][:, : self.rank]
        self._weighted = leading.T.astype(np.float32) @ rows

    def leading(self, count: int) -> Float[np.ndarray, "K D"]:
        """Return the first `count` singular vectors; as many as there are if there are fewer."""
        assert self._weighted is not None
        lengths = np.linalg.norm(self._weighted, axis=1)
        known = int((lengths > 1e-6 * lengths[0]).sum())
        _, _, vectors = np.linalg.svd(self._weighted[: min(count, known)], full_matrices=False)
        return vectors
