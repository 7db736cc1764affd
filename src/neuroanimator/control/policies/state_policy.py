"""Policies u = π(s) of a state: a network, its observations of the state, and their file."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.control.policies.abstract_policy import (
    AbstractPolicy,
    read_policy_file,
    read_widths,
)
from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.reference_motion import ReferenceMotion
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.files.atomic import Metadata
from neuroanimator.files.numbers import entries

MAX_SHOWN = 10.0
"""Maximum magnitude of a network's observations, in standard deviations."""

FIRST_GAIN = 0.01
"""Gain of a policy's initial last layer: it begins in the middle of the controls' range."""

EPSILON = 1e-5


class Perceptron(eqx.Module):
    """Fully connected layers; hidden ones are normalised over their units, and gated by x · sigmoid(x)."""

    weights: tuple[Float[Array, "I O"], ...]
    biases: tuple[Float[Array, " O"], ...]

    @classmethod
    def fresh(cls, sizes: tuple[int, ...], key: PRNGKeyArray, last_gain: float) -> Perceptron:
        """Return layers of these sizes, inputs first, with orthogonal weights, the last scaled by `last_gain`."""
        weights = []
        biases = []
        keys = jax.random.split(key, len(sizes) - 1)
        gains = [np.sqrt(2.0)] * (len(sizes) - 2) + [last_gain]
        for size, following, gain, layer_key in zip(
            sizes[:-1], sizes[1:], gains, keys, strict=True
        ):
            weights.append(gain * jax.nn.initializers.orthogonal()(layer_key, (size, following)))
            biases.append(jnp.zeros(following))
        return cls(tuple(weights), tuple(biases))

    def __call__(self, rows: Float[Array, "*B I"]) -> Float[Array, "*B O"]:
        for weights, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            hidden = rows @ weights + bias
            hidden = hidden - hidden.mean(axis=-1, keepdims=True)
            variance = (hidden * hidden).mean(axis=-1, keepdims=True)
            rows = jax.nn.silu(hidden / jnp.sqrt(variance + EPSILON))
        return rows @ self.weights[-1] + self.biases[-1]


class View(eqx.Module):
    """Observations of a state by networks: some of its entries, normalised by mean and standard deviation.

    With a motion to follow, they also include the body's relation to it.
    """

    mean: Float[Array, " O"]
    deviation: Float[Array, " O"]
    entries: tuple[int, ...] = eqx.field(static=True)
    reference: ReferenceMotion | None = None

    @classmethod
    def fresh(cls, entries: tuple[int, ...], reference: ReferenceMotion | None) -> View:
        """Return a view without normalisation."""
        size = len(entries)
        if reference is not None:
            size += reference.size
        return cls(jnp.zeros(size), jnp.ones(size), entries, reference)

    def of(self, states: Float[Array, "*B S"]) -> Float[Array, "*B O"]:
        """Return the observations, each in its own unit."""
        shown = states[..., np.array(self.entries)]
        if self.reference is None:
            return shown
        return jnp.concatenate([shown, self.reference.observe(states)], axis=-1)

    def __call__(self, states: Float[Array, "*B S"]) -> Float[Array, "*B O"]:
        """Return the normalised observations, of order one."""
        shown = self.of(states)
        return jnp.clip((shown - self.mean) / (self.deviation + EPSILON), -MAX_SHOWN, MAX_SHOWN)


class StatePolicy(AbstractPolicy):
    """u = middle + half · tanh(network(observations of the state)).

    If it follows a motion, the middle is the servos' target for the motion's next pose, and half is its reach. Its emulator,
    of one step, was trained along with it.
    """

    KIND = "state-policy"
    FORMAT = 1
    MAKER = "policy"

    view: View
    network: Perceptron

    def control_of(
        self, states: Float[Array, "*B S"], noise: Float[Array, "*B C"] | float = 0.0
    ) -> Float[Array, "*B C"]:
        """Return the controls for bodies in `states`; `noise` is added before they are squashed into their bounds."""
        share = jnp.tanh(self.network(self.view(states)) + noise)
        reference = self.view.reference
        if reference is not None:
            aims = reference.target(states) + reference.reach * share
            bounds = self.emulator.bounds
            return jnp.clip(aims, jnp.asarray(bounds.low), jnp.asarray(bounds.high))
        return self._off_middle(share)

    def _own_leaves(self) -> dict[str, Any]:
        leaves: dict[str, Any] = {
            "view.mean": self.view.mean,
            "view.deviation": self.view.deviation,
        }
        if self.view.reference is not None:
            leaves["reference.frames"] = self.view.reference.frames
        layers = zip(self.network.weights, self.network.biases, strict=True)
        for index, (weights, bias) in enumerate(layers):
            leaves[f"network.{index}.weights"] = weights
            leaves[f"network.{index}.bias"] = bias
        return leaves

    def _own_description(self) -> dict[str, Any]:
        described: dict[str, Any] = {
            "entries": list(self.view.entries),
            "widths": [len(bias) for bias in self.network.biases[:-1]],
        }
        if self.view.reference is not None:
            described["reference"] = self.view.reference.to_json()
        return described

    @classmethod
    def _blank(cls, metadata: Metadata, emulator: Emulator) -> StatePolicy:
        size = emulator.state.size
        controls = emulator.control.size
        shown = entries(metadata["entries"], "entries", size)
        reference = None
        if "reference" in metadata:
            reference = ReferenceMotion.blank(metadata["reference"], size, controls)
        view = View.fresh(shown, reference)
        pairs = list(pairwise((len(view.mean), *read_widths(metadata), controls)))
        network = Perceptron(
            tuple(jnp.zeros(pair) for pair in pairs), tuple(jnp.zeros(size) for _, size in pairs)
        )
        return cls(emulator, view, network)

    def _check(self, metadata: Metadata) -> None:
        if (np.asarray(self.view.deviation) < 0).any():
            raise ValueError("view: wanted deviations of at least 0")

    def _controls_near(self, states: Float[Array, "N S"]) -> Float[Array, "N C"]:
        return self.control_of(states)


controls_of = eqx.filter_jit(StatePolicy.control_of)
"""`StatePolicy.control_of`, compiled."""


def load_state_policy(path: Path) -> StatePolicy:
    """Return the policy in the file at `path`; BadFileError states what is wrong with it."""
    return read_policy_file(path, StatePolicy)[0]


def load_any_policy(path: Path) -> Policy | StatePolicy:
    """Return the policy in the file at `path`, of either kind; BadFileError states what is wrong with it."""
    return read_policy_file(path, Policy, StatePolicy)[0]
