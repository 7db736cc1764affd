"""Solve a task's trials as `synthesise` does by default, and time it."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from neuroanimator.control.descent.gradient_check import gradient_trust
from neuroanimator.control.descent.options import DescentOptions
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.synthesis.attempt import SearchOptions
from neuroanimator.control.synthesis.synthesise import RESTARTS, Synthesis, synthesise
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.files.zoo import emulator_name
from neuroanimator.learn.tasks.task import Task, Trial
from neuroanimator.physics import load_system
from neuroanimator.systems.random_controls import sample_control_runs
from neuroanimator.systems.system import System

CORRECTIONS = 16
"""Maximum number of replays whose defects are added to the emulator."""

TRIALS = 5
"""Number joined to that of a trial as its seed."""

RANDOM_CONTROLS = 6
"""Number joined to that of a trial as the seed of the controls at which its gradient is checked."""


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

    def solve(self, trial: Trial, *, is_warm_up: bool = False) -> tuple[Synthesis, float]:
        """Return (the synthesis for `trial`, the time it took [s]), replays included, without training.

        A warm-up compiles everything that may be needed: it corrects once in any case.
        """
        began = time.perf_counter()
        descent = DescentOptions(
            method=self.task.method,
            starts=self.task.starts,
            first=trial.first,
            parametrisation=self.parametrisation,
        )
        options = SearchOptions(descent, corrections=1)
        if not is_warm_up:
            options = SearchOptions(
                descent, corrections=CORRECTIONS, restarts=RESTARTS, is_enough=trial.is_success
            )
        synthesis = synthesise(
            self.emulator,
            self.system,
            trial.objective,
            trial.start,
            steps=self.steps,
            options=options,
        )
        return synthesis, time.perf_counter() - began

    def cosine(self, trial: Trial, number: int) -> float:
        """Return the gradient's cosine with the physics' at the first guess, or at random controls without one."""
        controls = trial.first
        if controls is None:
            rng = np.random.default_rng([number, RANDOM_CONTROLS])
            controls = sample_control_runs(rng, 1, self.steps, self.emulator.dt, self.system)[0]
        trust = gradient_trust(
            self.emulator,
            self.system,
            trial.objective,
            self.parametrisation,
            trial.start,
            controls,
        )
        return trust.cosine
