"""What a motion of the page follows from, checked, and played: a start, controls, and pushes in between."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator import ArgumentError
from neuroanimator.authoring import EmulatorSpec
from neuroanimator_studio.limits import Limits
from neuroanimator_studio.requests import Export, Replay

Play = Callable[[Float[np.ndarray, " S"], Float[np.ndarray, "T C"]], Float[np.ndarray, "K S"]]
"""Returns K = T+1 states from a start under controls."""


class Push(NamedTuple):
    """Somebody's hand: before super step `step`, `change` (S,) is added to the state."""

    step: int
    change: Float[np.ndarray, " S"]


class PushedDrive(NamedTuple):
    """A start (S,), controls (T, C), and pushes in the order of their steps."""

    start: Float[np.ndarray, " S"]
    controls: Float[np.ndarray, "T C"]
    pushes: tuple[Push, ...] = ()

    def played(self, play: Play) -> Float[np.ndarray, "K S"]:
        """Return the K = T+1 states that `play` makes of it; where it is pushed, the state is that before the push."""
        pieces = [self.start[None]]
        state = self.start
        for first, last, change in self._stretches():
            states = play(state + change, self.controls[first:last])
            pieces.append(states[1:])
            state = states[-1]
        return np.concatenate(pieces)

    def _stretches(self) -> Iterator[tuple[int, int, Float[np.ndarray, " S"]]]:
        """Yield first and last super step of what is played without a push, and what is added before it."""
        first = 0
        change = np.zeros_like(self.start)
        for push in self.pushes:
            if push.step > first:
                yield first, push.step, change
                first = push.step
                change = np.zeros_like(self.start)
            change = change + push.change
        yield first, len(self.controls), change


def checked_drive(spec: EmulatorSpec, wanted: Replay | Export, limits: Limits) -> PushedDrive:
    """Return what was asked for as arrays.

    Raises ArgumentError for a wrong shape, numbers that are not finite, controls out of bounds and too many of them.
    """
    start = spec.state.check(wanted.start, "start")
    controls = _checked_controls(spec, wanted.controls, limits)
    pushes = []
    for step, change in sorted(wanted.pushes, key=lambda row: row[0]):
        if step >= len(controls):
            raise ArgumentError(f"pushes: wanted super steps below {len(controls)}, got {step}.")
        pushes.append(Push(step, spec.state.check(change, "pushes")))
    return PushedDrive(start, controls, tuple(pushes))


def _checked_controls(
    spec: EmulatorSpec, controls: Sequence[Sequence[float]], limits: Limits
) -> Float[np.ndarray, "T C"]:
    if not 1 <= len(controls) <= limits.steps:
        raise ArgumentError(
            f"controls: wanted 1 to {limits.steps:,} super steps, got {len(controls):,}."
        )
    rows = spec.control.check(controls, "controls")
    spec.bounds.check(rows, spec.control.names)
    # What the page brings to a bound in float32 may be one rounding beyond it.
    return spec.bounds.clip(rows)


def checked_states(
    spec: EmulatorSpec, states: str | Sequence[Sequence[float]]
) -> Float[np.ndarray, "K S"]:
    """Return states that came as rows, or in base64 of little-endian float32; ArgumentError for anything else."""
    size = spec.state.size
    if not isinstance(states, str):
        return spec.state.check(states, "states")
    try:
        content = base64.b64decode(states, validate=True)
    except ValueError as error:
        raise ArgumentError("states: wanted base64 of float32 numbers.") from error
    if not content or len(content) % (4 * size):
        raise ArgumentError(
            f"states: wanted rows of {size} float32 numbers, got {len(content)} bytes."
        )
    rows = np.frombuffer(content, "<f4").reshape(-1, size).astype(float)
    return spec.state.check(rows, "states")
