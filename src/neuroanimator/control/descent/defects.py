"""An emulator held to a known motion of the physics: what it gets wrong there is added to every super step.

Where the emulated motion bends away, the descent would follow it. With the defects of a replayed motion
added, the emulator gives exactly that motion for its controls, and still says how it changes with them.
"""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.state.body_frame import Frame


def still_frame(emulator: Emulator) -> Frame:
    """Return the frame in which inner states are compared, without coasting."""
    return replace(emulator.frame, dt=0.0)


def no_defects(emulator: Emulator, steps: int) -> Float[Array, "T V"]:
    """Return zeros: the emulator as it is."""
    return as_jax(np.zeros((steps, emulator.normaliser.change_scale.shape[0])))


@eqx.filter_jit
def find_defects(
    emulator: Emulator, states: Float[Array, "T+1 S"], controls: Float[Array, "T C"]
) -> Float[Array, "T V"]:
    """Return what must be added to every super step for the emulator to go through `states` of the physics."""
    latent, mixed = emulator.encode(states), emulator.encode_control(controls)
    leapt = jax.vmap(emulator.step_latent)(latent[:-1], mixed)
    return still_frame(emulator).difference(leapt, latent[1:])


def advance_corrected(
    emulator: Emulator,
    latent: Float[Array, " I"],
    control: Float[Array, " C"],
    defect: Float[Array, " V"],
) -> Float[Array, " I"]:
    """Return `Emulator.step_latent` with the defect added."""
    return still_frame(emulator).apply(emulator.step_latent(latent, control), defect)


def follow_corrected(
    emulator: Emulator,
    latent: Float[Array, " I"],
    controls: Float[Array, "T C"],
    defects: Float[Array, "T V"],
) -> Float[Array, "T+1 I"]:
    """Return the trajectory from `latent`, it included, with the defects added; in the numbers of `Emulator.encode`.

    Not unrolled, unlike `rollout_latent`: its derivatives compile in a third of the time and run as fast.
    """

    def one(latent: Array, given: tuple[Array, Array]) -> tuple[Array, Array]:
        following = advance_corrected(emulator, latent, *given)
        return following, following

    inputs = emulator.encode_control(controls), defects
    return jnp.concatenate([latent[None], jax.lax.scan(one, latent, inputs)[1]])


def defects_of(emulator: Emulator, states: np.ndarray, controls: np.ndarray) -> Float[Array, "T V"]:
    """Return `find_defects` for NumPy arrays."""
    return find_defects(emulator, as_jax(states), as_jax(controls))
