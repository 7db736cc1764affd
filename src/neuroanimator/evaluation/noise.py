"""How much of a one-step error is noise in the recordings: the error a perfect emulator would have on them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.evaluation.accuracy import root_mean_square
from neuroanimator.evaluation.held_out import HeldOut

NOISE_SEED = 3
"""The noise that is added is drawn from this seed."""


def noise_error(emulator: Emulator, test: HeldOut) -> Float[np.ndarray, " M"] | None:
    """Return the rms one-step error that noise alone makes in what moves, over the standard deviation of the change.

    A super step begins at a state with noise, which the motion carries on, and is compared with another state with noise:
    both count, and are independent. What the motion makes of noise is what the emulator makes of as much again.
    None where nobody knows the noise: of a simulated system, which has none, and of datasets of older versions.
    """
    if test.noise is None:
        return None
    states, controls, truth = test.transitions
    rng = np.random.default_rng(NOISE_SEED)
    at_start = rng.normal(size=states.shape) * test.noise
    at_end = rng.normal(size=states.shape) * test.noise
    usual = _following(emulator, states, controls)
    moved = _following(emulator, states + at_start, controls)
    carried = root_mean_square(test.relative(test.frame.difference(usual, moved)))
    seen = root_mean_square(test.relative(test.frame.difference(truth, truth + at_end)))
    return np.hypot(carried, seen)


def _following(
    emulator: Emulator, states: Float[np.ndarray, "N S"], controls: Float[np.ndarray, "N C"]
) -> Float[np.ndarray, "N S"]:
    """Return the states one super step later."""
    return np.asarray(emulator.rollout(states, controls[:, None], may_diverge=True)[:, 1], float)
