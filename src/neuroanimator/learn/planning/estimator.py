"""Online estimation of the controlled body's parameters from its own motion."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.identification.fit import Fitter
from neuroanimator.learn.identification.measurements import SHORTEST, Measurements
from neuroanimator.learn.identification.predictions import Predictor
from neuroanimator.learn.identification.unknowns import unknowns_of

WINDOWS = 48
"""Default number of windows of `SHORTEST` super steps that are remembered."""

EVERY = 8
"""Default number of super steps between estimates."""


class _Window(NamedTuple):
    """Consecutive super steps."""

    states: Float[np.ndarray, "F S"]
    controls: Float[np.ndarray, "T C"]


class ParameterEstimator:
    """Estimates parameters by Gauss-Newton steps through the emulator, over the last super steps.

    These are cut into short windows that begin at measured states; `identify` also searches for the starts, which takes
    a hundred times as long. Nothing is verified on the physics: a parameter is as good as the emulator. Parameters that the
    last motion does not show stay at their nominal values.
    """

    def __init__(self, emulator: Emulator, *, windows: int = WINDOWS, every: int = EVERY):
        """Begin with the parameters of the emulator's rest, which `emulator.at` sets.

        Every `every` super steps there is an estimate from the last `windows` windows of four super steps.

        Raises ArgumentError for an emulator without parameters, and for numbers below 1.
        """
        if not emulator.parameters:
            raise ArgumentError(
                f"{emulator.system}: its emulator is of one body and has no parameters to estimate. Use one of a family."
            )
        if min(windows, every) < 1:
            raise ArgumentError(f"windows and every: wanted at least 1, got {windows} and {every}.")
        self.emulator = emulator
        self.windows = windows
        self.every = every
        self._entries = list(emulator.parameter_entries)
        self._moving = np.setdiff1d(np.arange(emulator.state.size), self._entries)
        self.values: Float[np.ndarray, " P"] = emulator.rest[self._entries].copy()
        """The last estimate, in the order of `emulator.parameters`."""
        self._remembered: deque[_Window] = deque(maxlen=windows)
        self._states: list[Float[np.ndarray, " S"]] = []
        self._controls: list[Float[np.ndarray, " C"]] = []
        self._observed = 0
        self._noise: Float[np.ndarray, " S"] | None = None

    def believed(self, state: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
        """Return `state` with the estimated parameters."""
        believed = state.copy()
        believed[self._entries] = self.values
        return believed

    def observe(
        self,
        state: Float[np.ndarray, " S"],
        control: Float[np.ndarray, " C"],
        following: Float[np.ndarray, " S"],
    ) -> None:
        """Add a super step from `state` to the `following` one; the parameters in them are ignored."""
        if not self._states or self._is_pushed(state):
            self._states = [state]
            self._controls = []
        self._states.append(following)
        self._controls.append(control)
        if len(self._controls) == SHORTEST:
            self._remembered.append(_Window(np.stack(self._states), np.stack(self._controls)))
            self._states = [following]
            self._controls = []
        self._observed += 1
        if self._observed % self.every == 0 and self._remembered:
            self._estimate()

    def _is_pushed(self, state: Float[np.ndarray, " S"]) -> bool:
        """Return whether the body is not where the last super step led: no motion explains a push."""
        return not np.array_equal(state[self._moving], self._states[-1][self._moving])

    def _estimate(self) -> None:
        windows = self._windows_of_fixed_number()
        unknowns = unknowns_of(self.emulator, windows)
        predictor = Predictor(self.emulator, windows, unknowns, knows_starts=True)
        fitter = Fitter(windows, predictor, unknowns)
        begin = np.clip(self.values, unknowns.low, unknowns.high)
        first = replace(fitter.first_guess(), values=begin)
        if self._noise is not None:
            first = replace(first, noise=self._noise)
        fit = fitter.fitted(first, predictor.by_emulator).fit
        self.values = fit.values
        self._noise = fit.noise

    def _windows_of_fixed_number(self) -> Measurements:
        """Return the windows, with NaN in place of missing ones, so that nothing is recompiled."""
        shape = (self.windows, SHORTEST + 1, self.emulator.state.size)
        states = np.full(shape, self.emulator.rest)
        measured = np.full(shape, np.nan)
        controls = np.tile(self.emulator.bounds.idle, (self.windows, SHORTEST, 1))
        for place, window in enumerate(self._remembered):
            states[place] = window.states
            measured[place, 1:] = window.states[1:]
            controls[place] = window.controls
        measured[..., self._entries] = np.nan
        return Measurements(measured, controls, states, (), tuple(self._moving.tolist()), ())
