"""Feasibility of goals: refuse those beyond the emulator's training before any descent."""

from __future__ import annotations

import numpy as np

from neuroanimator.control.objective.costs import NearPose, NearSpeed
from neuroanimator.control.objective.goals import ReachState
from neuroanimator.control.objective.objective import CostTerm, Objective
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.state.pose import read_pose

MARGIN = 1.2
"""Maximum ratio of the speed a goal needs to the fastest in training: starts may be faster, and domains have soft ends."""

MIN_TIME = 1e-9
"""Stand-in for a time of zero, to prevent division by it [s]."""


def check_reachable(
    objective: Objective, emulator: Emulator, start: np.ndarray, steps: int
) -> None:
    """Raise ArgumentError if a term wants a position too far away, or a speed far beyond training."""
    max_speed = emulator.max_speed()
    for term in objective.terms:
        if isinstance(term, ReachState):
            _check_state(term, emulator)
        if max_speed is None:
            continue
        fastest = float(max_speed)
        wanted = _wanted_speed(term, start, steps * emulator.dt)
        if wanted > MARGIN * fastest:
            raise ArgumentError(
                f"objective: it takes {wanted:.3g} m/s to get there; training reached {fastest:.3g} m/s at most. "
                "Choose a nearer goal, or more time."
            )


def _check_state(term: ReachState, emulator: Emulator) -> None:
    control = np.asarray(emulator.bounds.middle, np.float32)
    features = np.asarray(emulator.raw_features_of(np.asarray(term.goal), control))
    limit = MARGIN * np.maximum(np.abs(emulator.domain.low), np.abs(emulator.domain.high))
    of_state = len(features) - emulator.frame.control_size(len(control))
    if (np.abs(features) > limit)[:of_state].any():
        raise ArgumentError(
            "objective: the wanted state lies outside what the emulator was trained on. "
            "Choose one nearer to rest, or train with wider starts."
        )


def _wanted_speed(term: CostTerm, start: np.ndarray, seconds: float) -> float:
    """Return the speed [m/s] needed to fulfil `term` from `start` (S,) in `seconds`; 0 for terms that need none."""
    if isinstance(term, NearSpeed):
        return abs(float(term.wanted[0]))
    if not isinstance(term, NearPose):
        return 0.0
    if term.quantity == "velocity":
        return float(np.linalg.norm(term.wanted))
    if term.quantity == "position":
        position = read_pose(term.structure, start).position[list(term.axes)]
        distances = np.linalg.norm(np.asarray(term.wanted) - position, axis=-1)
        times = np.array(term.when.times or (seconds,))
        if term.when.lasts:
            times = np.array([seconds])
        return float(np.max(distances / np.maximum(times, MIN_TIME)))
    return 0.0
