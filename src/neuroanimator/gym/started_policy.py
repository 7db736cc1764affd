"""Learning that begins with a policy: its behaviour is kept, and new inputs have no influence at first."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.control.policies.state_policy import EPSILON, Perceptron, StatePolicy, View
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError


def check_start(start: StatePolicy, emulator: Emulator, view: View) -> None:
    """Raise ArgumentError for a policy with other controls, or with more inputs than `view`."""
    if start.emulator.control != emulator.control:
        raise ArgumentError(
            f"start: wanted a policy with the controls of {emulator.system}, got one of {start.emulator.system}."
        )
    known = len(start.view.mean)
    if known > len(view.mean):
        raise ArgumentError(
            f"start: the policy observes {known} numbers, this task has {len(view.mean)}. Give a policy of a similar task."
        )


def started(start: StatePolicy, view: View, states: Float[Array, "B S"]) -> tuple[View, Perceptron]:
    """Return (view, network) that act as those of `start`, whose inputs are the first of those of `view`.

    Means and deviations of the others are those in `states`, in which episodes begin; so are means of inputs that are
    constant there, since they have lost their meaning. With another reach the last weights are scaled, so that controls
    far from its end are kept.
    """
    known = len(start.view.mean)
    shown = np.asarray(view.of(states), float)
    is_taken = shown.std(axis=0) > EPSILON
    is_taken[known:] = False
    mean = shown.mean(axis=0)
    deviation = shown.std(axis=0)
    mean[is_taken] = np.asarray(start.view.mean)[is_taken[:known]]
    deviation[:known] = start.view.deviation
    begun = replace(
        view,
        mean=jnp.asarray(mean, jnp.float32),
        deviation=jnp.asarray(deviation, jnp.float32),
    )
    first, *others, last = start.network.weights
    unknown = jnp.zeros((len(mean) - known, first.shape[1]))
    scale = _reach(start.view) / _reach(view)
    weights = (jnp.concatenate([first, unknown]), *others, scale * last)
    biases = (*start.network.biases[:-1], scale * start.network.biases[-1])
    return begun, Perceptron(weights, biases)


def _reach(view: View) -> float:
    """Return the largest angle by which a control differs from a motion's [rad]; 1 if no motion is followed."""
    return 1.0 if view.reference is None else view.reference.reach
