"""What keeps a deformable body in shape over a hundred thousand super steps.

The seminar paper cures drifting shapes by correcting them now and then. Two ways: `projected` brings
every mode back into the range training showed, at next to no cost; `relaxed` lets the true springs, softened
and more damped, pull the decoded body back for a few small explicit steps, as in 1998.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.emulator.emulator import Emulator, follow
from neuroanimator.emulator.modes import RIGID
from neuroanimator.systems.body import Body, largest_step
from neuroanimator.systems.mass_spring import Motion, advance

Correction = Callable[[Float[Array, " I"]], Float[Array, " I"]]

SOFTER, MORE_DAMPED = 0.5, 4.0
"""Times the stiffness and the damping of the true springs while they relax: explicit steps stay stable."""

SPIN = 3
"""The first plain features are the spin, the next ones the modes."""


def projected(emulator: Emulator) -> Correction:
    """Return the correction that brings spin and modes into the range training showed."""
    modes = emulator.modes
    assert modes is not None
    count = SPIN + modes.count
    low, high = emulator.domain.low[:count], emulator.domain.high[:count]

    def correct(inner: Float[Array, " I"]) -> Float[Array, " I"]:
        start = RIGID - SPIN
        kept = jnp.clip(inner[start : start + count], low, high)
        return jnp.concatenate([inner[:start], kept, inner[start + count :]])

    return correct


def relaxed(emulator: Emulator, body: Body, steps: int = 3) -> Correction:
    """Return the correction by `steps` explicit steps of the true springs, softened and more damped."""
    soft = replace(body, stiffness=SOFTER * body.stiffness, damping=MORE_DAMPED * body.damping, water=None)
    dt = 0.5 * largest_step(soft)
    size = 3 * len(body.masses)

    def correct(inner: Float[Array, " I"]) -> Float[Array, " I"]:
        state = emulator.decode(inner)
        places, speeds = (state[i * size : (i + 1) * size].reshape(-1, 3) for i in range(2))
        motion = Motion(places, speeds, state[2 * size :])
        found = advance(soft, "symplectic", dt, steps, motion, state[2 * size :])
        flat = jnp.concatenate([found.places.ravel(), found.speeds.ravel(), state[2 * size :]])
        fresh = emulator.encode(flat)
        return jnp.concatenate([inner[:RIGID], fresh[RIGID:]])

    return correct


def follow_corrected(
    emulator: Emulator,
    inner: Float[Array, " I"],
    controls: Float[Array, "T C"],
    correction: Correction | None,
    every: int = 1,
) -> Float[Array, "T I"]:
    """Return `follow`, corrected after `every` super steps; T must be a multiple of it."""
    if correction is None:
        return follow(emulator, inner, controls)

    def stretch(inner: Float[Array, " I"], held: Float[Array, "K C"]) -> tuple[Array, Array]:
        path = follow(emulator, inner, held)
        last = correction(path[-1])
        return last, path.at[-1].set(last)

    _, paths = jax.lax.scan(stretch, inner, controls.reshape(-1, every, controls.shape[-1]))
    return paths.reshape(controls.shape[0], -1)
