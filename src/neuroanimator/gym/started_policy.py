"""Learning that begins with a policy: what it does is kept, and what it was not shown counts for nothing at first."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.control.policies.state_policy import EPSILON, Perceptron, StatePolicy, View
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError


def check_start(start: StatePolicy, emulator: Emulator, view: View) -> None:
    """Raise ArgumentError for a policy of other controls, or that is shown more than `view` shows."""
    if start.emulator.control != emulator.control:
        raise ArgumentError(
            f"start: wanted a policy with the controls of {emulator.system}, came one of {start.emulator.system}."
        )
    known = len(start.view.mean)
    if known > len(view.mean):
        raise ArgumentError(
            f"start: it is shown {known} numbers, this task shows {len(view.mean)}. Give a policy of a like task."
        )


def started(start: StatePolicy, view: View, states: Float[Array, "B S"]) -> tuple[View, Perceptron]:
    """Return (view, network) that act as those of `start`, which was shown the first of the numbers that `view` shows.

    Means and deviations of the others are those in `states`, in which episodes begin; so are means of numbers that are the same
    in all of them, since they no longer say what they did. With another reach the last weights are scaled, so what is far from
    its end is kept.
    """
    known = len(start.view.mean)
    shown = np.asarray(view.of(states), float)
    is_taken = shown.std(axis=0) > EPSILON
    is_taken[known:] = False
    mean = shown.mean(axis=0)
    deviation = shown.std(axis=0)
    mean[is_taken] = np.asarray(start.view.mean)[is_taken[:known]]
    deviation[:known] = start.view.deviation
    begun = View(
        jnp.asarray(mean, jnp.float32),
        jnp.asarray(deviation, jnp.float32),
        view.entries,
        view.reference,
    )
    first, *others, last = start.network.weights
    unknown = jnp.zeros((len(mean) - known, first.shape[1]))
    scale = _reach(start.view) / _reach(view)
    weights = (jnp.concatenate([first, unknown]), *others, scale * last)
    biases = (*start.network.biases[:-1], scale * start.network.biases[-1])
    return begun, Perceptron(weights, biases)


def _reach(view: View) -> float:
    """Return the largest angle by which a control differs from a motion's [rad]; 1 where no motion is followed."""
    return 1.0 if view.reference is None else view.reference.reach
