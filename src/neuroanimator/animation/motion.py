"""Motions of the emulator alone: under random controls, under given ones, and from a named start."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from neuroanimator.animation.showcase import (
    dive,
    is_soft_on_ground,
    level_swim,
    swims_under_a_surface,
    throw,
)
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.files.zoo import DEFAULT_MOTIONS
from neuroanimator.state.slowness import slowness
from neuroanimator.state.start import Start, start_state
from neuroanimator.systems.random_controls import sample_controls
from neuroanimator.systems.system import System, closed_starts

MAX_SECONDS = 3600.0
"""Maximum duration of a random motion [s]: an hour; longer for a slow system."""

USUAL_SECONDS = 5.0
"""Default duration of a random motion [s]; longer for a slow system."""

LIVELIEST_OF = 16
"""Number of random paths from which the liveliest is shown: along some, hardly anything moves."""

STEP_ROUNDING = 1e-9
"""Share of a super step by which a motion may exceed whole super steps: floating-point rounding."""


class Drive(NamedTuple):
    """The start of a motion and what drives it."""

    start: Float[np.ndarray, " S"]
    controls: Float[np.ndarray, "T C"]
    remarks: tuple[str, ...] = ()
    """Sentences on what a user should know about it."""

    def motion(self, emulator: Emulator) -> Float[np.ndarray, "K S"]:
        """Return the emulator's trajectory (K = T+1 states)."""
        return np.asarray(emulator.rollout(self.start, self.controls), float)

    def trusted_motion(
        self, emulator: Emulator
    ) -> tuple[Float[np.ndarray, "K S"], Float[np.ndarray, " T"]]:
        """Return (`motion`, the score of each of its T super steps), both from one rollout."""
        states, scores = emulator.rollout_trusted(self.start, self.controls)
        return np.asarray(states, float), scores


def default_drive(emulator: Emulator, system: System | None = None) -> Drive:
    """Return the drive that is shown by default: a truck parks, a dolphin leaps; see `random_drive` for the `system`.

    It is `shipped_drive` for a system that ships, and `random_drive` with seed 0 for any other.
    """
    return shipped_drive(emulator) or random_drive(emulator, None, 0, system=system)


def shipped_drive(emulator: Emulator) -> Drive | None:
    """Return the motion that ships for the emulator's system, at the emulator's super step; None if there is none.

    It was found for one super step; at others its controls are interpolated.
    """
    motion = json.loads(DEFAULT_MOTIONS.read_text(encoding="ascii")).get(emulator.system)
    if emulator.definition or motion is None:
        return None
    found = np.array(motion["controls"], float)
    middles = (np.arange(len(found)) + 0.5) * motion["dt"]
    steps = round(len(found) * motion["dt"] / emulator.dt)
    times = (np.arange(steps) + 0.5) * emulator.dt
    columns = [np.interp(times, middles, column) for column in found.T]
    return Drive(np.array(motion["start"], float), np.stack(columns, axis=1))


def random_drive(
    emulator: Emulator,
    seconds: float | None,
    seed: int,
    start: ArrayLike | None = None,
    system: System | None = None,
) -> Drive:
    """Return random, never idle controls, and `start` (S,).

    Without a start it begins at rest, free hinges at random angles. Seed 0 without a start gives a motion worth watching:
    systems with a gait move by it, swimmers well below the surface; a soft body on the ground is thrown and left alone,
    any other goes along the liveliest of several paths within its training. The `system` is needed only by a body whose parts
    are tied together: without it such a body begins at rest.

    Raises ArgumentError for a duration out of range and for a negative seed.
    """
    steps = checked_steps(seconds, seed, emulator.dt)
    rng = np.random.default_rng(seed)
    bounds = emulator.bounds
    gait = emulator.gait
    is_showcase = seed == 0 and start is None
    if start is not None:
        state = np.asarray(start)
    elif is_showcase and not emulator.control.size:
        state = emulator.rest
    else:
        state = _random_start(emulator, rng, system)
    if seed == 0 and gait is not None:
        controls = gait.controls(steps, emulator.dt, bounds)
        if is_showcase and swims_under_a_surface(emulator):
            state = dive(emulator, state)
            controls = level_swim(emulator, state, controls)
    elif is_showcase and is_soft_on_ground(emulator):
        state = throw(emulator, state)
        controls = np.repeat(bounds.middle[None], steps, axis=0)
    else:
        paths = _paths_about(emulator, rng, state, steps, LIVELIEST_OF if is_showcase else 1)
        if paths is None:
            controls = sample_controls(rng, steps, emulator.dt, bounds, gait)
        else:
            controls = _liveliest(emulator, state, paths)
    return Drive(np.asarray(state, float), controls)


def checked_steps(seconds: float | None, seed: int, dt: float) -> int:
    """Return the super steps of `dt` [s] in a random motion of `seconds`; ArgumentError if it or `seed` is out of range."""
    slower = slowness(dt)
    if seconds is None:
        seconds = USUAL_SECONDS * slower
    if not dt <= seconds <= MAX_SECONDS * slower:
        raise ArgumentError(
            f"seconds: wanted between {dt:g} and {MAX_SECONDS * slower:g}, got {seconds:g}."
        )
    if seed < 0:
        raise ArgumentError(f"seed: wanted 0 or more, got {seed}.")
    return int(np.ceil(seconds / dt - STEP_ROUNDING))


def _paths_about(
    emulator: Emulator,
    rng: np.random.Generator,
    start: Float[np.ndarray, " S"],
    steps: int,
    count: int,
) -> Float[np.ndarray, "B T C"] | None:
    """Return controls that take a soft body's movers along `count` smooth paths within their reach; None for other bodies.

    Random velocities would leave the training domain within a second.
    """
    contacts = emulator.frame.shape_contacts
    if contacts is None:
        return None
    from neuroanimator.systems.movers import movers_of, pace_of  # with it comes pydantic

    movers = movers_of(emulator.system, emulator.definition, emulator.rest)
    if movers is None:
        return None
    starts = np.repeat(np.asarray(start, float)[None], count, axis=0)
    return movers.random_paths(
        rng, *movers.of(starts), steps, emulator.dt, pace_of(contacts.anchor)
    )


def _liveliest(
    emulator: Emulator, start: Float[np.ndarray, " S"], paths: Float[np.ndarray, "B T C"]
) -> Float[np.ndarray, "T C"]:
    """Return, of the paths within the training domain, the controls that vary most; the first if none is within it."""
    if len(paths) == 1:
        return paths[0]
    liveliness = (paths / emulator.bounds.magnitude).std(axis=(1, 2))
    for number in np.argsort(-liveliness):
        _, scores = emulator.rollout_trusted(start, paths[number])
        if scores.max() < 1:
            return paths[number]
    return paths[0]


def _random_start(
    emulator: Emulator, rng: np.random.Generator, system: System | None
) -> Float[np.ndarray, " S"]:
    """Return the state of rest with free hinges at random angles within a quarter turn.

    An undriven system begins off rest by about a super step's usual change: all its motions would be the same otherwise.
    """
    start = emulator.rest
    if not emulator.control.size:
        unit = np.asarray(emulator.normaliser.unit, float)
        off_rest = emulator.frame.apply(start, unit * rng.normal(size=len(unit)))
        return closed_starts(emulator.spec, off_rest[None], system)[0]
    hinges = _free_hinges(emulator)
    start[hinges] = rng.uniform(-np.pi / 2, np.pi / 2, len(hinges))
    return closed_starts(emulator.spec, start[None], system)[0]


def _free_hinges(emulator: Emulator) -> Int[np.ndarray, " H"]:
    """Return the state entries of hinges whose rest angle is 0; a body of mass points has none."""
    if emulator.state_structure.cloud is not None:
        return np.array([], int)
    is_angle = np.asarray(emulator.features.angles).any(axis=0)
    at_zero = np.flatnonzero(is_angle & (emulator.rest == 0))
    # Typed, since an empty array would be of floats.
    positions = np.array([position for position, _ in emulator.rates], int)
    return np.intersect1d(at_zero, positions)


def named_start(
    emulator: Emulator, parts: Start, system: System | None = None
) -> Float[np.ndarray, " S"]:
    """Return the state of rest with `parts` set to the given numbers, by the `system` if there is one; see `System.start_at`."""
    if system is not None:
        return system.start_at(parts)
    structure = emulator.state_structure
    orientations = [entry for entry, _ in structure.orientations]
    return start_state(
        emulator.state, emulator.rest, parts, orientations=orientations, cloud=structure.cloud
    )


def controlled_drive(
    emulator: Emulator, controls: ArrayLike, start: ArrayLike | None = None
) -> Drive:
    """Return the drive of `controls` (T, C) from `start` (S,), or from rest.

    Raises ArgumentError for controls out of bounds.
    """
    checked = emulator.control.check(controls, "control")
    held = emulator.bounds.check(checked, emulator.control.names)
    return Drive(np.asarray(emulator.rest if start is None else start, float), held)
