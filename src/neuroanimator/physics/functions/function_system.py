"""A system whose physics is the user's Python function."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.definitions.parts import ParameterTable
from neuroanimator.errors import ArgumentError
from neuroanimator.files.numbers import MAX_MAGNITUDE
from neuroanimator.physics.functions.step_file import StepFunction, call_step, run_file
from neuroanimator.physics.schemes import schemes_of
from neuroanimator.physics.state_parts import (
    layout_of_control,
    layout_of_state,
    numbers_of,
    parameter_from_table,
    structure_of_parts,
    with_parameters,
    wrapping_entries,
)
from neuroanimator.state.layout import Layout
from neuroanimator.state.parameters import (
    Parameter,
    nominal_values,
)
from neuroanimator.state.units import known_unit
from neuroanimator.systems.system import Scheme, System
from neuroanimator.text import quoted

WHOLE_TURN = 2 * np.pi
"""Jump of an angle that leaves it the same [rad]."""

FUNCTION = "function"
"""Name of the only integrator: the function itself, called with a smaller or a larger dt."""


class PythonSystem(System):
    """The user's `step`, called repeatedly.

    The definition holds the file's name and sha256 but no code. The file is run at the first step, and only if the user
    has allowed it: see `loading.trust_files`.
    """

    is_self_contained = False
    has_ground = True

    def __init__(
        self, definition: PythonDefinition, files: dict[str, Any], definition_text: str = ""
    ):
        """`files` holds the name and the sha256 of the step file; `definition_text` is the text of both."""
        self.name = definition.name
        self.definition_text = definition_text
        self.file: str = files["name"]
        self.sha256: str = files["sha256"]
        self.batched = definition.batched
        self.parameters = tuple(
            _parameter(name, table) for name, table in definition.parameters.items()
        )
        self._arguments = tuple(table.sets for table in definition.parameters.values())
        moving = layout_of_state(definition.state)
        constant = tuple(parameter.slice for parameter in self.parameters)
        self.state = Layout((*moving.slices, *constant))
        self.control, self.bounds = layout_of_control(definition.control)
        self.scheme, self.truth, self.fine = schemes_of(definition.physics, FUNCTION)
        self.structure = with_parameters(
            structure_of_parts(definition.state), moving.size, len(self.parameters)
        )
        self._angles = wrapping_entries(definition.state)
        self.skeleton = Skeleton(())
        self.rest = np.append(numbers_of(definition.state, "rest"), nominal_values(self.parameters))
        self.spread = np.append(
            numbers_of(definition.state, "spread"), np.zeros(len(self.parameters))
        )
        self.sampling = definition.sampling
        self.goals = self.goals_of(definition.goals)

    @property
    def function(self) -> StepFunction:
        """The user's function; BadFileError unless the user has allowed its file to run."""
        return run_file(self.sha256, self.file).step

    def _simulate(
        self,
        states: Float[np.ndarray, "B _ S"],
        controls: Float[np.ndarray, "B T C"],
        scheme: Scheme,
        substeps: int,
        threads: int,
    ) -> None:
        function = self.function
        for super_step in range(controls.shape[1]):
            current = states[:, super_step].copy()
            for _ in range(substeps):
                self._advance(function, current, controls[:, super_step], scheme.dt)
            states[:, super_step + 1] = current

    def has_diverged(self, states: Float[np.ndarray, "B T S"]) -> Bool[np.ndarray, " B"]:
        """Return whether each run has a state that is not finite or too large for a dataset."""
        return np.asarray(are_too_large(states).any(axis=1))

    def _advance(
        self,
        function: StepFunction,
        states: Float[np.ndarray, "B S"],
        controls: Float[np.ndarray, "B C"],
        dt: float,
    ) -> None:
        """Take one step of all `states` in place, except diverged ones.

        Angles are unwrapped where the function makes them jump from pi to -pi.
        """
        alive = np.flatnonzero(~are_too_large(states))
        before = states[:, self._angles]
        if self.batched and len(alive):
            states[alive] = self._next(function, states[alive].T, controls[alive].T, dt).T
        else:
            for row in alive:
                states[row] = self._next(function, states[row], controls[row], dt)
        if self._angles:
            with np.errstate(invalid="ignore"):  # diverged states
                change = states[:, self._angles] - before
            is_jump = np.isfinite(change) & (np.abs(change) > WHOLE_TURN / 2)
            turns = np.round(np.where(is_jump, change, 0.0) / WHOLE_TURN)
            states[:, self._angles] -= WHOLE_TURN * turns

    def next_state(
        self, state: Float[np.ndarray, " S *B"], control: Float[np.ndarray, " C *B"], dt: float
    ) -> Float[np.ndarray, " S *B"]:
        """Return the function's own result for one state, or for a batch."""
        return self._next(self.function, state, control, dt)

    def _next(
        self,
        function: StepFunction,
        state: Float[np.ndarray, " S *B"],
        control: Float[np.ndarray, " C *B"],
        dt: float,
    ) -> Float[np.ndarray, " S *B"]:
        moving = state[: self.parameter_entries.start]
        arguments = self.arguments_of(state)
        following = call_step(function, self.file, moving, control, dt, arguments)
        return np.concatenate([following, state[self.parameter_entries]])

    def arguments_of(self, state: Float[np.ndarray, " S *B"]) -> dict[str, Any]:
        """Return the function's further arguments by name: the parameters of the body or bodies in `state`."""
        values = state[self.parameter_entries]
        return dict(zip(self._arguments, values, strict=True))

    def sample_starts(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, "B S"]:
        is_near_rest = rng.random(count) < self.sampling.rest_share
        width = np.where(is_near_rest, self.sampling.rest_spread, 1.0)[:, None]
        offsets = rng.uniform(-1, 1, (count, self.state.size))
        starts = self.rest + offsets * self.spread * width
        self.draw_bodies(rng, starts)
        return starts

    def sample_resets(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, "B S"]:
        starts = super().sample_resets(rng, count)
        self.draw_bodies(rng, starts)
        return starts


def _parameter(name: str, table: ParameterTable) -> Parameter:
    """Return the parameter that is an argument of a step function."""
    if not table.sets.isidentifier():
        raise ArgumentError(
            f"parameters.{name}.sets: wanted the name of an argument of step, got {quoted(table.sets)}."
        )
    unit = known_unit(table.unit or "1", f"parameters.{name}")
    middle = (table.range[0] + table.range[1]) / 2
    return parameter_from_table(name, table, unit, middle)


def are_too_large(states: Float[np.ndarray, "*B S"]) -> Bool[np.ndarray, "*B"]:
    """Return whether each state has diverged: it is not finite or too large for a dataset."""
    fits = np.abs(states) < MAX_MAGNITUDE  # False for NaN
    return np.asarray(~fits.all(axis=-1))
