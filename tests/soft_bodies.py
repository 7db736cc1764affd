"""A made-up soft body, for tests of what draws it: a square of cloth that waves below a ball."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from neuroanimator import Clip, DatasetConfig, Emulator, TrainingConfig
from neuroanimator.appearance.shapes import Shapes
from neuroanimator.appearance.skeleton import Bone, Shape, Skeleton
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.physics.loading import resolve
from neuroanimator.physics.soft.soft_system import SoftSystem
from neuroanimator.state.links import Joint
from neuroanimator.state.placement import Placement
from neuroanimator.state.rotation import facing

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def wavy_shapes(side: int = 40, count: int = 12, *, turns: bool = False) -> Shapes:
    """Return a square of `side` x `side` nodes, 1 m wide, and smooth shapes of it; a state begins with the anchor.

    If that `turns`, its heading is the fourth number.
    """
    line = np.linspace(0, 1, side)
    across, down = (axis.ravel() for axis in np.meshgrid(line, line))
    mean = np.stack([across - 0.5, 0 * across, -down], axis=1)
    waves = []
    for number in range(count):
        along = (1 + number % 5) * across + (1 + number // 5) * down
        wave = np.zeros((side * side, 3))
        wave[:, (1, 0, 2)[number % 3]] = down * np.sin(np.pi * along + number)
        waves.append(wave.ravel())
    orthogonal, _ = np.linalg.qr(np.stack(waves, axis=1))
    modes = orthogonal.T.reshape(count, -1, 3) * side
    node = np.arange(side * side).reshape(side, side)
    first = np.stack([node[:-1, :-1], node[1:, :-1], node[1:, 1:]], axis=-1).reshape(-1, 3)
    second = np.stack([node[:-1, :-1], node[1:, 1:], node[:-1, 1:]], axis=-1).reshape(-1, 3)
    faces = np.concatenate([first, second])
    if turns:
        return Shapes(mean, modes, faces, first=4, placement=Placement(0, 3))
    return Shapes(mean, modes, faces, first=3, placement=Placement(0))


def soft_clip(
    shapes: Shapes, frames: int = 20, decay: float = 1.5, seed: int = 0, name: str = "flag"
) -> Clip:
    """Return a motion whose `shapes` swing the less the later they come."""
    joints = tuple(Joint("slide", entry, axis, (0.0, 0.0, 0.0)) for entry, axis in enumerate(AXES))
    ball = Shape("sphere", (0.05,), (0.0, 0.0, 0.0), UPRIGHT, (0.2, 0.4, 0.8, 1.0))
    hand = Bone("hand", -1, (0.0, 0.0, 0.0), UPRIGHT, joints, (ball,))
    skeleton = Skeleton((hand,), shapes=shapes)
    rng = np.random.default_rng(seed)
    times = np.arange(frames) / 30
    count = len(shapes.modes)
    swings = 0.15 / (1 + np.arange(count)) ** decay
    rates = rng.uniform(2, 25, count)
    states = np.zeros((frames, shapes.first + count))
    states[:, 0] = 0.3 * np.sin(2 * times + seed)
    states[:, 2] = 1.5
    states[:, shapes.amplitudes] = swings * np.sin(
        rates * times[:, None] + rng.uniform(0, 6, count)
    )
    if shapes.placement.heading >= 0:
        states[:, shapes.placement.heading] = 3 * times
    return Clip(name, skeleton, times, states)


def distances(points: np.ndarray, clip: Clip) -> np.ndarray:
    """Return the distance of the nodes from where the states have them, at root mean square, in each frame [m]."""
    assert clip.skeleton.shapes is not None
    away = points - clip.skeleton.shapes.decode(clip.states)
    return np.sqrt((away**2).sum(axis=2).mean(axis=1))


@cache
def moving_states(system: SoftSystem) -> np.ndarray:
    """Return states (N, S) of random runs, in random order."""
    rng = np.random.default_rng(5)
    count, steps = 48, 16
    starts = system.sample_starts(rng, count)
    dt = 40 * system.physics_dt
    controls = system.sample_paths(rng, count, steps, dt, starts)
    states = system.simulate(starts, controls, dt).states
    return rng.permutation(states[:, 1:].reshape(count * steps, -1))


def hanging_cloth(folder: Path, name: str, toml: str) -> Path:
    """Return the TOML file of a square cloth of 8 x 8 nodes that hangs from its first row, with its mesh beside it."""
    side = 8
    line = np.linspace(0, 1, side)
    rows = [f"v {0.6 * (x - 0.5):.4f} 0 {1 - 0.8 * z:.4f}" for z in line for x in line]
    for first in (np.arange(side - 1)[:, None] * side + np.arange(1, side)).ravel().tolist():
        rows.append(f"f {first} {first + side} {first + side + 1} {first + 1}")
    (folder / f"{name}.obj").write_text("\n".join(rows))
    path = folder / f"{name}.toml"
    path.write_text(toml)
    return path


def poses_of(headed: np.ndarray) -> np.ndarray:
    """Return poses (F, M, 7, ...) of movers with positions [m] and headings [rad] (F, M, 4, ...)."""
    turned = np.moveaxis(facing(headed[:, :, 3]), -1, 2)
    return np.concatenate([headed[:, :, :3], turned], axis=2)


def hasty_emulator(toml: Path, folder: Path, substeps: int | None = None) -> Emulator:
    """Return an emulator of the system of a TOML file with the weights that training begins with, read back from its file."""
    name, text, usual = resolve(str(toml))
    config = DatasetConfig(
        system=name, definition=text, substeps=substeps or usual, count=200, samples_per_run=12
    )
    transitions = simulate_transitions(config)
    file = folder / f"{name}.emulator.safetensors"
    build_emulator(transitions, TrainingConfig(widths=(16, 16))).save(file)
    return Emulator.load(file)
