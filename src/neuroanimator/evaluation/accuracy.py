"""How far the emulator is from the physics, in one step and over time."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator.data.config import RUN_STEPS
from neuroanimator.data.sampling import sample_control_runs, sample_starts
from neuroanimator.data.store import Transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.normaliser import MIN_CHANGE
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems import carried_system
from neuroanimator.systems.cores import core_count
from neuroanimator.systems.system import Runs, Scheme, System

HELD_OUT_SEED = 2**31
"""Test runs are drawn from this seed, one above the largest a dataset may have."""

HELD_OUT_SECONDS = 5.0
"""Length of a test run [s], the longest horizon reported."""

HELD_OUT_RUNS = 32

MAX_TRANSITIONS = 1_600
"""Super steps on which one-step errors are measured; the physics must take each by every scheme."""


@dataclass(frozen=True)
class HeldOut:
    """Unseen runs and what fine physics makes of them."""

    system: System
    dt: float
    states: np.ndarray
    """(B, T+1, S) by the system's `fine` scheme."""
    controls: np.ndarray
    """(B, T, C)"""
    change_scale: np.ndarray
    """(V,) standard deviation of the change in one super step, in the body's own frame: the unit of every error.

    What never moves has none, and no error: see `moves`.
    """
    most_transitions: int = MAX_TRANSITIONS

    @property
    def frame(self) -> Frame:
        """The frame in which states are compared."""
        return Frame.of(self.system.structure, self.dt)

    @property
    def moves(self) -> np.ndarray:
        """(V,) whether each number of a change varies at all: a target that stands still has no error to speak of."""
        return self.change_scale >= MIN_CHANGE

    def relative(self, off: np.ndarray) -> np.ndarray:
        """Return the errors `off` (..., V) of what moves, over the standard deviation of its change."""
        return off[..., self.moves] / self.change_scale[self.moves]

    @property
    def still(self) -> list[str]:
        """Names and units of the state entries that never move and are left out of every error."""
        entries = self.frame.change_entries(self.states.shape[-1])
        names = zip(self.system.state.names, entries, strict=True)
        return [name for name, numbers in names if numbers and not self.moves[list(numbers)].any()]

    @property
    def transitions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(states, controls, next states) of at most `most_transitions` super steps, evenly taken from all runs.

        They come from the first `RUN_STEPS` super steps, as the examples of a dataset do.
        """
        size, span = self.states.shape[-1], min(RUN_STEPS, self.controls.shape[1])
        every = -(-len(self.controls) * span // self.most_transitions)
        parts = self.states[:, :span], self.states[:, 1 : span + 1]
        states, truth = (part.reshape(-1, size)[::every] for part in parts)
        return states, self.controls[:, :span].reshape(-1, self.controls.shape[-1])[::every], truth

    def moments(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return states (count, S) of random moments of the runs, and the controls (count, C) given then.

        They are the same at every call, so that all physics is timed from the same ones.
        """
        rng = np.random.default_rng(0)
        rows, steps = (
            rng.integers(0, len(self.states), count),
            rng.integers(0, self.controls.shape[1], count),
        )
        return self.states[rows, steps], self.controls[rows, steps]


def system_of(emulator: Emulator) -> System:
    """Return the physics `emulator` stands for; BadFileError if that has another state or control."""
    spec = emulator.spec
    system = carried_system(spec.system, spec.definition)
    if (system.state, system.control) != (spec.state, spec.control):
        raise BadFileError(
            f"The emulator says it is of {system.name}, which has another state or control."
        )
    return system


def held_out_runs(
    emulator: Emulator,
    count: int = HELD_OUT_RUNS,
    seconds: float = HELD_OUT_SECONDS,
    seed: int = 0,
    *,
    is_shifted: bool = False,
) -> HeldOut:
    """Return `count` unseen runs of the emulator's system under random, never idle controls.

    Shifted ones use the full range and another control at every super step: training seldom saw such.
    """
    spec, rng = emulator.spec, np.random.default_rng([HELD_OUT_SEED, seed])
    system = system_of(emulator)
    steps = round(seconds / spec.dt)
    threads = core_count()
    starts = sample_starts(system, rng, count, threads)
    controls = sample_control_runs(rng, count, steps, spec.dt, system)
    if is_shifted:
        controls = system.bounds.middle + rng.uniform(-1, 1, controls.shape) * system.bounds.half
    runs = system.simulate(starts, controls, spec.dt, scheme=system.fine, threads=threads)
    return make_test(system, spec.dt, runs.states[runs.is_alive], controls[runs.is_alive])


def make_test(system: System, dt: float, states: np.ndarray, controls: np.ndarray) -> HeldOut:
    """Return the runs (B, T+1, S) under controls (B, T, C) as a test; refuse runs in which nothing happens."""
    if not len(states):
        raise ArgumentError(
            f"{system.name}: every test run blew up in the physics itself. Use a smaller step."
        )
    changes = Frame.of(system.structure, dt).difference(states[:, :-1], states[:, 1:])
    test = HeldOut(system, dt, states, controls, changes.std(axis=(0, 1)))
    if not test.moves.any():
        raise ArgumentError(
            f"{system.name}: nothing changes by {MIN_CHANGE:g} of its unit in a super step."
        )
    return test


def one_step_error(emulator: Emulator, test: HeldOut) -> np.ndarray:
    """Return (M,) rms one-step errors of what moves, over the standard deviation of the change."""
    states, controls, truth = test.transitions
    kind = emulator.normaliser.change_scale.dtype
    found = jax.vmap(emulator.step)(jnp.asarray(states, kind), jnp.asarray(controls, kind))
    return root_mean_square(test.relative(test.frame.difference(truth, np.asarray(found, float))))


def root_mean_square(values: np.ndarray, axis: int | tuple[int, ...] = 0) -> np.ndarray:
    """Return the root of the mean square along `axis`."""
    return np.sqrt(np.mean(values**2, axis=axis))


def rollout_error(frame: Frame, found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return (T+1,) rms errors of trajectories (B, T+1, S), over the rms way the truth gets from its start.

    What gets nowhere is left out.
    """
    reach = root_mean_square(frame.difference(truth[:, :1], truth), axis=(0, 1))
    moves = reach >= MIN_CHANGE
    return root_mean_square(frame.difference(truth, found)[..., moves] / reach[moves], axis=(0, 2))


def scheme_error(test: HeldOut, scheme: Scheme) -> float:
    """Return the one-step error of the physics itself when stepped by `scheme`; infinite if it blows up."""
    states, controls, _ = test.transitions
    threads = core_count()
    runs = test.system.simulate(states, controls[:, None], test.dt, scheme=scheme, threads=threads)
    return runs_error(test, runs)


def runs_error(test: HeldOut, runs: Runs) -> float:
    """Return the error of `runs` that took the test's super steps, one each; infinite if one blew up."""
    if not runs.is_alive.all():
        return float("inf")
    truth = test.transitions[2]
    off = test.frame.difference(truth, runs.states[:, 1])
    return float(root_mean_square(test.relative(off), axis=(0, 1)))


def recorded_runs(emulator: Emulator, data: Transitions | None) -> HeldOut:
    """Return the runs of `data` that were kept for the test; of an emulator of recordings."""
    spec = emulator.spec
    if data is None or data.held_out is None:
        raise ArgumentError(
            f"data: {spec.system} was learnt from recordings; the test needs those that 'generate' kept apart. "
            "Pass its folder: --data."
        )
    dt = data.config.substeps * data.system.physics_dt
    if (data.system.state, data.system.control) != (spec.state, spec.control) or abs(
        dt - spec.dt
    ) > 1e-9:
        raise ArgumentError(
            f"data: other state, control or super step than the emulator's of {spec.system}."
        )
    return make_test(data.system, spec.dt, *data.held_out)


NO_CHANGE, CONSTANT_VELOCITY = "persistence", "constant velocity"
"""The predictors that need no data: nothing changes; speeds stay."""


def baselines(data: Transitions | None, test: HeldOut) -> dict[str, float]:
    """Return the one-step errors of cheap predictors: nothing changes, speeds stay, ridge regression on `data`."""
    states, controls, truth = test.transitions
    frame = test.frame
    guesses = {NO_CHANGE: states, CONSTANT_VELOCITY: _coasted(test, states)}
    if data is not None:
        first, following = (
            np.asarray(data.states[:, 0], float),
            np.asarray(data.states[:, 1], float),
        )
        weights = _ridge(
            _linear_features(test, first, data.controls[:, 0]), frame.remainder(first, following)
        )
        guesses["ridge regression"] = frame.apply(
            states, _linear_features(test, states, controls) @ weights
        )
    return {
        name: float(root_mean_square(test.relative(frame.difference(truth, guess)), axis=(0, 1)))
        for name, guess in guesses.items()
    }


def _coasted(test: HeldOut, states: np.ndarray) -> np.ndarray:
    """Return `states` (N, S) a super step later if all speeds stayed as they are."""
    frame = test.frame
    still = np.zeros((len(states), len(test.change_scale)))
    coasting = np.array(states)
    for position, rate in test.system.structure.rates:
        coasting[:, position] += test.dt * states[:, rate]
    if frame.segments:  # the frame coasts the root, its plain entries coast as above
        moved = frame.apply(states, still)
        coasting = np.where(moved == states, coasting, moved)
    return coasting


def _linear_features(test: HeldOut, states: np.ndarray, controls: np.ndarray) -> np.ndarray:
    structure = test.system.structure
    angles = states @ np.array(structure.angles, dtype=float).reshape(-1, states.shape[1]).T
    seen = test.frame.local(states)
    plain = states[:, np.array(structure.plain, dtype=int)]
    ones = np.ones((len(states), 1))
    return np.concatenate([np.sin(angles), np.cos(angles), plain, seen, controls, ones], axis=1)


def _ridge(inputs: np.ndarray, outputs: np.ndarray, strength: float = 1e-6) -> np.ndarray:
    gram = inputs.T @ inputs + strength * len(inputs) * np.eye(inputs.shape[1])
    return np.linalg.solve(gram, inputs.T @ outputs)
