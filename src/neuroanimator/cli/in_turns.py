"""Motions that an emulator and its physics simulate in turns, for `animate --hybrid`."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.animation.motion import Drive
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust import EDGE
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.learn.evaluation.hybrid_shares import HybridGain, hybrid_gain
from neuroanimator.physics.hybrid import HybridMotion, hybrid_rollout
from neuroanimator.physics.loading import trust_files


def motion_in_turns(
    model: Emulator, drive: Drive, threshold: float | None, system: Path | None
) -> tuple[HybridMotion, HybridGain]:
    """Return the motion that emulator and physics simulate in turns, and the gain from the physics."""
    if system:
        trust_files(system)
    physics = system_of(model)
    edge = EDGE if threshold is None else threshold
    motion = hybrid_rollout(model, physics, drive.start, drive.controls, threshold=edge)
    return motion, hybrid_gain(model, physics, motion, drive.controls)
