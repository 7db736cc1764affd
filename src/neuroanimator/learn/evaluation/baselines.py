"""Cheap predictors of a super step: nothing changes, velocities stay, ridge regression. An emulator must beat them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.verdict import CONSTANT_VELOCITY, NO_CHANGE
from neuroanimator.learn.data.store import Dataset
from neuroanimator.learn.data.stored import super_steps
from neuroanimator.learn.evaluation.accuracy import guess_error
from neuroanimator.learn.evaluation.held_out import HeldOut
from neuroanimator.learn.training.validation import coasted

RIDGE_REGRESSION = "ridge regression"
"""Name of the predictor linear in the state's features and the control, fitted to a dataset."""

RIDGE_STRENGTH = 1e-6
"""Weight of the squared coefficients in the ridge regression, per example."""


def baselines(data: Dataset | None, test: HeldOut) -> dict[str, float]:
    """Return the one-step errors of cheap predictors: nothing changes, velocities stay, ridge regression on `data`."""
    guesses = {
        NO_CHANGE: test.transitions.states,
        CONSTANT_VELOCITY: coasted(
            test.frame, test.system.structure.rates, test.transitions.states
        ),
    }
    if data is not None:
        guesses[RIDGE_REGRESSION] = _regressed(data, test)
    return {name: guess_error(test, guess) for name, guess in guesses.items()}


def _regressed(data: Dataset, test: HeldOut) -> Float[np.ndarray, "N S"]:
    """Return the states a super step later by ridge regression on the first steps of the windows of `data`."""
    states, controls, _ = test.transitions
    features = _linear_features(test, states, controls)
    return test.frame.apply(states, features @ _ridge(data, test))


def _linear_features(
    test: HeldOut, states: Float[np.ndarray, "N S"], controls: Float[np.ndarray, "N C"]
) -> Float[np.ndarray, "N F"]:
    """Return the features of the regression: sines and cosines of angles, the other entries, the control and 1."""
    structure = test.system.structure
    angles = states @ np.array(structure.angles, dtype=float).reshape(-1, states.shape[1]).T
    local = test.frame.local(states)
    plain = states[:, np.array(structure.plain, dtype=int)]
    ones = np.ones((len(states), 1))
    return np.concatenate([np.sin(angles), np.cos(angles), plain, local, controls, ones], axis=1)


def _ridge(data: Dataset, test: HeldOut) -> Float[np.ndarray, "F V"]:
    """Return the coefficients that fit the changes of `data` best, with a small weight on their squares.

    Only sums of the data are kept: they may be larger than memory.
    """
    gram = np.zeros(())
    moment = np.zeros(())
    count = 0
    for steps in super_steps(data):
        before = np.asarray(steps.states, float)
        after = np.asarray(steps.next_states, float)
        inputs = _linear_features(test, before, steps.controls)
        gram = gram + inputs.T @ inputs
        moment = moment + inputs.T @ test.frame.remainder(before, after)
        count += len(before)
    return np.linalg.solve(gram + RIDGE_STRENGTH * count * np.eye(len(gram)), moment)
