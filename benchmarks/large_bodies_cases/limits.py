"""How an emulator of a soft body holds out: a million super steps, rest, and what is drawn inside of colliders."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

import neuroanimator as na
from large_bodies_cases.equal_error import STEPS, Test, emulated_states
from large_bodies_cases.spectra import own_nodes
from neuroanimator.systems.soft.soft_scene import Motion, SoftScene
from neuroanimator.systems.soft.soft_system import SoftSystem
from neuroanimator.terminal import progress_bar

PIECE = 2_000
"""Super steps rolled out at once."""

EVERY = 10
"""Of so many states of a long run, the nodes of one are put together."""

STILL_STEPS = 10_000
"""Super steps without control."""

SETTLING = 150
"""Super steps for which physics and emulator are left to themselves after a motion: 5 s."""

PUSHED = 4
"""Number of runs that are pushed out of colliders, which takes seconds for each."""

BLOCK = 15
"""Super steps of physics played at once."""

SEED = 2**31
"""Of the long run's paths."""

MILLIMETRES = 1e3


def endurance_columns(test: Test, emulator: na.Emulator, steps: int) -> dict[str, float | bool]:
    """Return the columns of a row: how far nodes come from where they rest in so many super steps, and how they rest.

    Percents are of the body's size; of a moment, root mean squares of all nodes.
    """
    system = test.system
    largest, last = along_random_paths(system, emulator, steps)
    idle = np.zeros((STILL_STEPS, system.control.size), np.float32)
    rest = np.asarray(emulator.rollout(system.rest.astype(np.float32), idle, may_diverge=True))
    after = np.asarray(emulator.rollout(last, idle, may_diverge=True))
    ends = emulated_states(emulator, test)[:, -1].astype(np.float32)
    waiting = np.zeros((len(ends), SETTLING, system.control.size), np.float32)
    settled = np.asarray(emulator.rollout(ends, waiting, may_diverge=True), float)[:, -1]
    return {
        "super_steps": steps,
        "is_finite": bool(np.isfinite(largest) and np.isfinite(after).all()),
        "farthest_node_sizes": largest,
        "physics_farthest_node_sizes": farthest_of_physics(test),
        "rest_drift_percent": 100 * farthest(system, rest[::EVERY]),
        "after_motion_percent": from_rest(system, after[-1:]),
        "after_5_s_percent": from_rest(system, settled),
        "physics_after_5_s_percent": physics_from_rest(test),
    }


def along_random_paths(
    system: SoftSystem, emulator: na.Emulator, steps: int
) -> tuple[float, Float[np.ndarray, " S"]]:
    """Return (the largest distance of a node from where it rests [sizes], the last state) of a run from rest."""
    rng = np.random.default_rng(SEED)
    state = system.rest.astype(np.float32)
    largest = 0.0
    with progress_bar(f"{system.name}: long run", steps) as bar:
        for first in range(0, steps, PIECE):
            count = min(PIECE, steps - first)
            starts = state[None].astype(float)
            controls = system.sample_paths(rng, 1, count, emulator.dt, starts)[0]
            path = emulator.rollout(state, controls.astype(np.float32), may_diverge=True)
            path = np.asarray(path)
            state = path[-1]
            if not np.isfinite(path).all():
                return np.inf, state
            largest = max(largest, farthest(system, path[::EVERY]))
            bar.advance_to(first + count)
    return largest, state


def farthest(system: SoftSystem, states: Float[np.ndarray, "T S"]) -> float:
    """Return the largest distance of any node from where it rests, seen from what holds it [sizes]."""
    modes = system.shapes.modes.reshape(len(system.shapes.modes), -1).astype(np.float32)
    away = states[:, system.shapes.amplitudes] @ modes
    squares = (away.reshape(len(states), -1, 3) ** 2).sum(axis=-1)
    return float(np.sqrt(squares.max())) / system.scene.size


def farthest_of_physics(test: Test) -> float:
    """Return the same of the physics along the test's paths."""
    every = np.arange(len(test.system.shapes.mean))
    largest = 0.0
    for step in range(len(test.truth)):
        away = own_nodes(test, every, slice(step, step + 1))
        largest = max(largest, float(np.linalg.norm(away, axis=-1).max()))
    return largest / test.system.scene.size


def from_rest(system: SoftSystem, states: Float[np.ndarray, "B S"]) -> float:
    """Return how far nodes are from where they rest [% of the size], root mean square, the mean of all states."""
    # Amplitudes are root mean squares of nodes, and modes are orthogonal.
    away = np.linalg.norm(states[:, system.shapes.amplitudes], axis=1)
    return 100 * float(away.mean()) / system.scene.size


def physics_from_rest(test: Test) -> float:
    """Return the same of the physics, `SETTLING` super steps after its movers have stopped at the test's end."""
    system = test.system
    steps = system.truth.steps(test.dt)
    motion = test.end
    for _ in range(0, SETTLING, BLOCK):
        paths = np.repeat(test.paths[-1:], BLOCK + 1, axis=0)
        played = system.scene.play(motion, paths, test.dt, steps, test.parameters)
        positions, velocities = played
        motion = Motion(positions[-1], velocities[-1])
    every = np.arange(len(system.shapes.mean))
    ended = test._replace(truth=motion.positions[None], paths=test.paths[-2:])
    away = own_nodes(ended, every, slice(None))
    squares = (away**2).sum(axis=-1).mean(axis=-1)
    return 100 * float(np.sqrt(squares).mean()) / system.scene.size


def penetration_columns(test: Test, emulator: na.Emulator) -> dict[str, float]:
    """Return the columns of a row: the deepest node, and middle of a face, inside of colliders [mm].

    Depth begins where nodes touch: the thickness of a cloth is outside of a collider. Of the first second of `PUSHED` runs
    of physics, of the emulator as it is, and as it is drawn.
    """
    shapes = test.system.shapes
    scene = test.system.scene
    states = emulated_states(emulator, test)[:PUSHED, 1 : STEPS + 1]
    physics = own_nodes(test, np.arange(len(shapes.mean)), slice(STEPS)) + shapes.mean
    deepest = {"physics": 0.0, "emulated": 0.0, "drawn": 0.0}
    middles = dict(deepest)
    for run, path in enumerate(states):
        clip = na.make_clip(emulator, path, rate=1 / emulator.dt)
        drawn = na.push_out(clip, emulator)
        assert drawn.skeleton.shapes is not None
        nodes = {
            "physics": physics[run],
            "emulated": shapes.unplaced(clip.states),
            "drawn": drawn.skeleton.shapes.unplaced(drawn.states),
        }
        for what, points in nodes.items():
            deepest[what] = max(deepest[what], depth(scene, points, path))
            between = points[:, shapes.faces].mean(axis=2)
            middles[what] = max(middles[what], depth(scene, between, path))
    columns = {f"{what}_node_mm": found for what, found in deepest.items()}
    return columns | {f"{what}_face_mm": found for what, found in middles.items()}


def depth(
    scene: SoftScene, points: Float[np.ndarray, "F P 3"], states: Float[np.ndarray, "F S"]
) -> float:
    """Return how deep the deepest of `points`, seen from what holds the body, is inside of anything; 0 outside [mm]."""
    every = tuple(range(points.shape[1]))
    deepest = 0.0
    for nodes, state in zip(points, states, strict=True):
        for distance in scene.contacts(nodes, every).distances(state):
            deepest = max(deepest, -float(distance.min()))
    return MILLIMETRES * deepest
