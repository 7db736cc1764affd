"""What an emulator makes of many short runs: compiled once, whatever its weights are."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator, step
from neuroanimator.evaluation.held_out import HeldOut
from neuroanimator.evaluation.weak_spots import step_errors
from neuroanimator.jax_later import Array, filter_jit, jax, jnp
from neuroanimator.state.arrays import as_rows

HIGHEST = 1e6
"""A score that is higher, or no number, counts as this."""


def trust_along(
    emulator: Emulator, starts: Float[np.ndarray, "N S"], controls: Float[np.ndarray, "N T C"]
) -> Float[np.ndarray, "N T"]:
    """Return the score of each super step of emulated runs from `starts` under `controls`; no physics is asked."""
    scores = np.asarray(_scores_along(emulator, as_jax(starts), as_jax(controls)), float)
    return np.clip(np.nan_to_num(scores, nan=HIGHEST), 0, HIGHEST)


def errors_on(emulator: Emulator, test: HeldOut) -> Float[np.ndarray, "B T"]:
    """Return the one-step error of each super step of the test's runs, in standard deviations of the usual change."""
    count, steps, _ = test.controls.shape
    states = as_rows(test.states[:, :-1])
    controls = as_rows(test.controls)
    ends = as_rows(test.states[:, 1:])
    emulated = _following(emulator, as_jax(states), as_jax(controls))
    differences = test.frame.difference(ends, np.asarray(emulated, float))
    return step_errors(test.relative(differences)).reshape(count, steps)


@filter_jit
def _following(
    emulator: Emulator, states: Float[Array, "M S"], controls: Float[Array, "M C"]
) -> Float[Array, "M S"]:
    """Return the states one super step later."""
    return jax.vmap(lambda state, control: step(emulator, state, control))(states, controls)


@filter_jit
def _scores_along(
    emulator: Emulator, starts: Float[Array, "N S"], controls: Float[Array, "N T C"]
) -> Float[Array, "N T"]:
    """Return the scores along emulated runs."""

    def super_step(latent: Array, control: Array) -> tuple[Array, Array]:
        following, score = emulator.step_latent_trusted(latent, control)
        return following, score

    def along(start: Array, held: Array) -> Array:
        latent = emulator.encode(start)
        return jax.lax.scan(super_step, latent, emulator.encode_control(held))[1]

    return jnp.asarray(jax.vmap(along)(starts, controls))
