"""The training loss and its reported errors."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.super_step import rollout_latent


def squared_error(
    emulator: Emulator,
    states: Float[Array, "N T I"],
    controls: Float[Array, "N H C"],
    weights: Float[Array, " N"] | None = None,
) -> Float[Array, "H V"]:
    """Return the mean squared error after 1..H super steps, in units of the change's standard deviation.

    `states` are windows of T = H + 1 latent states, `controls` the latent controls between them. `weights`
    of rows should have a mean of one. Numbers that never move have no error.
    """
    unit = emulator.normaliser.unit
    rollout = partial(rollout_latent, emulator, is_bounded=False)
    predicted = jax.vmap(rollout)(states[:, 0], controls)
    difference = emulator.frame.difference(states[:, 1:], predicted)
    error = difference / jnp.where(unit > 0, unit, jnp.inf)
    squares = error**2
    if weights is not None:
        squares = squares * weights[:, None, None]
    return jnp.mean(squares, axis=0)


def calm_weights(
    emulator: Emulator, states: Float[Array, "N T I"], calm: float
) -> Float[Array, " N"]:
    """Return weights 1 / (`calm` + m) of windows, of mean one, where m is the mean square change in their first super step.

    In units of the change's standard deviation. So errors count relative to the change: a body that balances in a slow walk
    changes ten times less than one that runs, and falls by errors ten times smaller.
    """
    unit = emulator.normaliser.unit
    change = emulator.frame.difference(states[:, 1], states[:, 0])
    moved = jnp.mean((change / jnp.where(unit > 0, unit, jnp.inf)) ** 2, axis=1)
    weights = 1 / (calm + moved)
    return weights / weights.mean()


STRAY = 4.0
"""Mean square error above which a window has strayed, in units of the change's variance."""


def unrolled_loss(
    emulator: Emulator,
    states: Float[Array, "N T I"],
    controls: Float[Array, "N H C"],
    weights: Float[Array, " N"] | None = None,
    growth: float = 2.0,
) -> Float[Array, ""]:
    """Return the squared error averaged over the super steps k of the windows, weighted by k to the minus `growth`.

    For H = 1 this is the seminar paper's eq. 5; a longer window teaches the network to take its own output as input, as
    in use. Errors mostly grow as k, so that a growth of 2 weighs every step alike.
    """
    decay = jnp.arange(1, controls.shape[1] + 1) ** -growth
    by_step = jnp.mean(squared_error(emulator, states, controls, weights), axis=1)
    return by_step @ (decay / decay.sum())


def robust_loss(
    emulator: Emulator,
    states: Float[Array, "N T I"],
    controls: Float[Array, "N H C"],
    growth: float,
) -> Float[Array, ""]:
    """Return `unrolled_loss` with smaller weights of windows that have strayed: c log(1 + e/c) of each window's error e.

    A body on its edge falls either way, unpredictably; a few such windows would dominate the loss.
    """
    error = jax.vmap(
        lambda path, held: unrolled_loss(emulator, path[None], held[None], None, growth)
    )
    return jnp.mean(STRAY * jnp.log1p(error(states, controls) / STRAY))
