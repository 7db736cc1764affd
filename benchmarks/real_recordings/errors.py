"""How far predictions are from what was recorded, in the units of what was recorded.

Pendulums: the angle error [rad] after a time is the root mean square, over windows and hinges, of the difference of
hinges' angles (full turns left out); the median is that of windows, each its rms over hinges.

Cubes: the position error [m] is the distance of centres, the rotation error [rad] the angle between orientations; their
root mean square over unseen tosses after a time, and, as ContactNets reports them, the mean over the samples of a toss,
averaged over tosses: over the first 80 steps, and over whole tosses.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.real_recordings.cases import HORIZONS, Case, Windows
from benchmarks.real_recordings.cube_tosses import ORIENTATION, POSITION

TOSS_STEPS = 80
"""Steps of a toss that count."""


def error_rows(
    case: Case, unseen: Windows, predicted: Float[np.ndarray, "W T+1 S"]
) -> list[dict[str, Any]]:
    """Return the lines of the table for one method: one of a pendulum, two of a cube (position, rotation)."""
    if case.is_cube:
        position = position_errors(unseen.states, predicted)
        rotation = rotation_errors(unseen.states, predicted)
        return [
            {"measure": "position m"} | _figures(case, position),
            {"measure": "rotation rad"} | _figures(case, rotation),
        ]
    angles = angle_errors(unseen.states, predicted)
    return [{"measure": "angle rad"} | _figures(case, angles)]


def angle_errors(
    recorded: Float[np.ndarray, "W T S"], predicted: Float[np.ndarray, "W T S"]
) -> Float[np.ndarray, "W T"]:
    """Return the rms over hinges of the differences of angles [rad]."""
    hinges = recorded.shape[2] // 2
    difference = predicted[:, :, :hinges] - recorded[:, :, :hinges]
    within = (difference + np.pi) % (2 * np.pi) - np.pi
    return np.sqrt(np.mean(within**2, axis=2))


def position_errors(
    recorded: Float[np.ndarray, "W T S"], predicted: Float[np.ndarray, "W T S"]
) -> Float[np.ndarray, "W T"]:
    """Return the distances of centres [m]."""
    return np.linalg.norm(predicted[..., POSITION] - recorded[..., POSITION], axis=-1)


def rotation_errors(
    recorded: Float[np.ndarray, "W T S"], predicted: Float[np.ndarray, "W T S"]
) -> Float[np.ndarray, "W T"]:
    """Return the angles between orientations [rad]."""
    first = recorded[..., ORIENTATION]
    second = predicted[..., ORIENTATION]
    lengths = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
    cosine = np.abs(np.sum(first * second, axis=-1)) / lengths
    return 2 * np.arccos(np.minimum(cosine, 1.0))


def _figures(case: Case, errors: Float[np.ndarray, "W T"]) -> dict[str, Any]:
    figures: dict[str, Any] = {"windows": len(errors)}
    for horizon in HORIZONS:
        at_horizon = errors[:, min(round(horizon / case.dt), errors.shape[1] - 1)]
        there = at_horizon[np.isfinite(at_horizon)]
        is_told = len(there) > 0.9 * len(errors)
        figures[f"rms_{horizon}s"] = float(np.sqrt(np.mean(there**2))) if is_told else ""
        figures[f"median_{horizon}s"] = float(np.median(there)) if is_told else ""
    figures["mean_80_steps"] = ""
    figures["mean_whole_toss"] = ""
    if case.is_cube:
        figures["mean_80_steps"] = float(np.mean(np.nanmean(errors[:, 1 : TOSS_STEPS + 1], axis=1)))
        figures["mean_whole_toss"] = float(np.mean(np.nanmean(errors, axis=1)))
    return figures
