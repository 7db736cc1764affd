"""One-step errors of a trained emulator on held-out runs, and those of cheap predictors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.normaliser import varies
from neuroanimator.emulator.super_step import rollout_latent
from neuroanimator.emulator.verdict import ValidationErrors, WindowErrors
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.structure import Structure

NOISE_SEED = 3
"""Seed of the noise added to states."""

MAX_WINDOWS = 1024
"""Maximum number of windows whose ends are measured: their nodes take memory."""

MAX_NODES = 256
"""Maximum number of nodes measured, spread over the body."""

LARGEST_ERROR = 1e6
"""Maximum error, which also stands for non-finite ones: files hold finite numbers."""


def validation_errors(
    emulator: Emulator,
    states: Float[np.ndarray, "N T I"],
    controls: Float[np.ndarray, "N H C"],
    noise: Float[np.ndarray, " S"] | None = None,
) -> ValidationErrors:
    """Return the errors of the first super steps of windows of T = H + 1 latent states and the latent controls between.

    `noise` is the standard deviation of the noise in recorded states, if it is known.
    """
    starts = states[:, 0]
    ends = states[:, 1]
    held = controls[:, 0]
    frame = replace(emulator.frame, dt=emulator.dt)
    unit = np.asarray(emulator.normaliser.unit)
    moves = unit > 0
    rates = emulator.rates if emulator.encoding.is_identity else ()

    def size(differences: Float[np.ndarray, "N V"]) -> Float[np.ndarray, ""]:
        return _bounded(np.sqrt(np.mean((differences[:, moves] / unit[moves]) ** 2)))

    def following(moved: Float[np.ndarray, "N I"]) -> Float[np.ndarray, "N I"]:
        return np.asarray(_following(emulator, as_jax(moved), as_jax(held)))

    by_noise = np.zeros((), np.float32)
    if noise is not None:
        parts = noise_differences(frame, following, starts, ends, noise)
        by_noise = np.hypot(*(size(part) for part in parts))
    return ValidationErrors(
        emulator=size(frame.difference(ends, following(starts))),
        no_change=size(frame.difference(ends, starts)),
        constant_velocity=size(frame.difference(ends, coasted(frame, rates, starts))),
        noise=by_noise,
        window=window_errors(emulator, states, controls),
    )


def window_errors(
    emulator: Emulator,
    states: Float[np.ndarray, "N T I"],
    controls: Float[np.ndarray, "N H C"],
) -> WindowErrors | None:
    """Return the errors of a soft body at the ends of windows of T = H + 1 latent states; None for other bodies."""
    shapes = emulator.skeleton.shapes
    if shapes is None:
        return None
    chosen = np.linspace(0, len(states) - 1, min(len(states), MAX_WINDOWS)).round().astype(int)
    count = len(shapes.mean)
    nodes = np.linspace(0, count - 1, min(count, MAX_NODES)).round().astype(int)
    size = np.ptp(shapes.mean, axis=0).max()
    starts = states[chosen, 0]
    driven = controls[chosen]
    frame = replace(emulator.frame, dt=emulator.dt)
    kept = starts
    no_change = np.zeros((len(starts), frame.change_size(starts.shape[-1])))
    for step in range(driven.shape[1]):
        kept = frame.apply(kept, no_change, driven[:, step])
    emulated = np.asarray(_ends(emulator, as_jax(starts), as_jax(driven)))
    truth = shapes.decode(emulator.decode(states[chosen, -1]), nodes)

    def share(latent: Float[np.ndarray, "N I"]) -> Float[np.ndarray, ""]:
        away = shapes.decode(emulator.decode(latent), nodes) - truth
        return _bounded(np.sqrt((away**2).sum(axis=-1).mean()) / size)

    seconds = np.asarray(driven.shape[1] * emulator.dt, np.float32)
    return WindowErrors(seconds, share(emulated), share(kept))


def _bounded(error: np.floating) -> Float[np.ndarray, ""]:
    """Return a finite error, as a file holds it."""
    return np.asarray(np.nan_to_num(np.fmin(error, LARGEST_ERROR)), np.float32)


@eqx.filter_jit
def _ends(
    emulator: Emulator, states: Float[Array, "N I"], controls: Float[Array, "N H C"]
) -> Float[Array, "N I"]:
    """Return the latent states at the ends of windows."""

    def end(state: Float[Array, " I"], held: Float[Array, "H C"]) -> Float[Array, " I"]:
        return rollout_latent(emulator, state, held)[-1]

    return jax.vmap(end)(states, controls)


@eqx.filter_jit
def _following(
    emulator: Emulator, states: Float[Array, "N I"], controls: Float[Array, "N C"]
) -> Float[Array, "N I"]:
    return jax.vmap(emulator.step_latent_unbounded)(states, controls)


def usual_change(
    structure: Structure, states: Float[np.ndarray, "B F S"]
) -> Float[np.ndarray, " V"]:
    """Return the standard deviation of each number's change in a super step; 0 where it does not vary."""
    changes = Frame.of(structure, 0.0).difference(states[:, :-1], states[:, 1:])
    deviation = changes.std(axis=(0, 1))
    is_varied = varies(changes.mean(axis=(0, 1)), deviation)
    return structure.common_scale(np.where(is_varied, deviation, 0))


def coasted(
    frame: Frame, rates: Sequence[tuple[int, int]], states: Float[np.ndarray, "N S"]
) -> Float[np.ndarray, "N S"]:
    """Return the states after the `frame`'s super step if all velocities stayed; `rates` as in `EmulatorSpec`."""
    coasting = np.array(states)
    for position, rate in rates:
        coasting[:, position] += frame.dt * states[:, rate]
    if frame.segments:  # the frame coasts the root, its plain entries coast as above
        no_change = np.zeros((len(states), frame.change_size(states.shape[-1])))
        moved = frame.apply(states, no_change)
        coasting = np.where(moved == states, coasting, moved)
    return coasting


def noise_differences(
    frame: Frame,
    following: Callable[[Float[np.ndarray, "N S"]], Float[np.ndarray, "N S"]],
    states: Float[np.ndarray, "N S"],
    truth: Float[np.ndarray, "N S"],
    noise: Float[np.ndarray, " S"],
) -> tuple[Float[np.ndarray, "N V"], Float[np.ndarray, "N V"]]:
    """Return the differences due to `noise`: in the states following `states`, and in the `truth` they are compared with."""
    rng = np.random.default_rng(NOISE_SEED)
    at_start = rng.normal(size=states.shape) * noise
    at_end = rng.normal(size=states.shape) * noise
    carried = frame.difference(following(states), following(states + at_start))
    return carried, frame.difference(truth, truth + at_end)
