"""Linear start of training: the linear map of a network by ridge regression, so that its units learn the rest."""

from __future__ import annotations

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks.glu import LinearGlu
from neuroanimator.learn.data.store import Transitions

MAX_ROWS = 40_000
"""Maximum number of super steps to which the map is fitted."""

RIDGE = 1e-4
"""Weight of the map's squared coefficients, over the squares of normalised features."""


def with_linear_start(emulator: Emulator, data: Transitions) -> Emulator:
    """Return `emulator` with its linear map fitted to super steps of `data`, which are latent windows.

    A network without a linear map is unchanged.
    """
    network = emulator.network
    if not isinstance(network, LinearGlu):
        return emulator
    controls = data.controls.reshape(-1, data.controls.shape[-1])
    every = -(-len(controls) // MAX_ROWS)
    size = data.states.shape[-1]
    before = data.states[:, :-1].reshape(-1, size)[::every]
    after = data.states[:, 1:].reshape(-1, size)[::every]
    features = np.asarray(_features(emulator, as_jax(before), as_jax(controls[::every])), float)
    changes = np.asarray(emulator.frame.remainder(before, after), float)
    normaliser = emulator.normaliser
    scale = np.asarray(normaliser.change_scale, float)
    moves = scale > 0
    targets = np.where(moves, changes - np.asarray(normaliser.change_mean), 0)
    targets /= np.where(moves, scale, 1)
    squares = features.T @ features + RIDGE * len(features) * np.eye(features.shape[1])
    linear = np.linalg.solve(squares, features.T @ targets)
    return eqx.tree_at(lambda emulator: emulator.network.linear, emulator, as_jax(linear))


@eqx.filter_jit
def _features(
    emulator: Emulator, states: Float[Array, "N I"], controls: Float[Array, "N C"]
) -> Float[Array, "N F"]:
    """Return the inputs of the network."""

    def of_one(state: Float[Array, " I"], control: Float[Array, " C"]) -> Float[Array, " F"]:
        shown = emulator.domain.clip(emulator.raw_features(state, control))
        odd, even = emulator.features.streams(state, emulator.normaliser.forward(shown))
        return jax.numpy.concatenate([odd, even])

    return jax.vmap(of_one)(states, controls)
