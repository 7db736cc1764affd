"""Controls found by optimisation: descents through an emulator to random states, many side by side.

They lead to where an emulator promises more than the physics gives, so its errors under them are measured separately.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.super_step import rollout_latent

SIDE_BY_SIDE = 256
"""Number of descents at a time."""

ITERATIONS = 20
"""Number of backward sweeps of each descent, as for a controller (1998, and `control.descent`)."""

RATES = (0.05, 0.5)
"""Smallest and largest learning rate of Adam: from half-finished to finished descents."""

EFFORTS = (1e-3, 1.0)
"""Smallest and largest weight of the mean square of controls, over their bounds."""

TO_STATE_SHARE = 0.6
"""Share of descents that should reach a state; the others should go as far as possible in its direction."""

FIRST_SPREAD = 0.1
"""Standard deviation of initial guesses, over the bounds."""

ADAM = optax.scale_by_adam(b1=0.9, b2=0.99, eps=1e-9)

LEAST_WAY = 1e-6
"""Minimum mean square distance to a state [usual changes], as some begin at their target."""


def optimised_controls(
    emulator: Emulator,
    starts: Float[np.ndarray, "B S"],
    targets: Float[np.ndarray, "B S"],
    steps: int,
    seed: int,
) -> Float[np.ndarray, "B {steps} C"]:
    """Return the controls of descents from `starts` (B, S) to `targets` (B, S) or beyond, within the bounds."""
    rng = np.random.default_rng([seed, ITERATIONS])
    count = len(starts)
    rates = np.exp(rng.uniform(np.log(RATES[0]), np.log(RATES[1]), count))
    efforts = np.exp(rng.uniform(np.log(EFFORTS[0]), np.log(EFFORTS[1]), count))
    goes_beyond = rng.random(count) >= TO_STATE_SHARE
    guesses = rng.normal(size=(count, steps, emulator.control.size)) * FIRST_SPREAD
    begin = np.asarray(emulator.encode(np.asarray(starts, float)))
    aims = np.asarray(emulator.encode(np.asarray(targets, float)))
    columns = (guesses, begin, aims, rates, efforts, goes_beyond)
    found = []
    for first in range(0, count, SIDE_BY_SIDE):
        # The last rows are repeated to fill up, so that one compiled program does for all.
        rows = np.arange(first, first + SIDE_BY_SIDE).clip(max=count - 1)
        found.append(_descents(emulator, *(as_jax(column[rows]) for column in columns)))
    shares = np.concatenate([np.asarray(some, float) for some in found])[:count]
    bounds = emulator.bounds
    return bounds.clip(bounds.middle + shares * bounds.half)


@eqx.filter_jit
def _descents(
    emulator: Emulator,
    guesses: Float[Array, "B T C"],
    starts: Float[Array, "B I"],
    aims: Float[Array, "B I"],
    rates: Float[Array, " B"],
    efforts: Float[Array, " B"],
    goes_beyond: Float[Array, " B"],
) -> Float[Array, "B T C"]:
    """Return the results of descents by Adam, over the control bounds."""

    def one(
        guess: Array, start: Array, aim: Array, rate: Array, effort: Array, beyond: Array
    ) -> Array:
        def slope(numbers: Array) -> Array:
            found = jax.grad(_cost)(numbers, emulator, start, aim, effort, beyond)
            return jnp.nan_to_num(found, nan=0.0, posinf=0.0, neginf=0.0)

        def iterate(carry: tuple[Array, Any], _: None) -> tuple[tuple[Array, Any], None]:
            numbers, moments = carry
            update, moments = ADAM.update(slope(numbers), moments)
            return (numbers - rate * jnp.asarray(update), moments), None

        (last, _), _ = jax.lax.scan(iterate, (guess, ADAM.init(guess)), length=ITERATIONS)
        return jnp.tanh(last)

    return jax.vmap(one)(guesses, starts, aims, rates, efforts, goes_beyond)


def _cost(
    numbers: Float[Array, "T C"],
    emulator: Emulator,
    start: Float[Array, " I"],
    aim: Float[Array, " I"],
    effort: Float[Array, ""],
    goes_beyond: Float[Array, ""],
) -> Float[Array, ""]:
    """Return the final distance from `aim`, over the initial one; or the missing distance in its direction."""
    shares = jnp.tanh(numbers)
    bounds = emulator.bounds
    controls = jnp.asarray(bounds.middle) + shares * jnp.asarray(bounds.half)
    held = emulator.encode_control(jnp.asarray(controls, jnp.float32))
    last = rollout_latent(emulator, start, held, unroll=1)[-1]
    unit = jnp.where(emulator.normaliser.unit > 0, emulator.normaliser.unit, jnp.inf)
    way = emulator.frame.difference(start, aim) / unit
    squared_way = jnp.maximum(jnp.mean(way**2), LEAST_WAY)
    missed = jnp.mean((emulator.frame.difference(aim, last) / unit) ** 2) / squared_way
    come = jnp.mean(emulator.frame.difference(start, last) / unit * way) / squared_way
    return jnp.where(goes_beyond > 0, -come, missed) + effort * jnp.mean(shares**2)
