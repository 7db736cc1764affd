"""One thing to be timed, and the motion that all runtimes compute."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator import Emulator
from neuroanimator.control.descent.descend import pose_problem
from neuroanimator.control.descent.parametrisation import EachStep
from neuroanimator.control.descent.problem import Problem
from neuroanimator.control.objective.costs import effort, stay_within
from neuroanimator.control.objective.objective import Objective
from neuroanimator.physics import load_system

STEPS = 200
"""Super steps of a rollout."""

GRADIENT_STEPS = 100
"""Super steps of a motion of which J and its gradient are computed, as a descent asks for them."""

BATCHES = (16, 64, 1024)
"""Motions side by side."""

BATCH_STEPS = 10
"""Super steps of each motion of a batch."""

CONTROLS = 0.3
"""Random controls of at most this share of their range."""

SUPER_STEP = "super step"
GRADIENT = "gradient"


class Case(NamedTuple):
    """What a runtime does, again and again."""

    runtime: str
    task: str
    """`SUPER_STEP`, `GRADIENT` or that of `batch_task`."""
    steps: int
    """Super steps, of all motions, in a run: times are told for one."""
    run: Callable[[], Any]
    """It returns the seconds it took if it has measured them itself, in another process."""


def batch_task(batch: int) -> str:
    """Return what a batch of so many motions is called."""
    return f"batch of {batch}"


@dataclass(frozen=True)
class Motion:
    """A rollout from rest under random controls."""

    emulator: Emulator

    @cached_property
    def rest(self) -> Float[np.ndarray, " S"]:
        """The start."""
        return self.emulator.rest.astype(np.float32)

    @cached_property
    def latent(self) -> Float[np.ndarray, " I"]:
        """The latent state of the start."""
        return np.ascontiguousarray(self.emulator.encode(self.rest), np.float32)

    @cached_property
    def controls(self) -> Float[np.ndarray, "T C"]:
        """Controls of each super step."""
        rng = np.random.default_rng(0)
        bounds = self.emulator.bounds
        shares = rng.uniform(-CONTROLS, CONTROLS, (STEPS, len(bounds.half)))
        return np.asarray(bounds.middle + shares * bounds.half, np.float32)

    def batch(self, count: int) -> tuple[Float[np.ndarray, "B S"], Float[np.ndarray, "B T C"]]:
        """Return (starts, controls) of a batch: each motion has the controls of another time."""
        firsts = np.arange(count) % (STEPS - BATCH_STEPS)
        controls = np.stack([self.controls[first : first + BATCH_STEPS] for first in firsts])
        return np.tile(self.rest, (count, 1)), controls

    @cached_property
    def problem(self) -> Problem:
        """A descent's problem of `GRADIENT_STEPS` super steps, under controls of their own, whose J looks at every state."""
        emulator = self.emulator
        system = load_system(emulator.system)
        nearly_still = stay_within(system, system.state.slices[0].name, -1.0, 1.0, within=1.0)
        varied = EachStep.of(GRADIENT_STEPS, emulator.bounds)
        return pose_problem(emulator, Objective.of(effort(), nearly_still), varied, self.rest)

    @cached_property
    def no_control(self) -> Float[np.ndarray, "1 Z"]:
        """Where the gradient of `problem` is taken."""
        return np.zeros((1, self.problem.parametrisation.size))
