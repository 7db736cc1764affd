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

from neuroanimator.codegen.jax_settings import keep_programs
from neuroanimator.control.policies.policy import KIND as POLICY_KIND
from neuroanimator.control.policies.policy import (
    Policy,
    check_controls,
    check_policy_formats,
    checked_width,
    policy_from,
)
from neuroanimator.control.policies.reference_motion import ReferenceMotion
from neuroanimator.emulator.artifact import FAULTS, check_arrays, first_line
from neuroanimator.emulator.description import blank, describe
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks.network import prefixed
from neuroanimator.emulator.tensors import emulator_leaves, to_numpy, with_tensors
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import Metadata, Tensors, read_tensors, write_tensors
from neuroanimator.files.numbers import entries, listed

FORMAT = 1
"""Version of the file format, raised whenever an older reader would misunderstand a file."""

KIND = "state-policy"

MAKER = "policy"
"""Command that retrains policies that are too old to be read."""

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


class StatePolicy(eqx.Module):
    """u = middle + half · tanh(network(observations of the state)).

    If it follows a motion, the middle is the servos' target for the motion's next pose, and half is its reach.
    """

    emulator: Emulator
    """Emulator of one step, which was trained along with it."""
    view: View
    network: Perceptron

    def __repr__(self) -> str:
        spec = self.emulator.spec
        return f'StatePolicy("{spec.system}", dt {self.dt:g} s, {spec.control.size} controls)'

    @property
    def dt(self) -> float:
        """Time for which a control is held [s]."""
        return self.emulator.dt

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
        middle = jnp.asarray(self.emulator.bounds.middle, jnp.float32)
        half = jnp.asarray(self.emulator.bounds.half, jnp.float32)
        return middle + half * share

    def save(self, path: str | Path, provenance: dict[str, Any] | None = None) -> None:
        """Write the policy as one `.safetensors` file; `provenance` states how it was learnt (any JSON)."""
        write_tensors(
            Path(path),
            to_numpy(policy_leaves(self)),
            _describe(self) | {"provenance": provenance or {}},
        )


def policy_leaves(policy: StatePolicy) -> dict[str, Any]:
    """Return every array by its name in files."""
    leaves: dict[str, Any] = prefixed("emulator", emulator_leaves(policy.emulator))
    leaves |= {"view.mean": policy.view.mean, "view.deviation": policy.view.deviation}
    if policy.view.reference is not None:
        leaves["reference.frames"] = policy.view.reference.frames
    for index, (weights, bias) in enumerate(
        zip(policy.network.weights, policy.network.biases, strict=True)
    ):
        leaves[f"network.{index}.weights"] = weights
        leaves[f"network.{index}.bias"] = bias
    return leaves


def _describe(policy: StatePolicy) -> dict[str, Any]:
    described = {
        "kind": KIND,
        "format": FORMAT,
        "emulator": describe(policy.emulator),
        "entries": list(policy.view.entries),
        "widths": [len(bias) for bias in policy.network.biases[:-1]],
    }
    if policy.view.reference is not None:
        described["reference"] = policy.view.reference.to_json()
    return described


def load_state_policy(path: Path) -> StatePolicy:
    """Return the policy in the file at `path`; BadFileError states what is wrong with it."""
    return _policy_from(path, *read_tensors(path, KIND))


def _policy_from(path: Path, tensors: Tensors, metadata: Metadata) -> StatePolicy:
    keep_programs()
    check_policy_formats(path, metadata, FORMAT, MAKER)
    try:
        policy = with_tensors(_blank(metadata), policy_leaves, tensors)
        check_arrays(policy.emulator)
        if (np.asarray(policy.view.deviation) < 0).any():
            raise ValueError("view: wanted deviations of at least 0")
        check_controls(policy, StatePolicy.control_of)
    except FAULTS as error:
        raise BadFileError(
            f"{path} is not a usable policy: {first_line(error)}. Make it again."
        ) from error
    if policy.emulator.definition:
        from neuroanimator.definitions.carried import remember_folder

        remember_folder(policy.emulator.definition, path.parent)
    return policy


def load_any_policy(path: Path) -> Policy | StatePolicy:
    """Return the policy in the file at `path`, of either kind; BadFileError states what is wrong with it."""
    return read_policy(path)[0]


def read_policy(path: Path) -> tuple[Policy | StatePolicy, dict[str, Any]]:
    """Return (the policy in the file at `path`, of either kind, the file's metadata).

    Raises BadFileError with what is wrong with the file.
    """
    tensors, metadata = read_tensors(path, POLICY_KIND, KIND)
    if metadata["kind"] == KIND:
        return _policy_from(path, tensors, metadata), metadata
    return policy_from(path, tensors, metadata), metadata


def _blank(metadata: Metadata) -> StatePolicy:
    """Return a policy of the described structure with zero weights."""
    emulator = blank(metadata["emulator"], Emulator)
    shown = entries(metadata["entries"], "entries", emulator.state.size)
    widths = listed(metadata["widths"], "widths", checked_width)
    reference = None
    if "reference" in metadata:
        reference = ReferenceMotion.blank(
            metadata["reference"], emulator.state.size, emulator.control.size
        )
    view = View.fresh(shown, reference)
    sizes = (len(view.mean), *widths, emulator.control.size)
    pairs = list(pairwise(sizes))
    network = Perceptron(
        tuple(jnp.zeros(pair) for pair in pairs), tuple(jnp.zeros(size) for _, size in pairs)
    )
    return StatePolicy(emulator, view, network)
