"""Solve a trial of a task as `synthesise` does by default, and time it."""

from __future__ import annotations

import time

import numpy as np

from neuroanimator.control.descent.gradient_check import gradient_trust
from neuroanimator.control.descent.options import DescentOptions
from neuroanimator.control.synthesis.attempt import SearchOptions
from neuroanimator.control.synthesis.synthesise import RESTARTS, Synthesis, synthesise
from neuroanimator.learn.tasks.solver import Solver
from neuroanimator.learn.tasks.task import Trial
from neuroanimator.systems.random_controls import sample_control_runs

CORRECTIONS = 16
"""Maximum number of replays whose defects are added to the emulator."""

RANDOM_CONTROLS = 6
"""Number joined to that of a trial as the seed of the controls at which its gradient is checked."""


def descent_of(solver: Solver, trial: Trial) -> DescentOptions:
    """Return the options of a descent in `trial`, as its task says."""
    return DescentOptions(
        method=solver.task.method,
        starts=solver.task.starts,
        first=trial.first,
        parametrisation=solver.parametrisation,
    )


def solve_trial(
    solver: Solver, trial: Trial, *, is_warm_up: bool = False
) -> tuple[Synthesis, float]:
    """Return (the synthesis for `trial`, the time it took [s]), replays included, without training.

    A warm-up compiles everything that may be needed: it corrects once in any case.
    """
    began = time.perf_counter()
    descent = descent_of(solver, trial)
    options = SearchOptions(descent, corrections=1)
    if not is_warm_up:
        options = SearchOptions(
            descent, corrections=CORRECTIONS, restarts=RESTARTS, is_enough=trial.is_success
        )
    synthesis = synthesise(
        solver.emulator,
        solver.system,
        trial.objective,
        trial.start,
        steps=solver.steps,
        options=options,
    )
    return synthesis, time.perf_counter() - began


def gradient_cosine(solver: Solver, trial: Trial, number: int) -> float:
    """Return the gradient's cosine with the physics' at the first guess, or at random controls without one."""
    emulator = solver.emulator
    controls = trial.first
    if controls is None:
        rng = np.random.default_rng([number, RANDOM_CONTROLS])
        controls = sample_control_runs(rng, 1, solver.steps, emulator.dt, solver.system)[0]
    trust = gradient_trust(
        emulator,
        solver.system,
        trial.objective,
        solver.parametrisation,
        trial.start,
        controls,
    )
    return trust.cosine
