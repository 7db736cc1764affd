"""Options of a descent: method, iterations, initial guesses and parametrisation, checked when they are made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from neuroanimator.control.descent.methods import METHODS
from neuroanimator.control.descent.parametrisation import EachStep, Parametrisation
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import Bounds

DEFAULT_METHOD = "gauss-newton"
"""Default method, which measures best: `benchmarks/control/control.py descents`."""

SCREENING = 0.15
"""Share of the iterations after which only finalists go on."""

DEFAULT_ITERATIONS = 18
"""Default number of backward sweeps of a descent: with the two of a correction they are the 20 of 1998."""


@dataclass(frozen=True)
class DescentOptions:
    """Options of a descent. Raises ArgumentError for an unknown method, numbers below 1 and initial guesses that do not fit."""

    method: str = DEFAULT_METHOD
    """One of `adam`, `gauss-newton`, `lbfgs`, `momentum`."""
    iterations: int = DEFAULT_ITERATIONS
    """Maximum number of backward sweeps through the emulators."""
    starts: int = 1
    """Number of initial guesses to descend from in parallel; memory grows with it."""
    first: np.ndarray | None = None
    """First guess (T, C), by default the middle of the bounds, followed by random ones; or all guesses (starts, T, C)."""
    seed: int = 0
    """Seed of the random initial guesses."""
    bounds: Bounds | None = None
    """Bounds of the controls; by default the emulator's, which may be tightened; a `parametrisation` has its own."""
    parametrisation: Parametrisation | None = None
    """Parametrisation of the controls; by default one value per super step and control."""
    defects: Float[AnyArray, "T V"] | None = None
    """Defects added to the emulator's super steps, see `find_defects`; None for none."""
    searched: int = 0
    """Number of guesses tried by a rollout each, the best of which become starts: random controls, or around `first`
    if one guess is given; 0 for none."""
    finalists: int = 0
    """Number of starts, the best, that go on after the first `SCREENING` of the iterations; 0 for all."""
    varied: tuple[str, ...] = ()
    """Names of the body's parameters that are varied beside its controls."""
    on_iteration: Callable[[int, float], None] | None = None
    """Called with the iteration and the least J so far, as the descent goes on."""

    def __post_init__(self) -> None:
        check_method(self.method)
        if min(self.iterations, self.starts) < 1:
            raise ArgumentError(
                f"iterations and starts: wanted at least 1, got {self.iterations} and {self.starts}."
            )
        if self.first is not None and self.first.ndim == 3 and len(self.first) != self.starts:
            raise ArgumentError(
                f"first: wanted one guess, or one for each of {self.starts} starts, got {len(self.first)}."
            )

    def parametrisation_of(self, emulator: Emulator, steps: int) -> Parametrisation:
        """Return the parametrisation of a motion of `steps` super steps."""
        check_driven(emulator)
        check_steps(steps)
        if self.parametrisation is not None:
            return self.parametrisation
        return EachStep.of(steps, self.bounds or emulator.bounds)


def check_steps(steps: object) -> None:
    """Raise ArgumentError unless `steps` is a whole number of at least 1."""
    if not isinstance(steps, int | np.integer) or steps < 1:
        raise ArgumentError(
            f"steps: wanted a whole number of super steps, at least 1; got {steps}."
        )


def check_driven(emulator: Emulator) -> None:
    """Raise ArgumentError if the emulator's system has no controls."""
    if not emulator.control.size:
        raise ArgumentError(
            f"{emulator.system} has nothing to control: its recordings have no control column. 'animate' shows how it moves."
        )


def check_method(name: str) -> None:
    """Raise ArgumentError, which lists the methods, if there is none of this name."""
    if name not in METHODS:
        raise ArgumentError(f"No method called '{name}'. Methods: {', '.join(sorted(METHODS))}.")
