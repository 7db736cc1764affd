"""The C twin of a mass-spring body: the same physics compiled for one core, the opponent of its emulators."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from neuroanimator.codegen.compiler import compiled_library, find_compiler
from neuroanimator.physics.deformable.body import Body
from neuroanimator.physics.deformable.mass_spring import STEPPERS
from neuroanimator.physics.deformable.native.source import c_source

INTEGRATORS = tuple(STEPPERS)
"""Names of the integrators, in the order of the C program."""

SINGLE_LANES = 16
"""Number of bodies side by side in a batch of float32: one AVX-512 register, two of AVX."""


@dataclass(frozen=True, eq=False)
class CTwin:
    """A body's physics in C: bodies are stepped `lanes` at a time, each on one core."""

    library: ctypes.CDLL
    size: int
    """Number of entries of a state: positions, velocities, activations, parameters."""
    dtype: type[np.floating]
    """Number type: float32 or float64."""
    lanes: int
    """Number of bodies stepped side by side."""

    def play(
        self,
        start: Float[np.ndarray, "S ..."],
        controls: Float[np.ndarray, "T C ..."],
        integrator: str,
        dt: float,
        steps: int,
    ) -> Float[np.ndarray, "T S ..."]:
        """Return the states after each of the controls, each held for `steps` steps of `dt` [s].

        Several lanes are the last axis L of all arrays; a single one has no such axis.
        """
        start = self._prepared(start)
        controls = self._prepared(controls)
        states = np.empty((len(controls), *start.shape), self.dtype)
        self._play((start, controls, states), (1, len(controls), steps), integrator, dt)
        return states

    def advance(
        self,
        starts: Float[np.ndarray, "B S"],
        controls: Float[np.ndarray, "B C"],
        integrator: str,
        dt: float,
        steps: int,
    ) -> Float[np.ndarray, "B S"]:
        """Return the states `steps` steps of `dt` [s] after `starts` under held controls; B is a multiple of the lanes."""
        play = self.player(starts, controls, integrator, dt, steps)
        return np.moveaxis(play(), 1, 2).reshape(starts.shape)

    def player(
        self,
        starts: Float[np.ndarray, "B S"],
        controls: Float[np.ndarray, "B C"],
        integrator: str,
        dt: float,
        steps: int,
    ) -> Callable[[], Float[np.ndarray, "G S L"]]:
        """Return a function that advances in one call of C and returns the states in groups of L lanes, always the same array."""
        start_groups = self._prepared(self._side_by_side(starts))
        control_groups = self._prepared(self._side_by_side(controls))
        ends = np.empty_like(start_groups)
        arrays = (start_groups, control_groups, ends)

        def play() -> Float[np.ndarray, "G S L"]:
            self._play(arrays, (len(start_groups), 1, steps), integrator, dt)
            return ends

        return play

    def _side_by_side(self, rows: Float[np.ndarray, "B X"]) -> Float[np.ndarray, "G X L"]:
        """Return the rows in groups of the number of lanes, which come last."""
        return np.moveaxis(rows.reshape(-1, self.lanes, rows.shape[-1]), 1, 2)

    def _prepared(self, numbers: np.ndarray) -> np.ndarray:
        """Return the numbers as C reads them: contiguous, in its precision."""
        return np.ascontiguousarray(numbers, self.dtype)

    def _play(
        self,
        arrays: tuple[np.ndarray, np.ndarray, np.ndarray],
        counts: tuple[int, int, int],
        integrator: str,
        dt: float,
    ) -> None:
        """Fill the last of (starts, controls, states); `counts` are groups of lanes, controls of each, steps of each control."""
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in arrays]
        lengths = [ctypes.c_long(count) for count in counts]
        number = INTEGRATORS.index(integrator)
        self.library.play(number, *lengths, ctypes.c_double(dt), *pointers)


def c_twin(body: Body, dtype: type[np.floating] = np.float32, lanes: int = 1) -> CTwin | None:
    """Return the C twin of `body`, compiled at the first call; None without a C compiler."""
    if find_compiler() is None:
        return None
    precision = "float" if dtype is np.float32 else "double"
    library = compiled_library(c_source(body, precision, lanes))
    if library is None:
        return None
    state_size = 6 * len(body.masses) + body.muscles.shape[1] + len(body.varied)
    return CTwin(library, state_size, dtype, lanes)
