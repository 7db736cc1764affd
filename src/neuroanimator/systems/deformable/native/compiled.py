"""The C twin of a mass-spring body: the same physics compiled for one core, the opponent of its emulators."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from neuroanimator.compiler.compiler import compiled_library, find_compiler
from neuroanimator.systems.deformable.body import Body
from neuroanimator.systems.deformable.native.source import c_source

INTEGRATORS = ("symplectic", "semi-implicit", "rk4")
"""In the order of the C program."""

LANES = 16
"""Bodies side by side in a batch: one AVX-512 register of float32, two of AVX."""


@dataclass(frozen=True, eq=False)
class CTwin:
    """A body's physics in C: bodies are stepped `lanes` at a time, each on one core."""

    library: ctypes.CDLL
    size: int
    """Numbers in a state: places, speeds, contractions."""
    dtype: type[np.floating]
    lanes: int

    def play(
        self, start: np.ndarray, controls: np.ndarray, integrator: str, dt: float, steps: int
    ) -> np.ndarray:
        """Return the states (T, S) after each of the controls (T, C), each held for `steps` steps of `dt` [s].

        With several lanes, start is (S, lanes), controls are (T, C, lanes) and so are the states.
        """
        start, controls = self._check(start), self._check(controls)
        states = np.empty((len(controls), *start.shape), self.dtype)
        self._call("play", (start, controls, states), len(controls), integrator, dt, steps)
        return states

    def advance(
        self, starts: np.ndarray, controls: np.ndarray, integrator: str, dt: float, steps: int
    ) -> np.ndarray:
        """Return the states (B, S) `steps` steps of `dt` [s] after `starts` (B, S) under held controls (B, C)."""
        ends = np.empty((len(starts) // self.lanes, self.size, self.lanes), self.dtype)
        self.player(starts, controls, integrator, dt, steps, ends)()
        return np.moveaxis(ends, 1, 2).reshape(starts.shape)

    def player(
        self,
        starts: np.ndarray,
        controls: np.ndarray,
        integrator: str,
        dt: float,
        steps: int,
        ends: np.ndarray | None = None,
    ) -> Callable[[], None]:
        """Return a function that does what `advance` does in one call of C, into `ends`."""
        starts, controls = (self._check(self._side_by_side(each)) for each in (starts, controls))
        ends = np.empty(starts.shape, self.dtype) if ends is None else ends
        return lambda: self._call(
            "advance", (starts, controls, ends), len(starts), integrator, dt, steps
        )

    def _side_by_side(self, rows: np.ndarray) -> np.ndarray:
        """Return rows (B, X) as (B / lanes, X, lanes)."""
        return np.moveaxis(rows.reshape(-1, self.lanes, rows.shape[-1]), 1, 2)

    def _check(self, numbers: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(numbers, self.dtype)

    def _call(
        self,
        name: str,
        arrays: tuple[np.ndarray, ...],
        count: int,
        integrator: str,
        dt: float,
        steps: int,
    ) -> None:
        pointers = (each.ctypes.data_as(ctypes.c_void_p) for each in arrays)
        kind = INTEGRATORS.index(integrator)
        getattr(self.library, name)(
            kind, ctypes.c_long(count), ctypes.c_long(steps), ctypes.c_double(dt), *pointers
        )


def c_twin(body: Body, dtype: type[np.floating] = np.float32, lanes: int = 1) -> CTwin | None:
    """Return the C twin of `body`, compiled at the first call; None where there is no C compiler."""
    if find_compiler() is None:
        return None
    library = compiled_library(c_source(body, "float" if dtype is np.float32 else "double", lanes))
    return library and CTwin(library, 6 * len(body.masses) + body.muscles.shape[1], dtype, lanes)
