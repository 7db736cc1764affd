"""Motions of controllers: the tasks that ship, solved by descents through an emulator and played on the physics."""

from __future__ import annotations

import numpy as np

from benchmarks.control.solve_trial import descent_of
from neuroanimator import Emulator
from neuroanimator.control.descent.descend import descend
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.learn.tasks.all_tasks import TASKS
from neuroanimator.learn.tasks.solver import Solver
from neuroanimator.learn.tasks.task import Trial
from neuroanimator.learn.training.error_fitting import UnseenRuns, simulate_unseen, steps_of
from neuroanimator.systems.system import System

CANDIDATES = 6
"""Number of controls played of those that the first guesses of a descent came to, the best first."""

SEED = 7
"""Joins the number of a trial, which is drawn apart from those that `benchmarks/control/control.py` solves."""


def task_motions(emulator: Emulator, system: System, trials: range) -> UnseenRuns | None:
    """Return windows out of motions that solve the system's tasks, as long as errors are bounded; None without a task.

    Two of each motion: from where it begins, and from somewhere on the physics' way. They are what a descent comes to at
    once: no corrections by replays, which would take away what optimisation gains by the emulator's errors.
    """
    rng = np.random.default_rng([SEED, trials.start])
    steps = steps_of(emulator)
    states: list[np.ndarray] = []
    controls: list[np.ndarray] = []
    for task in TASKS.values():
        if task.system != emulator.system:
            continue
        if task.knots > round(task.seconds / emulator.dt):
            continue  # in super steps as long as these it has no room for its splines
        solver = Solver.of(task, system, emulator)
        for number in trials:
            runs = _solved(solver, solver.draw(10_000 + number))
            if runs is None:
                continue
            last = runs.controls.shape[1] - steps
            if last < 0:
                continue
            for first in (0, int(rng.integers(0, last + 1))):
                states.append(runs.states[:, first : first + steps + 1])
                controls.append(runs.controls[:, first : first + steps])
    if not states:
        return None
    return UnseenRuns(np.concatenate(states), np.concatenate(controls))


def _solved(solver: Solver, trial: Trial) -> UnseenRuns | None:
    """Return the best motions a descent comes to; None where the task cannot be descended from there."""
    options = descent_of(solver, trial)
    try:
        found = descend(
            solver.emulator, trial.objective, trial.start, steps=solver.steps, options=options
        )
    except NeuroAnimatorError:
        return None
    controls = found.candidates[:CANDIDATES]
    starts = np.repeat(np.asarray(trial.start, float)[None], len(controls), axis=0)
    return simulate_unseen(solver.emulator, solver.system, starts, controls)
