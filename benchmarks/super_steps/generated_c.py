"""C generated from the definition: the kernel alone, as users call it from Python, gradients and batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.super_steps.case import (
    BATCH_STEPS,
    BATCHES,
    GRADIENT,
    GRADIENT_STEPS,
    STEPS,
    SUPER_STEP,
    Case,
    Motion,
    batch_task,
)
from neuroanimator import Emulator, set_backend
from neuroanimator.control.descent.c_evaluator import c_evaluator
from neuroanimator.emulator.c_emulator import c_emulator
from neuroanimator.errors import ResourceError

NAME = "C"

CALLS = 20
"""Calls of `emulator.step` one after the other."""


def cases(motion: Motion) -> Iterator[Case]:
    """Yield the cases of one emulator."""
    emulator = motion.emulator
    program = c_emulator(emulator)
    if program is None:
        raise ResourceError("runtimes: there is no program in C here. Install a C compiler.")
    yield Case(NAME, SUPER_STEP, STEPS, partial(program.rollout, motion.rest, motion.controls))
    for backend, name in (("c", NAME), ("jax", "JAX")):
        rollout = partial(emulator.rollout, motion.rest, motion.controls)
        yield Case(f"{name}, emulator.rollout", SUPER_STEP, STEPS, in_backend(backend, rollout))
        steps = partial(step_by_step, emulator, motion.rest, motion.controls[:CALLS])
        yield Case(f"{name}, emulator.step", SUPER_STEP, CALLS, in_backend(backend, steps))
    evaluator = c_evaluator(motion.problem)
    if evaluator is None:
        raise ResourceError("runtimes: there is no descent in C here.")
    gradient = partial(evaluator.gradients, motion.no_control)
    yield Case(NAME, GRADIENT, GRADIENT_STEPS, gradient)
    for batch in BATCHES:
        together = partial(program.rollouts, *motion.batch(batch))
        yield Case(NAME, batch_task(batch), batch * BATCH_STEPS, together)


def step_by_step(
    emulator: Emulator, state: Float[np.ndarray, " S"], controls: Float[np.ndarray, "T C"]
) -> None:
    """Make one super step after another, as a loop of a user's does."""
    for control in controls:
        state = emulator.step(state, control)


def in_backend(name: str, call: Callable[[], Any]) -> Callable[[], None]:
    """Return `call` by the backend `name`."""

    def called() -> None:
        set_backend(name)
        call()

    return called
