"""A system whose physics is a Python function of the user's."""

from __future__ import annotations

from typing import Any

import numpy as np

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.parsing.numbers import MAX_MAGNITUDE
from neuroanimator.systems.functions.step_file import StepFunction, call_step, run_file
from neuroanimator.systems.state_parts import (
    goals_of,
    layout_of_control,
    layout_of_state,
    numbers_of,
    structure_of_parts,
)
from neuroanimator.systems.system import Runs, Scheme, System

FUNCTION = "function"
"""The only integrator there is: the function itself, called with a smaller or a larger dt."""


class PythonSystem(System):
    """The user's `step`, called again and again.

    The definition holds the file's name and sha256 and no code. The file is run when the first step
    is taken, and only if the user allowed that: see `own.trust_files`.
    """

    def __init__(self, definition: PythonDefinition, files: dict[str, Any], text: str = ""):
        self.name, self.definition = definition.name, text
        self.file: str = files["name"]
        self.sha256: str = files["sha256"]
        self.batched = definition.batched
        self.state = layout_of_state(definition.state)
        self.control, self.bounds = layout_of_control(definition.control)
        physics = definition.physics
        self.scheme, self.truth, self.fine = (
            Scheme(FUNCTION, step) for step in (physics.step, physics.truth_step, physics.fine_step)
        )
        self.structure = structure_of_parts(definition.state)
        self.skeleton = Skeleton(())
        self.rest = numbers_of(definition.state, "rest")
        self.spread = numbers_of(definition.state, "spread")
        self.sampling = definition.sampling
        self.goals = self.with_starts(goals_of(self.state, definition.goals), definition.goals)

    @property
    def function(self) -> StepFunction:
        """The user's function; BadFileError unless the user allowed its file to be run."""
        return run_file(self.sha256, self.file).step

    def simulate(
        self,
        starts: np.ndarray,
        controls: np.ndarray,
        dt: float,
        *,
        scheme: Scheme | None = None,
        threads: int = 1,
    ) -> Runs:
        starts = self.state.check(starts, "state")
        controls = self.check_controls(controls)
        scheme, function = scheme or self.truth, self.function
        runs = np.empty((len(starts), controls.shape[1] + 1, self.state.size))
        runs[:, 0] = starts
        for t in range(controls.shape[1]):
            now = runs[:, t].copy()
            for _ in range(scheme.steps(dt)):
                self._advance(function, now, controls[:, t], scheme.dt)
            runs[:, t + 1] = now
        return Runs(runs, np.asarray(is_sane(runs).all(axis=1)))

    def _advance(
        self, function: StepFunction, states: np.ndarray, controls: np.ndarray, dt: float
    ) -> None:
        """Take one step of all `states` (B, S) in place; those that have blown up stay as they are."""
        alive = np.flatnonzero(is_sane(states))
        if self.batched and len(alive):
            columns = call_step(function, self.file, states[alive].T, controls[alive].T, dt)
            states[alive] = columns.T
            return
        for row in alive:
            states[row] = call_step(function, self.file, states[row], controls[row], dt)

    def sample_starts(self, rng: np.random.Generator, count: int) -> np.ndarray:
        near = rng.random(count) < self.sampling.rest_share
        width = np.where(near, self.sampling.rest_spread, 1.0)[:, None]
        return self.rest + rng.uniform(-1, 1, (count, self.state.size)) * self.spread * width


def is_sane(states: np.ndarray) -> np.ndarray:
    """Return (...,) False for each state (..., S) that is not finite or too large for a dataset: it has blown up."""
    return np.asarray((np.abs(states) < MAX_MAGNITUDE).all(axis=-1))  # false for NaN too
