"""The cure of 1998 for shapes that drift: let the true springs pull the emulated body back now and then.

Bounding the shape modes, with which every super step of a deformable body ends, does better at a tenth of the cost
(docs/decisions/0008-bodies-in-few-numbers.md); this is what it is measured against.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.super_step import rollout_latent
from neuroanimator.state.reference_shape import flat_of, points_of
from neuroanimator.systems.deformable.body import Body
from neuroanimator.systems.deformable.mass_spring import BodyState, advance
from neuroanimator.systems.deformable.stability import largest_stable_step

Correction = Callable[[Float[Array, " L"]], Float[Array, " L"]]
"""latent state → the latent state of a body whose springs have relaxed."""

SOFTER = 0.5
"""Ratio of springs' stiffness to the true one while they relax: explicit steps stay stable."""

MORE_DAMPED = 4.0
"""Ratio of springs' damping to the true one while they relax: explicit steps stay stable."""

STEP_SHARE = 0.5
"""A relaxing step is this share of the largest stable one."""


def relaxed(emulator: Emulator, body: Body, steps: int = 3) -> Correction:
    """Return the correction by `steps` explicit steps of the true springs, softened and more damped."""
    soft = replace(
        body, stiffness=SOFTER * body.stiffness, damping=MORE_DAMPED * body.damping, water=None
    )
    dt = STEP_SHARE * largest_stable_step(soft)
    size = 3 * len(body.masses)
    first_mode = emulator.encoding.layout.index("modes").start

    def correct(latent: Float[Array, " L"]) -> Float[Array, " L"]:
        state = emulator.decode(latent)
        activations = state[2 * size :]
        body_state = BodyState(
            points_of(state[:size]), points_of(state[size : 2 * size]), activations
        )
        after = advance(soft, "symplectic", dt, steps, body_state, activations)
        flat = jnp.concatenate([flat_of(after.positions), flat_of(after.velocities), activations])
        fresh = emulator.encode(flat)
        return jnp.concatenate([latent[:first_mode], fresh[first_mode:]])

    return correct


def rollout_relaxed(
    emulator: Emulator,
    latent: Float[Array, " L"],
    controls: Float[Array, "T C"],
    correction: Correction | None,
    every: int = 1,
    *,
    is_bounded: bool = True,
) -> Float[Array, "T L"]:
    """Return `rollout_latent`, corrected after `every` super steps; T must be a multiple of it."""
    if correction is None:
        return rollout_latent(emulator, latent, controls, is_bounded=is_bounded)

    def rollout_and_correct(
        latent: Float[Array, " L"], controls: Float[Array, "K C"]
    ) -> tuple[Array, Array]:
        path = rollout_latent(emulator, latent, controls, is_bounded=is_bounded)
        last = correction(path[-1])
        return last, path.at[-1].set(last)

    pieces = controls.reshape(-1, every, controls.shape[-1])
    _, paths = jax.lax.scan(rollout_and_correct, latent, pieces)
    return paths.reshape(controls.shape[0], -1)
