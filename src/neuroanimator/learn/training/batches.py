"""Batches of windows for the updates."""

from __future__ import annotations

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.training.config import UPDATES_PER_CHUNK
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.rotation import (
    conjugate,
    facing,
    multiply,
    rotate,
    rotate_in_plane,
)
from neuroanimator.state.structure import Structure
from neuroanimator.state.symmetry import Symmetry

Windows = tuple[Float[Array, "N H S"], Float[Array, "N T C"]]
"""States of N windows, and the controls between them."""

RARE = 0.1
"""Share of all windows that count as rare."""


def rare_rows(emulator: Emulator, data: Transitions) -> Int[np.ndarray, " M"]:
    """Return the tenth of the rows of `data` with the most unusual change in any super step, in any of its numbers.

    A number is unusual by its distance from the mean, in standard deviations.
    """
    normaliser = emulator.normaliser
    scale = np.asarray(normaliser.change_scale)
    moves = scale > 0
    unusual = np.zeros(len(data.states))
    for before, after in pairwise(np.moveaxis(data.states, 1, 0)):
        deviation = emulator.frame.remainder(before, after) - np.asarray(normaliser.change_mean)
        deviation = np.abs(deviation[:, moves] / scale[moves])
        unusual = np.maximum(unusual, deviation.max(axis=1))
    count = max(1, round(RARE * len(unusual)))
    return np.sort(np.argpartition(unusual, -count)[-count:]).astype(np.int32)


def draw_batches(
    key: PRNGKeyArray,
    size: int,
    rows: int | Int[Array, ""],
    rare: Int[Array, " M"],
    rare_share: float,
) -> tuple[Int[Array, "U B"], Float[Array, " N"] | None]:
    """Return (rows of each update's batch, weight of every row).

    With a `rare_share`, that part of a batch comes from the `rare` rows, and weights compensate for it
    (importance sampling): the mean of the loss stays the same, and its noise falls if most of the error
    comes from few rows.
    """
    batches = jax.random.randint(key, (UPDATES_PER_CHUNK, size), 0, rows)
    from_rare = round(size * rare_share)
    if not from_rare:
        return batches, None
    drawn = jax.random.randint(
        jax.random.fold_in(key, 1), (UPDATES_PER_CHUNK, from_rare), 0, rare.shape[0]
    )
    share = from_rare / size
    density = jnp.full(rows, 1 - share).at[rare].add(share * rows / rare.shape[0])
    return jnp.concatenate([batches[:, from_rare:], rare[drawn]], axis=1), 1 / density


def draw_first_steps(
    key: PRNGKeyArray, shape: tuple[int, ...], steps: int, unroll: int
) -> Int[Array, "U B"]:
    """Return where in a window of `steps` super steps each example of `unroll` of them begins.

    Drawn for all updates at once: random numbers drawn within the loop took a tenth of a pendulum's update.
    """
    return jax.random.randint(jax.random.fold_in(key, 2), shape, 0, steps - unroll + 1)


def parts_of(
    states: Float[Array, "N T S"],
    controls: Float[Array, "N H C"],
    rows: Int[Array, " B"],
    first: Int[Array, " B"],
    unroll: int,
) -> tuple[Float[Array, "B F S"], Float[Array, "B U C"]]:
    """Return `unroll` super steps of each window in `rows`, from number `first` on: more examples of the same physics."""
    steps = first[:, None] + jnp.arange(unroll + 1)
    return states[rows[:, None], steps], controls[rows[:, None], steps[:, :-1]]


def seen_by(
    symmetries: tuple[Symmetry, ...],
    key: PRNGKeyArray,
    states: Float[Array, "N H S"],
    controls: Float[Array, "N T C"],
) -> Windows:
    """Return the windows, each unchanged or under one of the `symmetries`, drawn at random: examples for free."""
    rows = jnp.arange(states.shape[0])
    drawn = jax.random.randint(key, rows.shape, 0, 1 + len(symmetries))
    views = jnp.stack([states, *(symmetry.state(states) for symmetry in symmetries)])
    driven = jnp.stack([controls, *(symmetry.control(controls) for symmetry in symmetries)])
    return views[drawn, rows], driven[drawn, rows]


def folded(
    structure: Structure,
    frame: Frame,
    key: PRNGKeyArray,
    states: Float[Array, "N H S"],
    controls: Float[Array, "N T C"],
) -> Windows:
    """Return the windows with each body turned at random by its rotational symmetry: examples for free."""
    part = jax.random.randint(key, (states.shape[0], 1), 0, structure.symmetry_order)
    angle = 2 * jnp.pi * part / structure.symmetry_order
    return turned_windows(structure, frame, angle, states, controls)


def turned_windows(
    structure: Structure,
    frame: Frame,
    angle: Float[Array, "N 1"],
    states: Float[Array, "N H S"],
    controls: Float[Array, "N T C"],
) -> Windows:
    """Return the windows with the axes of each root turned by `angle` (N, 1) [rad] about its own Z."""
    first_of_orientation, first_of_velocity = frame.orientations[0]
    orientation = slice(first_of_orientation, first_of_orientation + 4)
    angular_velocity = slice(first_of_velocity, first_of_velocity + 3)
    turning = facing(angle)
    quaternions = multiply(states[..., orientation], conjugate(turning))
    states = states.at[..., orientation].set(quaternions)
    velocities = rotate(turning, states[..., angular_velocity])
    states = states.at[..., angular_velocity].set(velocities)
    for pair in structure.symmetry_controls:
        turned = rotate_in_plane(angle[..., None], controls[..., list(pair)])
        controls = controls.at[..., list(pair)].set(turned)
    return states, controls
