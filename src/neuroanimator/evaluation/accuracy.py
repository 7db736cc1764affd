"""How far the emulator is from the physics, in one step and over time; and how far the physics is from itself."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.cores import core_count
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.normaliser import MIN_CHANGE
from neuroanimator.evaluation.held_out import HeldOut
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.system import Runs, Scheme

LOST = 1e3
"""Magnitude of error that stands for larger ones, and for those that are no finite number."""


def root_mean_square(
    values: Float[np.ndarray, " ..."], axis: int | tuple[int, ...] = 0
) -> Float[np.ndarray, " ..."]:
    """Return the root of the mean square along `axis`."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=axis)))


def bounded(errors: Float[np.ndarray, " ..."]) -> Float[np.ndarray, " ..."]:
    """Return `errors` between ±`LOST`, which stands for what is not finite, too."""
    return np.clip(np.nan_to_num(errors, nan=LOST), -LOST, LOST)


def step_errors(relative: Float[np.ndarray, "N M"]) -> Float[np.ndarray, " N"]:
    """Return one number for each super step: the root mean square over what moves, at most `LOST`."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bounded(root_mean_square(relative, axis=1))


def one_step_error(emulator: Emulator, test: HeldOut) -> Float[np.ndarray, " M"]:
    """Return rms one-step errors of what moves, over the standard deviation of the change."""
    states, controls, truth = test.transitions
    emulated = emulator.rollout(states, controls[:, None], may_diverge=True)[:, 1]
    errors = test.frame.difference(truth, np.asarray(emulated, float))
    return root_mean_square(test.relative(errors))


def rollout_error(
    frame: Frame, emulated: Float[np.ndarray, "B T S"], truth: Float[np.ndarray, "B T S"]
) -> Float[np.ndarray, " T"]:
    """Return rms errors of trajectories at each moment, over the rms distance the truth gets from its start.

    What gets nowhere is left out.
    """
    reach = root_mean_square(frame.difference(truth[:, :1], truth), axis=(0, 1))
    moves = reach >= MIN_CHANGE
    errors = frame.difference(truth, emulated)[..., moves] / reach[moves]
    return root_mean_square(errors, axis=(0, 2))


def scheme_error(test: HeldOut, scheme: Scheme) -> float:
    """Return the one-step error of the physics itself when stepped by `scheme`; infinite if it diverges."""
    states, controls, _ = test.transitions
    threads = core_count()
    runs = test.system.simulate(states, controls[:, None], test.dt, scheme=scheme, threads=threads)
    return runs_error(test, runs)


def runs_error(test: HeldOut, runs: Runs) -> float:
    """Return the error of `runs` that took the test's super steps, one each; infinite if one diverged."""
    if runs.has_diverged.any():
        return float("inf")
    errors = test.frame.difference(test.transitions.next_states, runs.states[:, 1])
    return float(root_mean_square(test.relative(errors), axis=(0, 1)))


def self_divergence(test: HeldOut) -> Float[np.ndarray, " T"]:
    """Return how far the physics at its own step strays from fine physics."""
    system = test.system
    runs = system.simulate(test.states[:, 0], test.controls, test.dt, scheme=system.scheme)
    is_whole = ~runs.has_diverged
    return rollout_error(test.frame, runs.states[is_whole], test.states[is_whole])
