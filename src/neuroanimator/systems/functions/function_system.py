"""A system whose physics is a Python function of the user's."""

from __future__ import annotations

from typing import Any

import numpy as np

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.parsing.numbers import MAX_MAGNITUDE
from neuroanimator.systems.functions.step_file import StepFunction, call_step, run_file
from neuroanimator.systems.state_parts import (
    layout_of_control,
    layout_of_state,
    numbers_of,
    structure_of_parts,
)
from neuroanimator.systems.system import Scheme, System

FUNCTION = "function"
"""The only integrator there is: the function itself, called with a smaller or a larger dt."""


class PythonSystem(System):
    """The user's `step`, called again and again.

    The definition holds the file's name and sha256 and no code. The file is run when the first step
    is taken, and only if the user allowed that: see `loading.trust_files`.
    """

    is_self_contained = False

    def __init__(
        self, definition: PythonDefinition, files: dict[str, Any], definition_text: str = ""
    ):
        """`files` holds the name and the sha256 of the step file; `definition_text` is what both were read from."""
        self.name = definition.name
        self.definition_text = definition_text
        self.file: str = files["name"]
        self.sha256: str = files["sha256"]
        self.batched = definition.batched
        self.state = layout_of_state(definition.state)
        self.control, self.bounds = layout_of_control(definition.control)
        physics = definition.physics
        self.scheme = Scheme(FUNCTION, physics.step)
        self.truth = Scheme(FUNCTION, physics.truth_step)
        self.fine = Scheme(FUNCTION, physics.fine_step)
        self.structure = structure_of_parts(definition.state)
        self.skeleton = Skeleton(())
        self.rest = numbers_of(definition.state, "rest")
        self.spread = numbers_of(definition.state, "spread")
        self.sampling = definition.sampling
        self.goals = self.goals_of(definition.goals)

    @property
    def function(self) -> StepFunction:
        """The user's function; BadFileError unless the user allowed its file to be run."""
        return run_file(self.sha256, self.file).step

    def _simulate(
        self,
        states: np.ndarray,
        controls: np.ndarray,
        scheme: Scheme,
        substeps: int,
        threads: int,
    ) -> None:
        function = self.function
        for t in range(controls.shape[1]):
            now = states[:, t].copy()
            for _ in range(substeps):
                self._advance(function, now, controls[:, t], scheme.dt)
            states[:, t + 1] = now

    def has_diverged(self, states: np.ndarray) -> np.ndarray:
        """Return (B,) True for each run (B, T+1, S) with a state that is not finite or too large for a dataset."""
        return np.asarray(are_too_large(states).any(axis=1))

    def _advance(
        self, function: StepFunction, states: np.ndarray, controls: np.ndarray, dt: float
    ) -> None:
        """Take one step of all `states` (B, S) in place; those that have diverged stay as they are."""
        going = np.flatnonzero(~are_too_large(states))
        if self.batched and len(going):
            columns = call_step(function, self.file, states[going].T, controls[going].T, dt)
            states[going] = columns.T
            return
        for row in going:
            states[row] = call_step(function, self.file, states[row], controls[row], dt)

    def sample_starts(self, rng: np.random.Generator, count: int) -> np.ndarray:
        is_near_rest = rng.random(count) < self.sampling.rest_share
        width = np.where(is_near_rest, self.sampling.rest_spread, 1.0)[:, None]
        offsets = rng.uniform(-1, 1, (count, self.state.size))
        return self.rest + offsets * self.spread * width


def are_too_large(states: np.ndarray) -> np.ndarray:
    """Return (...,) True for each state (..., S) that is not finite or too large for a dataset: it has diverged."""
    fits = np.abs(states) < MAX_MAGNITUDE  # false for NaN too
    return np.asarray(~fits.all(axis=-1))
