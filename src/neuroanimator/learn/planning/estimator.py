"""Online estimation of the controlled body's parameters from its own motion."""

from __future__ import annotations

from dataclasses import replace

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
        shape = (windows, SHORTEST + 1, emulator.state.size)
        # Missing windows are NaN, so that their number is fixed and nothing is recompiled.
        self._windows = Measurements(
            measured=np.full(shape, np.nan),
            controls=np.tile(emulator.bounds.idle, (windows, SHORTEST, 1)),
            guess=np.full(shape, emulator.rest),
            names=(),
            entries=tuple(self._moving.tolist()),
            files=(),
        )
        self._remembered = 0
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
            place = self._remembered % self.windows
            states = np.stack(self._states)
            self._windows.guess[place] = states
            measured = self._windows.measured[place]
            measured[1:, self._moving] = states[1:, self._moving]
            self._windows.controls[place] = self._controls
            self._remembered += 1
            self._states = [following]
            self._controls = []
        self._observed += 1
        if self._observed % self.every == 0 and self._remembered:
            self._estimate()

    def _is_pushed(self, state: Float[np.ndarray, " S"]) -> bool:
        """Return whether the body is not where the last super step led: no motion explains a push."""
        return not np.array_equal(state[self._moving], self._states[-1][self._moving])

    def _estimate(self) -> None:
        unknowns = unknowns_of(self.emulator, self._windows)
        predictor = Predictor(self.emulator, self._windows, unknowns, knows_starts=True)
        fitter = Fitter(self._windows, predictor, unknowns)
        begin = np.clip(self.values, unknowns.low, unknowns.high)
        first = replace(fitter.first_guess(), values=begin)
        if self._noise is not None:
            first = replace(first, noise=self._noise)
        fit = fitter.fitted(first, predictor.by_emulator).fit
        self.values = fit.values
        self._noise = fit.noise
