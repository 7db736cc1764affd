"""Rows of the table that need no emulator: the authors' physics, persistence, constant velocity, ridge, the noise of starts.

A method looks at a case and its training runs and returns what predicts: starts (W, S) and controls (W, T, C) to states
(W, T+1, S), every `case.dt` seconds, the starts first. A further row of the table is a further function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.harness import Clocks
from benchmarks.real_recordings.cases import Case, Windows
from benchmarks.real_recordings.cube_tosses import ANGULAR_VELOCITY, ORIENTATION, POSITION, VELOCITY
from benchmarks.real_recordings.physics import simulate
from benchmarks.real_recordings.runs import Run

Predict = Callable[
    [Float[np.ndarray, "W S"], Float[np.ndarray, "W T C"]], Float[np.ndarray, "W T+1 S"]
]

RIDGE = 1e-3
"""Weight of the squared coefficients, of features in units of their standard deviation, against a mean squared error."""

RIDGE_STRIDE = 10
"""Samples of a pendulum's recording that the linear model leaps at a time: 50 ms, as an emulator would."""

SMALL = 1e-9
"""What never changes is measured by this."""


def making_cells(spent: Clocks) -> dict[str, float]:
    """Return the cells of the table that say what making a method took."""
    return {"making_s": spent.seconds, "making_cpu_s": spent.cpu_seconds}


@dataclass(frozen=True)
class Prediction:
    """What predicts, and what making it took."""

    predict: Predict
    figures: dict[str, Any] = field(default_factory=dict)
    """Further cells of the table, such as iterations."""
    shares: Callable[[Windows], dict[str, float]] | None = None
    """Returns the shares of unseen windows below error bounds; None where there are none."""


Method = Callable[[Case, list[Run]], Prediction | None]
"""Returns what predicts, of a case and its training runs; None of a case it has nothing for."""


def physics_of_authors(case: Case, training: list[Run]) -> Prediction:
    """Return the authors' model with the parameters they publish."""
    model = case.model()

    def predict(
        starts: Float[np.ndarray, "W S"], controls: Float[np.ndarray, "W T C"]
    ) -> Float[np.ndarray, "W T+1 S"]:
        return simulate(model, starts, controls, case.dt)

    return Prediction(predict)


def persistence(case: Case, training: list[Run]) -> Prediction:
    """Return what says that nothing changes."""

    def predict(
        starts: Float[np.ndarray, "W S"], controls: Float[np.ndarray, "W T C"]
    ) -> Float[np.ndarray, "W T+1 S"]:
        return np.repeat(starts[:, None], controls.shape[1] + 1, axis=1)

    return Prediction(predict)


def constant_velocity(case: Case, training: list[Run]) -> Prediction:
    """Return what says that every position goes on at the velocity it has."""

    def predict(
        starts: Float[np.ndarray, "W S"], controls: Float[np.ndarray, "W T C"]
    ) -> Float[np.ndarray, "W T+1 S"]:
        states = np.repeat(starts[:, None], controls.shape[1] + 1, axis=1)
        time = case.dt * np.arange(controls.shape[1] + 1)
        if case.is_cube:
            way = starts[:, None, VELOCITY] * time[:, None]
            states[:, :, POSITION] += way
            turn = starts[:, None, ANGULAR_VELOCITY] * time[:, None]
            states[:, :, ORIENTATION] = _turned(states[:, :, ORIENTATION], turn)
            return states
        hinges = starts.shape[1] // 2
        states[:, :, :hinges] += starts[:, None, hinges:] * time[:, None]
        return states

    return Prediction(predict)


def _turned(
    orientation: Float[np.ndarray, "... 4"], turn: Float[np.ndarray, "... 3"]
) -> Float[np.ndarray, "... 4"]:
    """Return orientations (wxyz) after turns, rotation vectors [rad] in the body's own axes."""
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    axis = turn / np.maximum(angle, SMALL)
    real = np.cos(angle / 2)
    imaginary = axis * np.sin(angle / 2)
    w = orientation[..., :1]
    v = orientation[..., 1:]
    scalar = w * real - np.sum(v * imaginary, axis=-1, keepdims=True)
    vector = w * imaginary + real * v + np.cross(v, imaginary)
    return np.concatenate([scalar, vector], axis=-1)


def ridge(case: Case, training: list[Run]) -> Prediction:
    """Return a linear model of the change in a step: of angles' sines and cosines, velocities, and the mean control.

    A step is RIDGE_STRIDE samples of a pendulum; between its ends positions are interpolated. For a cube it is one
    sample, and the state stands for itself.
    """
    stride = 1 if case.is_cube else RIDGE_STRIDE
    inputs = []
    changes = []
    for run in training:
        controls = _step_means(run.controls[None], stride)[0]
        states = run.states[::stride][: len(controls) + 1]
        controls = controls[: len(states) - 1]
        inputs.append(_features(case, states[:-1], controls))
        changes.append(np.diff(states, axis=0))
    features = np.concatenate(inputs)
    targets = np.concatenate(changes)
    middle = features.mean(axis=0)
    unit = np.maximum(features.std(axis=0), SMALL)
    scaled = (features - middle) / unit
    level = targets.mean(axis=0)
    square = scaled.T @ scaled / len(scaled) + RIDGE * np.eye(scaled.shape[1])
    weights = np.linalg.solve(square, scaled.T @ (targets - level) / len(scaled))

    def predict(
        starts: Float[np.ndarray, "W S"], controls: Float[np.ndarray, "W T C"]
    ) -> Float[np.ndarray, "W T+1 S"]:
        means = _step_means(controls, stride)
        states = [starts]
        for step in range(means.shape[1]):
            now = _features(case, states[-1], means[:, step])
            change = (now - middle) / unit @ weights + level
            states.append(states[-1] + change)
        return _interpolated(np.stack(states, axis=1), stride)

    return Prediction(predict)


def _features(
    case: Case, states: Float[np.ndarray, "N S"], controls: Float[np.ndarray, "N C"]
) -> Float[np.ndarray, "N F"]:
    if case.is_cube:
        return np.hstack([states, controls])
    hinges = states.shape[1] // 2
    angles = states[:, :hinges]
    return np.hstack([np.sin(angles), np.cos(angles), states[:, hinges:], controls])


def _step_means(controls: Float[np.ndarray, "W T C"], stride: int) -> Float[np.ndarray, "W K C"]:
    windows, samples, size = controls.shape
    steps = samples // stride
    whole = controls[:, : steps * stride].reshape(windows, steps, stride, size)
    return whole.mean(axis=2)


def _interpolated(states: Float[np.ndarray, "W K S"], stride: int) -> Float[np.ndarray, "W T S"]:
    """Return states at every sample, on straight lines between those at every `stride`-th."""
    begin = states[:, :-1, None]
    share = np.arange(stride)[:, None] / stride
    between = begin + share * np.diff(states, axis=1)[:, :, None]
    flat = between.reshape(len(states), -1, states.shape[2])
    return np.concatenate([flat, states[:, -1:]], axis=1)


def start_noise(case: Case, unseen: Windows) -> Float[np.ndarray, "W T+1 S"]:
    """Return the motions recorded plus what the noise of their measured starts grows to, by the authors' physics.

    Two rollouts begin at the starts from one half of the samples and from the other; half their difference is what
    noise in the starts makes of a prediction. Errors that neighbouring samples share are not seen: it is a lower bound.
    """
    assert unseen.halves is not None
    model = case.model()
    first = simulate(model, unseen.halves[0], unseen.controls, case.dt)
    second = simulate(model, unseen.halves[1], unseen.controls, case.dt)
    return unseen.states + (second - first) / 2


FREE_METHODS: dict[str, tuple[str, Method]] = {
    "physics, authors' parameters": ("a", physics_of_authors),
    "persistence": ("f", persistence),
    "constant velocity": ("f", constant_velocity),
    "ridge": ("f", ridge),
}
"""By its name, each method's row of the table and the function that makes it."""
