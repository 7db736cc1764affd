"""A motion by an emulator and its physics in turns: where the emulator is not trusted, the physics takes over for a while.

A leap's trust score is known from its input: state, control → score → below the threshold the emulator leaps; else the
physics continues from the same state, and hands back where the emulator is trusted again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust import EDGE
from neuroanimator.errors import ArgumentError, DivergedError
from neuroanimator.systems.system import System

PHYSICS_STEPS = 3
"""Minimum number of super steps for which the physics stays."""

LOOK_AHEAD = 32
"""Initial number of leaps tried at a time, doubled each time that all of them are trusted."""


class HybridMotion(NamedTuple):
    """A rollout in which emulator and physics take turns."""

    states: Float[np.ndarray, "F S"]
    """States (T+1, S), the start included."""
    scores: Float[np.ndarray, " T"]
    """Trust score of each super step's input, which is compared with the threshold.

    For leaps, and for the refused one that the physics replaced, it is the score in their rollout
    (`Emulator.rollout_trusted`); for the physics' own states it is that of `Emulator.trust`, which encodes them.
    """
    is_physics: Bool[np.ndarray, " T"]
    """Whether the physics made each super step."""

    @property
    def physics_share(self) -> float:
        """Share of the super steps that the physics made."""
        return float(self.is_physics.mean()) if len(self.is_physics) else 0.0


def hybrid_rollout(
    emulator: Emulator,
    system: System,
    state: ArrayLike,
    controls: ArrayLike,
    *,
    threshold: float = EDGE,
    physics_steps: int = PHYSICS_STEPS,
) -> HybridMotion:
    """Return the motion from `state` (S,) under `controls` (T, C) by `emulator`, and by `system` where that is not trusted.

    The physics, the system's `truth`, makes the super steps whose score is not below `threshold`. It continues from the
    emulator's state and hands back its own, so that positions and velocities are continuous; it stays for at least
    `physics_steps` super steps, until the score is below the threshold again. With a threshold of 0 all is physics, with
    an infinite one nothing.

    Raises ArgumentError for another system, one without physics, thresholds below 0 and what `rollout` refuses;
    DivergedError if the motion diverges.
    """
    check_hybrid(emulator, system, threshold, physics_steps)
    start = emulator.state.check(state, "state")
    held = system.check_controls(np.asarray(controls))
    if start.ndim != 1 or held.ndim != 2:
        raise ArgumentError(
            f"state and controls: wanted (S,) with (T, C), got {start.shape} with {held.shape}."
        )
    relay = _Relay(emulator, system, held, threshold, physics_steps)
    return relay.run(start)


def check_hybrid(
    emulator: Emulator, system: System, threshold: float, physics_steps: int = PHYSICS_STEPS
) -> None:
    """Raise ArgumentError if `emulator` and `system` cannot take turns in this way."""
    spec = emulator.spec
    if not system.fits(spec):
        raise ArgumentError(
            f"system: wanted {spec.system}, which the emulator is of; got {system.name}."
        )
    if not system.can_simulate:
        raise ArgumentError(
            f"{system.name} is known from recordings alone: no physics can take over. Use its emulator."
        )
    if not threshold >= 0:  # refuses NaN, too
        raise ArgumentError(
            f"threshold: wanted a score of 0 (all physics) or more, got {threshold}. 1 is the edge of training."
        )
    if physics_steps < 1:
        raise ArgumentError(f"physics_steps: wanted 1 or more, got {physics_steps}.")


@dataclass
class _Relay:
    """An emulator and a system in turns, their controls and the threshold."""

    emulator: Emulator
    system: System
    controls: Float[np.ndarray, "T C"]
    threshold: float
    physics_steps: int

    def run(self, start: Float[np.ndarray, " S"]) -> HybridMotion:
        """Return the motion from `start`."""
        steps = len(self.controls)
        states = np.empty((steps + 1, len(start)))
        states[0] = start
        scores = np.zeros(steps)
        is_physics = np.zeros(steps, bool)
        now = 0
        while now < steps:
            emulated, known, refused = self._leap(states[now], now)
            after = now + len(emulated)
            states[now + 1 : after + 1] = emulated
            scores[now:after] = known
            now = after
            if now == steps:
                break
            simulated, known = self._simulate(states[now], now)
            after = now + len(simulated)
            states[now + 1 : after + 1] = simulated
            scores[now:after] = known
            # The score for which the physics took over: a deformable body's decoded state has a slightly different one.
            scores[now] = refused
            is_physics[now:after] = True
            now = after
        return HybridMotion(states, scores, is_physics)

    def _leap(
        self, state: Float[np.ndarray, " S"], now: int
    ) -> tuple[Float[np.ndarray, "L S"], Float[np.ndarray, " L"], float]:
        """Return the states after each trusted leap from `state` on, their scores, and the score of the first leap that is
        not trusted; NaN if all are.
        """
        left = len(self.controls) - now
        length = LOOK_AHEAD
        while True:
            # Few different lengths, so that JAX has few programs to compile.
            chosen = (now + np.arange(length)).clip(max=len(self.controls) - 1)
            states, scores = self.emulator.rollout_trusted(
                state, self.controls[chosen], may_diverge=True
            )
            count = min(_first(~(scores < self.threshold)), left)
            if count < length or length >= left:
                break
            length *= 2
        emulated = states[1 : count + 1]
        if not np.isfinite(emulated).all():
            raise DivergedError(
                "The motion diverged on the emulator where its score was below the threshold. Choose a lower threshold."
            )
        refused = float(scores[count]) if count < left else np.nan
        return np.asarray(emulated, float), scores[:count], refused

    def _simulate(
        self, state: Float[np.ndarray, " S"], now: int
    ) -> tuple[Float[np.ndarray, "L S"], Float[np.ndarray, " L"]]:
        """Return the states by the physics from `state` on until the emulator is trusted again, and the scores on the way."""
        left = len(self.controls) - now
        length = min(self.physics_steps, left)
        while True:
            # From the same state each time: the physics in one piece gives the same bits as by itself.
            held = self.controls[now : now + length]
            runs = self.system.simulate_fastest(state[None], held[None], self.emulator.dt)
            if runs.has_diverged[0]:
                raise DivergedError(
                    f"The physics of {self.system.name} diverged from super step {now} on. Start nearer to what occurs in use."
                )
            states = runs.states[0]
            # One control more, if there is one: the emulator may leap from where the physics ends.
            ahead = self.controls[now : now + length + 1]
            scores = self.emulator.trust(states[: len(ahead)], ahead)
            is_back = scores[self.physics_steps :] < self.threshold
            count = self.physics_steps + _first(is_back)
            if is_back.any() or length == left:
                count = min(count, length)
                return states[1 : count + 1], scores[:count]
            length = min(2 * length, left)


def _first(is_so: Bool[np.ndarray, " N"]) -> int:
    """Return the index of the first True in `is_so`; its length if there is none."""
    return int(np.argmax(is_so)) if is_so.any() else len(is_so)
