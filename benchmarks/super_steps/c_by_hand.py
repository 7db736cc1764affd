"""C written by hand, where somebody has done it: the limit."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from benchmarks.super_steps.by_hand import written_by_hand
from benchmarks.super_steps.case import STEPS, SUPER_STEP, Case, Motion

NAME = "C by hand"


def cases(motion: Motion) -> Iterator[Case]:
    """Yield the rollout, if it is written: it has been held against JAX."""
    program = written_by_hand(motion.emulator)
    if program is not None:
        run = partial(program.rollout, motion.latent, motion.controls)
        yield Case(NAME, SUPER_STEP, STEPS, run)
