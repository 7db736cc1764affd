"""Parameters of the body that is controlled, estimated on the way from its own motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from neuroanimator.control.identification.fit import Fitter
from neuroanimator.control.identification.measurements import SHORTEST, Measurements
from neuroanimator.control.identification.predictions import Predictor
from neuroanimator.control.identification.unknowns import unknowns_of
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError

WINDOWS = 48
"""Default number of windows of `SHORTEST` super steps that are remembered."""

EVERY = 8
"""Default number of super steps between estimates."""


class ParameterEstimator:
    """Estimates parameters by Gauss-Newton steps through the emulator, over the last super steps.

    As in `identify`, these are cut into short windows whose starts are unknown as well, so that noise in measured states
    does little harm. Nothing is proved on the physics: a parameter is as good as the emulator. What the last motion does
    not show stays at its nominal value.
    """

    def __init__(self, emulator: Emulator, *, windows: int = WINDOWS, every: int = EVERY):
        """Begin with the parameters of the emulator's rest: `emulator.at` sets other ones.

        An estimate is made from the last `windows` of four super steps, at each `every`-th super step.

        Raises ArgumentError for an emulator without parameters, and for numbers below 1.
        """
        if not emulator.parameters:
            raise ArgumentError(
                f"{emulator.system}: its emulator is of one body and has no parameters to estimate. Use one of a family."
            )
        if min(windows, every) < 1:
            raise ArgumentError(
                f"windows and every: wanted at least 1, came {windows} and {every}."
            )
        self.emulator = emulator
        self.windows = windows
        self.every = every
        entries = emulator.parameter_entries
        self.values: Float[np.ndarray, " P"] = emulator.rest[list(entries)].copy()
        """The last estimate, in the order of `emulator.parameters`."""
        self._entries = list(entries)
        self._states: list[Float[np.ndarray, " S"]] = []
        self._controls: list[Float[np.ndarray, " C"]] = []
        self._observed = 0

    def believed(self, state: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
        """Return `state` with the parameters as estimated."""
        believed = state.copy()
        believed[self._entries] = self.values
        return believed

    def observe(
        self,
        state: Float[np.ndarray, " S"],
        control: Float[np.ndarray, " C"],
        following: Float[np.ndarray, " S"],
    ) -> None:
        """Take in a super step from `state` to the `following` one; what they say of parameters is not looked at."""
        if not self._states:
            self._states.append(state)
        self._states.append(following)
        self._controls.append(control)
        self._observed += 1
        remembered = SHORTEST * self.windows
        self._states = self._states[-remembered - 1 :]
        self._controls = self._controls[-remembered:]
        if self._observed % self.every == 0 and self._observed >= SHORTEST:
            self._estimate()

    def _estimate(self) -> None:
        measured, controls = self._cut()
        guess = np.where(np.isnan(measured), self.emulator.rest, measured)
        moving = np.setdiff1d(np.arange(measured.shape[2]), self._entries)
        windows = Measurements(measured, controls, guess, (), tuple(moving.tolist()), ())
        unknowns = unknowns_of(self.emulator, windows)
        fitter = Fitter(windows, Predictor(self.emulator, windows, unknowns), unknowns)
        begin = np.clip(self.values, unknowns.low, unknowns.high)
        first = replace(fitter.first_guess(), values=begin)
        self.values = fitter.fitted(first, fitter.predictor.by_emulator).values

    def _cut(self) -> tuple[Float[np.ndarray, "W F S"], Float[np.ndarray, "W T C"]]:
        """Return the windows, the last one first; NaN of those to come, so that nothing is compiled anew."""
        measured = np.full((self.windows, SHORTEST + 1, self.emulator.state.size), np.nan)
        controls = np.tile(self.emulator.bounds.idle, (self.windows, SHORTEST, 1))
        end = len(self._controls)
        for window in range(end // SHORTEST):
            first = end - SHORTEST * (window + 1)
            measured[window] = self._states[first : first + SHORTEST + 1]
            controls[window] = self._controls[first : first + SHORTEST]
        measured[..., self._entries] = np.nan
        return measured, controls
