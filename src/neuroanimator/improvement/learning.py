"""Train an emulator on with new samples among old windows, so that it keeps what it knew."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.data.config import MAX_UNROLL
from neuroanimator.data.store import Transitions
from neuroanimator.emulator.artifact import load
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import BadFileError
from neuroanimator.evaluation.held_out import HeldOut
from neuroanimator.improvement.config import ImprovementConfig
from neuroanimator.improvement.emulated import errors_on
from neuroanimator.improvement.mixture import mixed, warm_config, widened
from neuroanimator.improvement.samples import Samples, joined, windows_of
from neuroanimator.jax_later import eqx, jax
from neuroanimator.systems.system import System
from neuroanimator.training.chunk import completed
from neuroanimator.training.lesson import keeps_still
from neuroanimator.training.train import Report, train
from neuroanimator.training.trust_fitting import fit_trust

QUANTILE = 0.95
"""An emulator's error in a place is this quantile of its one-step errors there."""

KEPT = 1.1
"""No emulator is taken whose error on usual motions is more than so many times what it was."""

SHARES = (0.75, 0.5, 0.25, 0.1)
"""Shares of the way to the trained weights that are tried where these know usual motions too badly."""

FULL_WEIGHT = 3.0
"""New windows whose errors are up to so many times the usual one count fully."""

STEEPNESS = 2.0
"""Others count in inverse proportion to this power of their errors."""


def error_on(emulator: Emulator, test: HeldOut) -> float:
    """Return the 95th percentile of one-step errors on a test [standard deviations of the usual change]."""
    return float(np.quantile(errors_on(emulator, test), QUANTILE))


@dataclass
class Learner:
    """What all rounds of an improvement learn by."""

    system: System
    data: Transitions
    """What it knew."""
    given: Emulator
    guard: HeldOut
    """Usual motions by which it is judged whether that is kept."""
    config: ImprovementConfig
    usual_error: float = field(init=False)
    """The error of the emulator that was given, on them."""

    def __post_init__(self):
        self.usual_error = error_on(self.given, self.guard)

    def learn(
        self,
        emulator: Emulator,
        samples: Sequence[Samples],
        path: Path,
        on_report: Callable[[Report], None] = lambda report: None,
    ) -> Emulator:
        """Return `emulator` trained on with all `samples` there are so far; it is written to `path`, or read from there."""
        new = windows_of(joined(samples))
        base = widened(emulator, new)
        config = warm_config(
            self.given, self.system.structure, self.config.updates, self.config.seed
        )
        weights = self._weights(emulator, samples)
        windows = mixed(self.data, new, self.config, weights=weights)
        try:
            return load(path)
        except BadFileError:  # there is none yet, or it is damaged
            return train(windows, config, path, start_from=base, on_report=on_report)

    def _weights(self, emulator: Emulator, samples: Sequence[Samples]) -> Float[np.ndarray, " N"]:
        """Return how often each new window is learnt from: the larger its error is, the more seldom.

        Errors count squared; those that are a hundred times the usual ones would count for all else
        (weights of Cauchy's estimator: Holland and Welsch, 1977).
        """
        largest = FULL_WEIGHT * self.usual_error
        weights = []
        for part in samples:
            test = replace(self.guard, states=part.states, controls=part.controls)
            errors = _window_errors(errors_on(emulator, test))
            weights.append(1 / np.maximum(1, errors / largest) ** STEEPNESS)
        return np.concatenate(weights)

    def kept(self, trained: Emulator) -> Emulator | None:
        """Return what lies on the way from the emulator that was given to `trained`, as far as usual motions are known still.

        The way between the weights is a straight line (Wortsman et al., Robust fine-tuning of zero-shot models, 2022).
        None if they are known too badly all along.
        """
        most = KEPT * self.usual_error
        if error_on(trained, self.guard) <= most:
            return trained
        for share in SHARES:
            between = between_networks(self.given, trained, share, self.system)
            if error_on(between, self.guard) <= most:
                return fit_trust(between, self.data)
        return None


def _window_errors(errors: Float[np.ndarray, "N T"]) -> Float[np.ndarray, " M"]:
    """Return the error of the first super step of each window of runs, in the order of `windows_of`."""
    return errors[:, : errors.shape[1] - MAX_UNROLL + 1].reshape(-1)


def between_networks(given: Emulator, trained: Emulator, share: float, system: System) -> Emulator:
    """Return `trained` with weights that lie a `share` of the way from those of `given`; it keeps still where the system does."""
    base = replace(trained, normaliser=given.normaliser)
    old, others = eqx.partition(given.network, eqx.is_inexact_array)
    new, _ = eqx.partition(trained.network, eqx.is_inexact_array)
    weights = jax.tree.map(lambda one, other: (1 - share) * one + share * other, old, new)
    rest = None
    if keeps_still(system, base):
        rest = base.rest_streams()
    return completed(base, eqx.combine(weights, others), rest)
