"""Goals no motion the emulator knows can reach: said before any descent."""

from __future__ import annotations

import math

import numpy as np

from neuroanimator.control.objective.objective import CostTerm, Objective
from neuroanimator.control.objective.terms import (
    KeepSpeed,
    KeepVelocity,
    ReachPositions,
    ReachState,
)
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.state.pose import read_pose

ROOM = 1.2
"""Times the fastest speed in training that a goal may ask for: starts may be faster, and domains have soft ends."""


def check_reachable(
    objective: Objective, emulator: Emulator, start: np.ndarray, steps: int
) -> None:
    """Raise ArgumentError where a term wants a place too far off, or a speed training never came near."""
    fastest = fastest_speed(emulator)
    for term in objective.terms:
        if isinstance(term, ReachState):
            _check_state(term, emulator)
        if fastest is not None:
            _check_speed(term, fastest, start, steps * emulator.dt)


def fastest_speed(emulator: Emulator) -> float | None:
    """Return the greatest speed [m/s] training showed; None where nothing moves freely."""
    max_speed = emulator.encoding.max_speed
    if math.isfinite(max_speed):
        return max_speed
    entries = emulator.frame.velocity_entries
    if not entries:
        return None
    first = len(emulator.features.plain)
    low, high = (
        np.asarray(end)[[first + i for i in entries]]
        for end in (emulator.domain.low, emulator.domain.high)
    )
    return float(np.linalg.norm(np.maximum(-low, high)))


def _check_state(term: ReachState, emulator: Emulator) -> None:
    control = np.asarray(emulator.bounds.middle, np.float32)
    plain = np.asarray(emulator.raw_features_of(np.asarray(term.goal), control))
    room = ROOM * np.maximum(np.abs(emulator.domain.low), np.abs(emulator.domain.high))
    states = len(plain) - emulator.frame.control_size(len(control))
    if (np.abs(plain) > room)[:states].any():
        raise ArgumentError(
            "objective: the wanted state lies outside what the emulator was trained on. "
            "Choose one nearer to rest, or train with wilder starts."
        )


def _check_speed(term: CostTerm, fastest: float, start: np.ndarray, seconds: float) -> None:
    wanted = 0.0
    if isinstance(term, KeepSpeed | KeepVelocity):
        wanted = float(np.linalg.norm(term.speed if isinstance(term, KeepSpeed) else term.velocity))
    if isinstance(term, ReachPositions):
        position = read_pose(term.structure, start).position[list(term.axes)]
        times = np.array(term.times or (seconds,))
        wanted = float(
            np.max(
                np.linalg.norm(np.asarray(term.positions) - position, axis=-1)
                / np.maximum(times, 1e-9)
            )
        )
    if wanted > ROOM * fastest:
        raise ArgumentError(
            f"objective: wanted {wanted:.3g} m/s, or as far away as that takes; training showed {fastest:.3g} m/s "
            "at most. Choose a nearer goal, or more time."
        )
