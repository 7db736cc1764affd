"""The cure of 1998 for shapes that drift: let the true springs pull the emulated body back now and then.

`Modes.bounded`, which every super step of a deformable body ends with, does better at a tenth of the price
(docs/decisions/0008-bodies-in-few-numbers.md); this is what it is measured against.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.emulator.emulator import Emulator, rollout_latent
from neuroanimator.emulator.shape_modes import RIGID
from neuroanimator.state.reference_shape import flat_of, points_of
from neuroanimator.systems.deformable.body import Body
from neuroanimator.systems.deformable.mass_spring import BodyState, advance
from neuroanimator.systems.deformable.stability import largest_stable_step

Correction = Callable[[Float[Array, " I"]], Float[Array, " I"]]

SOFTER, MORE_DAMPED = 0.5, 4.0
"""Times the stiffness and the damping of the true springs while they relax: explicit steps stay stable."""


def relaxed(emulator: Emulator, body: Body, steps: int = 3) -> Correction:
    """Return the correction by `steps` explicit steps of the true springs, softened and more damped."""
    soft = replace(
        body, stiffness=SOFTER * body.stiffness, damping=MORE_DAMPED * body.damping, water=None
    )
    dt = 0.5 * largest_stable_step(soft)
    size = 3 * len(body.masses)

    def correct(latent: Float[Array, " I"]) -> Float[Array, " I"]:
        state = emulator.decode(latent)
        activations = state[2 * size :]
        motion = BodyState(points_of(state[:size]), points_of(state[size : 2 * size]), activations)
        found = advance(soft, "symplectic", dt, steps, motion, activations)
        flat = jnp.concatenate([flat_of(found.positions), flat_of(found.velocities), activations])
        fresh = emulator.encode(flat)
        return jnp.concatenate([latent[:RIGID], fresh[RIGID:]])

    return correct


def follow_corrected(
    emulator: Emulator,
    latent: Float[Array, " I"],
    controls: Float[Array, "T C"],
    correction: Correction | None,
    every: int = 1,
    *,
    is_bounded: bool = True,
) -> Float[Array, "T I"]:
    """Return `follow`, corrected after `every` super steps; T must be a multiple of it."""
    if correction is None:
        return rollout_latent(emulator, latent, controls, is_bounded=is_bounded)

    def stretch(latent: Float[Array, " I"], held: Float[Array, "K C"]) -> tuple[Array, Array]:
        path = rollout_latent(emulator, latent, held, is_bounded=is_bounded)
        last = correction(path[-1])
        return last, path.at[-1].set(last)

    _, paths = jax.lax.scan(stretch, latent, controls.reshape(-1, every, controls.shape[-1]))
    return paths.reshape(controls.shape[0], -1)
