"""Plants: the bodies that controllers control, super step by super step, on an emulator or on the physics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import DivergedError
from neuroanimator.systems.system import Scheme, System

Plant = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""A plant: (state (S,), control (C,)) → the state one super step later."""


@dataclass(frozen=True)
class EmulatorPlant:
    """The emulator as the plant."""

    emulator: Emulator

    def __call__(self, state: np.ndarray, control: np.ndarray) -> np.ndarray:
        """Return the state (S,) one super step later."""
        return np.asarray(self.emulator.step(state, control), float)


@dataclass(frozen=True)
class PhysicsPlant:
    """The true physics as the plant."""

    system: System
    dt: float
    """Super step [s]."""
    scheme: Scheme | None = None
    """How the physics is stepped; None for `System.truth`."""

    def __call__(self, state: np.ndarray, control: np.ndarray) -> np.ndarray:
        """Return the state (S,) one super step later."""
        runs = self.system.simulate_fastest(state[None], control[None, None], self.dt, self.scheme)
        if runs.has_diverged[0]:
            raise DivergedError(
                "The physics diverged under control. Push less, raise effort_weight, or reset the pilot."
            )
        return runs.states[0, 1]
