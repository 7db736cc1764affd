"""Motions to look at, by the emulator alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from neuroanimator.data.sampling import sample_controls
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.state.rotation import multiply, rotate
from neuroanimator.state.start import start_state

LONGEST = 3600.0
"""[s] Longest random motion; an hour."""
FIRST_BEND, MAX_BEND = 0.02, 0.15
"""Of the controls' range: by how much a swimmer bends its back to keep its depth, tried at first and at most."""
SECANTS = 4
"""Tries at that bend: a few centimetres after five seconds."""
DIVE = 0.6
"""How deep under the water's surface a swimmer begins, over its length: there its tail stays wet."""
TOSS = 2.0
"""How high a soft body is thrown, over its size: high enough to bounce, and low enough to be seen whole."""
TOSS_TURN = np.array([0.1, 0.6])
"""[rad] How it is held when thrown, about its X and Y: it lands on a corner."""
TOSS_SPIN = np.array([0.3, 6.0, 0.2])
"""[rad/s] How it turns in flight: it rolls on."""
WELL_WITHIN = 0.8
"""Share of the speed and spin seen in training that a throw has at most."""
GRAVITY = 9.81
"""[m/s²]"""


def random_motion(
    emulator: Emulator, seconds: float, seed: int, start: np.ndarray | None = None
) -> np.ndarray:
    """Return a trajectory (T+1, S) under random, never idle controls, from `start` (S,).

    Without a start it begins at rest; free hinges start anywhere. With the seed 0 and no start it is a motion to look
    at: what has a gait moves by it, a swimmer well under the surface, and a soft body on the ground is thrown and left
    alone.
    """
    if not emulator.dt <= seconds <= LONGEST:
        raise ArgumentError(
            f"seconds: wanted between {emulator.dt:g} and {LONGEST:g}, came {seconds:g}."
        )
    if seed < 0:
        raise ArgumentError(f"seed: wanted 0 or more, came {seed}.")
    rng, spec = np.random.default_rng(seed), emulator.spec
    is_shown = seed == 0 and start is None
    if start is None:
        start = np.array(spec.rest)
        positions = _free_hinges(emulator)
        start[positions] = rng.uniform(-np.pi / 2, np.pi / 2, len(positions))
    steps = int(np.ceil(seconds / emulator.dt - 1e-9))
    if seed == 0 and spec.gait is not None:
        controls = spec.gait.controls(steps, emulator.dt, spec.bounds)
        if is_shown and _swims_under_a_surface(emulator):
            start = _dived(emulator, start)
            controls = _level_swim(emulator, start, controls)
    elif is_shown and _is_soft_on_ground(emulator):
        start = _thrown(emulator, start)
        controls = np.repeat(spec.bounds.middle[None], steps, axis=0)
    else:
        controls = sample_controls(rng, steps, emulator.dt, spec.bounds, spec.gait)
    return np.asarray(emulator.rollout(start, controls), float)


def _free_hinges(emulator: Emulator) -> np.ndarray:
    """Return the state entries of hinges that are at 0 at rest; a body of mass points has none."""
    if emulator.state_structure.cloud is not None:
        return np.array([], int)
    angles = np.asarray(emulator.features.angles).any(axis=0) & (emulator.rest == 0)
    positions = np.array(
        [position for position, _ in emulator.rates], int
    )  # int even where there are none
    return np.intersect1d(np.flatnonzero(angles), positions)


def _swims_under_a_surface(emulator: Emulator) -> bool:
    """Return whether this is a body of mass points in water with a surface."""
    is_body = emulator.state_structure.cloud is not None
    return is_body and emulator.frame.is_immersed and bool(emulator.frame.probes)


def _level_swim(emulator: Emulator, start: np.ndarray, controls: np.ndarray) -> np.ndarray:
    """Return `controls` (T, C) of a gait with the back bent a little, such that the swim ends as deep as it begins.

    The bend is what is added to the muscles in the sense of the gait, found by secants.
    """
    spec = emulator.spec
    assert spec.gait is not None
    sense = np.sign(spec.gait.amplitudes) * spec.bounds.half

    def risen(bend: float) -> float:
        states = np.array(emulator.rollout(start, spec.bounds.clip(controls + bend * sense)), float)
        heights = [_points(emulator, state)[0][:, 2].mean() for state in (states[0], states[-1])]
        return float(heights[1] - heights[0])

    last, bend = 0.0, FIRST_BEND
    rise_before = risen(last)
    for _ in range(SECANTS):
        rise = risen(bend)
        if abs(rise - rise_before) < 1e-6:
            break
        slope = (rise - rise_before) / (bend - last)
        last, rise_before = bend, rise
        bend = float(np.clip(bend - rise / slope, -MAX_BEND, MAX_BEND))
    return spec.bounds.clip(controls + bend * sense)


def _dived(emulator: Emulator, start: np.ndarray) -> np.ndarray:
    """Return `start` (S,) of a swimmer moved down under the water's surface."""
    positions, _ = _points(emulator, start)
    length = float(np.ptp(positions, axis=0).max())
    positions[:, 2] += _level(emulator) - DIVE * length - positions[:, 2].mean()
    return start


def _thrown(emulator: Emulator, start: np.ndarray) -> np.ndarray:
    """Return `start` (S,) of a soft body turned, above the ground, and flying: up, forward and spinning."""
    positions, velocities = _points(emulator, start)
    size = float(np.ptp(positions, axis=0).max())
    centre = positions.mean(axis=0)
    orientation = multiply(_about(0, TOSS_TURN[0]), _about(1, TOSS_TURN[1]))
    offsets = rotate(np.broadcast_to(orientation, (len(positions), 4)), positions - centre)
    fall = np.sqrt(GRAVITY * TOSS * size)  # half the height is climbed: v² = 2 g (TOSS / 2) size
    velocity = np.array([0.6 * fall, 0.15 * fall, fall])
    velocity *= min(
        1.0, WELL_WITHIN * emulator.encoding.max_speed / float(np.linalg.norm(velocity))
    )
    angular_velocity = TOSS_SPIN * min(
        1.0, WELL_WITHIN * emulator.encoding.max_angular_speed / float(np.linalg.norm(TOSS_SPIN))
    )
    positions[:] = centre + np.array([0.0, 0.0, TOSS / 2 * size]) + offsets
    velocities[:] = velocity + np.cross(angular_velocity, offsets)
    return start


def _is_soft_on_ground(emulator: Emulator) -> bool:
    """Return whether this is a body of mass points that at rest lies wholly above the level its heights count from."""
    if (
        emulator.state_structure.cloud is None
        or not emulator.frame.has_gravity
        or emulator.frame.is_immersed
    ):
        return False
    positions, _ = _points(emulator, emulator.rest)
    return float(positions[:, 2].min()) > _level(emulator) - 0.05 * float(np.ptp(positions[:, 2]))


def _level(emulator: Emulator) -> float:
    """Return the height [m] of ground or water: what the frame's probes are held against."""
    return emulator.frame.probes[0][3] if emulator.frame.probes else 0.0


def _points(emulator: Emulator, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return places [m] and velocities [m/s] (N, 3) of the mass points of `state` (S,), as views into it."""
    cloud = emulator.state_structure.cloud
    assert cloud is not None
    size = 3 * cloud.count
    return state[:size].reshape(-1, 3), state[size : 2 * size].reshape(-1, 3)


def _about(axis: int, angle: float) -> np.ndarray:
    """Return the quaternion wxyz (4,) that turns by `angle` [rad] about an axis of the world."""
    quaternion = np.zeros(4)
    quaternion[0] = np.cos(angle / 2)
    quaternion[1 + axis] = np.sin(angle / 2)
    return quaternion


def named_start(emulator: Emulator, parts: Mapping[str, Sequence[float]]) -> np.ndarray:
    """Return the state of rest (S,) with the numbers of each of `parts` in their places; see `start_state`."""
    structure = emulator.state_structure
    orientations = [entry for entry, _ in structure.orientations]
    return start_state(
        emulator.state, emulator.rest, parts, orientations=orientations, cloud=structure.cloud
    )


def controlled_motion(
    emulator: Emulator, controls: np.ndarray, start: np.ndarray | None = None
) -> np.ndarray:
    """Return the trajectory (T+1, S) from `start` (S,), or from rest, under `controls` (T, C).

    Raises ArgumentError for controls out of bounds.
    """
    spec = emulator.spec
    controls = spec.bounds.check(spec.control.check(controls, "control"), spec.control.names)
    return np.asarray(
        emulator.rollout(np.array(spec.rest) if start is None else start, controls), float
    )
