"""Gain of taking turns with the physics: the physics' share of the time, and the motions' errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust import EDGE
from neuroanimator.learn.evaluation.accuracy import emulate, rollout_error, root_mean_square
from neuroanimator.learn.evaluation.held_out import HeldOut, system_of
from neuroanimator.physics.hybrid import HybridMotion, hybrid_rollout
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.system import System

THRESHOLDS = (2.0, 1.0, 0.5, 0.25)
"""Trust scores above which the physics takes over, in reports: from well beyond the edge of training to its middle."""

RUN_SECONDS = 2.0
"""Maximum length of runs [s]."""


@dataclass(frozen=True)
class HybridGain:
    """Gain of turns with the physics."""

    physics_share: float
    """Share of the super steps that the physics made."""
    error: float
    """Rms error over the physics' distance from the start: at the end of several motions, or along a single one."""
    emulator_error: float
    """That of the emulator alone."""

    @property
    def gain(self) -> float:
        """Factor by which the error is smaller than the emulator's alone."""
        return self.emulator_error / self.error if self.error else float("inf")

    def __str__(self) -> str:
        return (
            f"{self.physics_share:.0%} of the time by physics; error {self.error:.3g}, of the emulator alone "
            f"{self.emulator_error:.3g} (over how far the motion gets)"
        )


def hybrid_shares(emulator: Emulator, test: HeldOut, count: int) -> dict[float, HybridGain]:
    """Return the gain at each of `THRESHOLDS` on the first seconds of `count` unseen runs."""
    steps = min(test.controls.shape[1], round(RUN_SECONDS / emulator.dt) or 1)
    truth = test.states[:count, : steps + 1]
    controls = test.controls[:count, :steps]
    alone = emulate(emulator, truth[:, 0], controls)
    emulator_error = float(rollout_error(test.frame, alone, truth)[-1])
    found = {}
    for threshold in THRESHOLDS:
        motions = [
            hybrid_rollout(emulator, test.system, states[0], held, threshold=threshold)
            for states, held in zip(truth, controls, strict=True)
        ]
        states = np.stack([motion.states for motion in motions])
        share = float(np.mean([motion.physics_share for motion in motions]))
        error = float(rollout_error(test.frame, states, truth)[-1])
        found[threshold] = HybridGain(share, error, emulator_error)
    return found


def motion_in_turns(
    emulator: Emulator,
    start: Float[np.ndarray, " S"],
    controls: Float[np.ndarray, "T C"],
    threshold: float | None,
) -> tuple[HybridMotion, HybridGain]:
    """Return the motion that emulator and physics simulate in turns, and the gain from the physics."""
    physics = system_of(emulator)
    edge = EDGE if threshold is None else threshold
    motion = hybrid_rollout(emulator, physics, start, controls, threshold=edge)
    return motion, hybrid_gain(emulator, physics, motion, controls)


def hybrid_gain(
    emulator: Emulator, system: System, motion: HybridMotion, controls: Float[np.ndarray, "T C"]
) -> HybridGain:
    """Return the gain of the turns of `motion`: it is compared with the physics alone from the same start."""
    start = motion.states[0]
    truth = system.simulate_fastest(start[None], controls[None], emulator.dt).states
    alone = emulate(emulator, start[None], controls[None])
    frame = Frame.of(system.structure, emulator.dt)
    errors = [
        float(root_mean_square(rollout_error(frame, states, truth)))
        for states in (motion.states[None], alone)
    ]
    return HybridGain(motion.physics_share, *errors)
