"""How much of a one-step error is noise in the recordings: the error a perfect emulator would have on them."""

from __future__ import annotations

from functools import partial

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.evaluation.accuracy import root_mean_square
from neuroanimator.evaluation.held_out import HeldOut
from neuroanimator.training.validation import noise_differences


def noise_error(emulator: Emulator, test: HeldOut) -> Float[np.ndarray, " M"] | None:
    """Return the rms one-step error that noise alone makes in what moves, over the standard deviation of the change.

    A super step begins at a state with noise, which the motion carries on, and is compared with another state with noise:
    both count, and are independent. What the motion makes of noise is what the emulator makes of as much again.
    None where nobody knows the noise: of a simulated system, which has none, and of datasets of older versions.
    """
    if test.noise is None:
        return None
    states, controls, truth = test.transitions
    following = partial(_following, emulator, controls=controls)
    carried, seen = noise_differences(test.frame, following, states, truth, test.noise)
    return np.hypot(*(root_mean_square(test.relative(part)) for part in (carried, seen)))


def _following(
    emulator: Emulator, states: Float[np.ndarray, "N S"], *, controls: Float[np.ndarray, "N C"]
) -> Float[np.ndarray, "N S"]:
    """Return the states one super step later."""
    return np.asarray(emulator.rollout(states, controls[:, None], may_diverge=True)[:, 1], float)
