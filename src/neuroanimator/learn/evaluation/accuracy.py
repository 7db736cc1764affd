"""Errors of emulators in one step and over time, of the physics itself, and of noise in recordings."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import Float

from neuroanimator.codegen.cores import core_count
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.normaliser import MIN_CHANGE
from neuroanimator.learn.evaluation.held_out import HeldOut
from neuroanimator.learn.training.validation import noise_differences
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.system import Runs, Scheme, System

LOST = 1e3
"""Magnitude of error that stands for larger and non-finite ones."""


def root_mean_square(
    values: Float[np.ndarray, " ..."], axis: int | tuple[int, ...] = 0
) -> Float[np.ndarray, " ..."]:
    """Return the root of the mean square along `axis`."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=axis)))


def bounded(errors: Float[np.ndarray, " ..."]) -> Float[np.ndarray, " ..."]:
    """Return `errors` clipped to ±`LOST`, which stands for non-finite ones, too."""
    return np.clip(np.nan_to_num(errors, nan=LOST), -LOST, LOST)


def step_errors(relative: Float[np.ndarray, "N M"]) -> Float[np.ndarray, " N"]:
    """Return the error of each super step: the root mean square over what moves, at most `LOST`."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bounded(root_mean_square(relative, axis=1))


def emulate(
    emulator: Emulator, starts: Float[np.ndarray, "B S"], controls: Float[np.ndarray, "B T C"]
) -> Float[np.ndarray, "B F S"]:
    """Return the emulator's trajectories (B, T+1, S), including those that become non-finite."""
    return np.asarray(emulator.rollout(starts, controls, may_diverge=True), float)


def next_states(
    emulator: Emulator, states: Float[np.ndarray, "N S"], controls: Float[np.ndarray, "N C"]
) -> Float[np.ndarray, "N S"]:
    """Return the states one super step later by the emulator."""
    return emulate(emulator, states, controls[:, None])[:, 1]


def step_differences(emulator: Emulator, test: HeldOut) -> Float[np.ndarray, "N V"]:
    """Return the errors in the test's super steps, one by one, in units of the state."""
    states, controls, truth = test.transitions
    return test.frame.difference(truth, next_states(emulator, states, controls))


def one_step_error(emulator: Emulator, test: HeldOut) -> Float[np.ndarray, " M"]:
    """Return rms one-step errors of what moves, over the standard deviation of the change."""
    return root_mean_square(test.relative(step_differences(emulator, test)))


def rollout_error(
    frame: Frame, emulated: Float[np.ndarray, "B T S"], truth: Float[np.ndarray, "B T S"]
) -> Float[np.ndarray, " T"]:
    """Return rms errors of trajectories at each moment, over the truth's rms distance from its start.

    What stays at its start is left out.
    """
    reach = root_mean_square(frame.difference(truth[:, :1], truth), axis=(0, 1))
    moves = reach >= MIN_CHANGE
    errors = frame.difference(truth, emulated)[..., moves] / reach[moves]
    return root_mean_square(errors, axis=(0, 2))


def error_after(errors: Float[np.ndarray, " T"], dt: float, seconds: float) -> float:
    """Return the rollout error after `seconds`, at the nearest super step but the first; `errors` are `dt` [s] apart."""
    step = max(1, round(seconds / dt))
    return float(errors[min(step, len(errors) - 1)])


def unseen_errors(emulator: Emulator, test: HeldOut, seconds: float) -> tuple[float, float]:
    """Return (one-step error, rollout error after `seconds`) on a test; infinite instead of NaN."""
    emulated = emulate(emulator, test.states[:, 0], test.controls)
    errors = rollout_error(test.frame, emulated, test.states)
    error = np.nan_to_num(error_after(errors, emulator.dt, seconds), nan=np.inf)
    return float(root_mean_square(one_step_error(emulator, test))), float(error)


def schemes_of(
    system: System, dt: float, integrators: Sequence[str], divisions: Sequence[int]
) -> set[Scheme]:
    """Return the ways to step a system through `dt` [s]; the reference is among them, as it has no error."""
    schemes = {Scheme(integrator, dt / parts) for integrator in integrators for parts in divisions}
    return schemes | {system.scheme, system.truth, system.fine}


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
    return guess_error(test, runs.states[:, 1])


def guess_error(test: HeldOut, guess: Float[np.ndarray, "N S"]) -> float:
    """Return the error of a `guess` at the states after the test's super steps."""
    errors = test.frame.difference(test.transitions.next_states, guess)
    return float(root_mean_square(test.relative(errors), axis=(0, 1)))


def self_divergence(test: HeldOut) -> Float[np.ndarray, " T"]:
    """Return the rollout error of the physics at its own step against fine physics."""
    system = test.system
    threads = core_count()
    starts = test.states[:, 0]
    runs = system.simulate(starts, test.controls, test.dt, scheme=system.scheme, threads=threads)
    is_whole = ~runs.has_diverged
    return rollout_error(test.frame, runs.states[is_whole], test.states[is_whole])


def noise_error(emulator: Emulator, test: HeldOut) -> Float[np.ndarray, " M"] | None:
    """Return the rms one-step error that noise alone makes in what moves, over the standard deviation of the change.

    A super step begins at a noisy state, whose noise the motion carries on, and is compared with another noisy state:
    both count, and are independent. The noise carried on is measured by adding noise of the same size to the emulator's input.
    None where the noise is unknown: for a simulated system, which has none, and for datasets of older versions.
    """
    if test.noise is None:
        return None
    states, controls, truth = test.transitions
    following = partial(next_states, emulator, controls=controls)
    carried, seen = noise_differences(test.frame, following, states, truth, test.noise)
    return np.hypot(*(root_mean_square(test.relative(part)) for part in (carried, seen)))
