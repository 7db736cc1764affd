"""A task with what solves it: its system, its emulator and its numbered trials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.files.zoo import emulator_name
from neuroanimator.learn.tasks.task import Task, Trial
from neuroanimator.physics import load_system
from neuroanimator.systems.system import System

TRIALS = 5
"""Number joined to that of a trial as its seed."""


@dataclass(frozen=True)
class Solver:
    """A task with the means to solve it."""

    task: Task
    system: System
    emulator: Emulator
    steps: int
    """Number of super steps of the motion."""
    parametrisation: Parametrisation

    @classmethod
    def of(cls, task: Task, system: System, emulator: Emulator) -> Solver:
        """Return the solver of `task` on `system`, emulated by `emulator`."""
        steps = round(task.seconds / emulator.dt)
        return cls(task, system, emulator, steps, task.parametrisation(system, steps, emulator.dt))

    @classmethod
    def shipped(cls, task: Task) -> Solver:
        """Return the solver of `task` with the shipped system and emulator."""
        emulator = Emulator.load(emulator_name(task.system, task.substeps))
        return cls.of(task, load_system(task.system), emulator)

    def draw(self, number: int) -> Trial:
        """Return trial `number`, always the same one."""
        rng = np.random.default_rng([number, TRIALS])
        return self.task.draw(self.system, rng, self.steps, self.emulator.dt)
