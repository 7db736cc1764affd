"""How far the emulator is from the physics, in one step and over time."""

from __future__ import annotations

import os
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator.data.sampling import sample_controls
from neuroanimator.data.transitions import Transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.systems import load_system
from neuroanimator.systems.system import Scheme, System

FINE = Scheme("rk4", 1e-4)
"""The reference every error is measured against: a tenth of the physics step."""

HELD_OUT_SEED = 2**31
"""Test runs are drawn from this seed, one above the largest a dataset may have."""

HORIZONS = (0.1, 0.2, 0.5, 1.0, 2.0)
"""Times at which rollout errors are reported [s]."""


MOST_TRANSITIONS = 2_500
"""Super steps on which one-step errors are measured; the physics must take each by every scheme."""

BLOCK = 500
"""Super steps rolled out at once when looking for blow-ups."""


@dataclass(frozen=True)
class TestSet:
    """Unseen runs and what fine physics makes of them."""

    __test__ = False  # not for pytest

    system: System
    dt: float
    states: np.ndarray
    """(B, T+1, S) by `FINE`."""
    controls: np.ndarray
    """(B, T, C)"""
    change_scale: np.ndarray
    """(S,) standard deviation of the change in one super step: the unit of every error."""

    @property
    def transitions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(states, controls, next states) of about `MOST_TRANSITIONS` super steps, evenly taken from all runs."""
        size = self.states.shape[-1]
        every = max(1, self.controls[..., 0].size // MOST_TRANSITIONS)
        states, truth = (part.reshape(-1, size)[::every] for part in (self.states[:, :-1], self.states[:, 1:]))
        return states, self.controls.reshape(-1, self.controls.shape[-1])[::every], truth


def held_out_runs(emulator: Emulator, count: int = 64, seconds: float = 2.0, seed: int = 0) -> TestSet:
    """Return `count` unseen runs of the emulator's system under random, never idle controls."""
    identity, rng = emulator.identity, np.random.default_rng([HELD_OUT_SEED])
    system = load_system(identity.system)
    steps = round(seconds / identity.dt)
    starts = system.sample_starts(rng, count)
    controls = np.stack([sample_controls(rng, steps, identity.dt, system.control_limit) for _ in range(count)])
    runs = system.simulate(starts, controls, identity.dt, scheme=FINE, threads=os.cpu_count() or 1)
    states, controls = runs.states[runs.is_alive], controls[runs.is_alive]
    return TestSet(system, identity.dt, states, controls, (states[:, 1:] - states[:, :-1]).std(axis=(0, 1)))


def one_step_error(emulator: Emulator, test: TestSet) -> np.ndarray:
    """Return (S,) rms one-step errors over the standard deviation of the change."""
    states, controls, truth = test.transitions
    kind = emulator.normaliser.change_scale.dtype
    found = jax.vmap(emulator.step)(jnp.asarray(states, kind), jnp.asarray(controls, kind))
    return root_mean_square((np.asarray(found) - truth) / test.change_scale)


def root_mean_square(values: np.ndarray, axis: int | tuple[int, ...] = 0) -> np.ndarray:
    """Return the root of the mean square along `axis`."""
    return np.sqrt(np.mean(values**2, axis=axis))


def rollout_error(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return (T+1,) rms errors of trajectories (B, T+1, S), in units of the states' standard deviation."""
    return root_mean_square((found - truth) / truth.std(axis=(0, 1)), axis=(0, 2))


def scheme_error(test: TestSet, scheme: Scheme) -> float:
    """Return the one-step error of the physics itself when stepped by `scheme`; infinite if it blows up."""
    states, controls, truth = test.transitions
    runs = test.system.simulate(states, controls[:, None], test.dt, scheme=scheme)
    if not runs.is_alive.all():
        return float("inf")
    return float(root_mean_square((runs.states[:, 1] - truth) / test.change_scale, axis=(0, 1)))


def count_blow_ups(emulator: Emulator, starts: int, steps: int, seed: int = 1) -> int:
    """Return how many of `starts` random starts leave the range of speeds seen in training tenfold.

    Controls are as random and as strong as in training, for `steps` super steps.
    """
    identity, rng = emulator.identity, np.random.default_rng(seed)
    system = load_system(identity.system)
    states = jnp.asarray(system.sample_starts(rng, starts), jnp.float32)
    rate = np.array(emulator.features.plain, dtype=int)
    bound = 10 * np.abs(np.asarray(emulator.domain.high[: len(rate)]))
    fine = np.ones(starts, dtype=bool)
    for _ in range(-(-steps // BLOCK)):
        block = [sample_controls(rng, BLOCK, identity.dt, system.control_limit) for _ in range(starts)]
        path = np.asarray(emulator.rollout(np.where(fine[:, None], states, 0), np.stack(block)))
        fine &= np.isfinite(path).all(axis=(1, 2)) & (np.abs(path[..., rate]) < bound).all(axis=(1, 2))
        states = np.where(fine[:, None], path[:, -1], 0)
    return int((~fine).sum())


def baselines(data: Transitions, test: TestSet) -> dict[str, float]:
    """Return the one-step errors of cheap predictors: nothing changes, speeds stay, ridge regression."""
    states, controls, truth = test.transitions
    change = truth - states
    coast = np.zeros_like(change)
    for position, rate in test.system.structure.rates:
        coast[:, position] = test.dt * states[:, rate]
    weights = _ridge(
        _linear_features(test.system, data.states[:, 0], data.controls[:, 0]),
        data.states[:, 1] - data.states[:, 0],
    )
    guesses = {
        "persistence": np.zeros_like(change),
        "constant velocity": coast,
        "ridge regression": _linear_features(test.system, states, controls) @ weights,
    }
    return {
        name: float(root_mean_square((guess - change) / test.change_scale, axis=(0, 1)))
        for name, guess in guesses.items()
    }


def _linear_features(system: System, states: np.ndarray, controls: np.ndarray) -> np.ndarray:
    angles = states @ np.array(system.structure.angles, dtype=float).T
    plain = states[:, np.array(system.structure.plain, dtype=int)]
    return np.concatenate([np.sin(angles), np.cos(angles), plain, controls, np.ones((len(states), 1))], axis=1)


def _ridge(inputs: np.ndarray, outputs: np.ndarray, strength: float = 1e-6) -> np.ndarray:
    gram = inputs.T @ inputs + strength * len(inputs) * np.eye(inputs.shape[1])
    return np.linalg.solve(gram, inputs.T @ outputs)
