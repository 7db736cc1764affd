"""Defects of multiple shooting: what an emulator gets wrong along a known motion of the physics, added to every super step.

Where the emulated motion bends away from the physics, a descent would follow it. With the defects of a replayed motion
added, the emulator gives exactly that motion for its controls, and still says how it changes with them.
"""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.backend import backend
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.body_frame import Frame


def still_frame(emulator: Emulator) -> Frame:
    """Return the frame in which latent states are compared, without coasting."""
    return replace(emulator.frame, dt=0.0)


def no_defects(emulator: Emulator, steps: int) -> Float[np.ndarray, "T V"]:
    """Return zeros: the emulator as it is."""
    changes = emulator.normaliser.change_scale.shape[0]
    return np.zeros((steps, changes), np.float32)


def find_defects(
    emulator: Emulator, states: ArrayLike, controls: ArrayLike
) -> Float[AnyArray, "T V"]:
    """Return what must be added to every super step for the emulator to go through `states` of the physics.

    `states` (T+1, S) are those that `controls` (T, C) led to. Computed by the `backend`.
    """
    link = None
    if backend() != "jax":
        # It is written in terms of this module.
        from neuroanimator.control.descent.chain import link_of

        link = link_of(emulator)
    if link is None:
        return _find_defects(emulator, as_jax(states), as_jax(controls))
    latent = np.ascontiguousarray(emulator.encode(np.asarray(states, np.float32)), np.float32)
    held = np.asarray(controls, np.float32)
    predicted = link.of_rows(np.concatenate([latent[:-1], held], axis=1))
    return still_frame(emulator).difference(predicted, latent[1:])


@eqx.filter_jit
def _find_defects(
    emulator: Emulator, states: Float[Array, "T1 S"], controls: Float[Array, "T C"]
) -> Float[Array, "T V"]:
    latent = emulator.encode(states)
    latent_controls = emulator.encode_control(controls)
    predicted = jax.vmap(emulator.step_latent)(latent[:-1], latent_controls)
    return still_frame(emulator).difference(predicted, latent[1:])


def step_with_defect(
    emulator: Emulator,
    latent: Float[Array, " I"],
    control: Float[Array, " C"],
    defect: Float[Array, " V"],
) -> Float[Array, " I"]:
    """Return the latent state one super step later: `Emulator.step_latent` with the defect added."""
    return still_frame(emulator).apply(emulator.step_latent(latent, control), defect)


def rollout_with_defects(
    emulator: Emulator,
    latent: Float[Array, " I"],
    controls: Float[Array, "T C"],
    defects: Float[Array, "T V"],
) -> Float[Array, "T+1 I"]:
    """Return the trajectory from `latent`, it included, with the defects added; in latent states.

    Not unrolled, unlike `Emulator.rollout`: its derivatives compile in a third of the time and run as fast.
    """

    def step(latent: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        control, defect = inputs
        following = step_with_defect(emulator, latent, control, defect)
        return following, following

    inputs = (emulator.encode_control(controls), defects)
    _, trajectory = jax.lax.scan(step, latent, inputs)
    return jnp.concatenate([latent[None], trajectory])
