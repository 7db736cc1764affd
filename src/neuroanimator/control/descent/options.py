"""How to descend: method, iterations, first guesses and what is varied, checked where they are made."""

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
"""The method that measures best: `benchmarks/control.py descents`."""

SCREENING = 0.15
"""Share of the iterations after which only finalists go on."""

DEFAULT_ITERATIONS = 18
"""Backward sweeps of a descent: with the two of a correction they are the 20 of 1998."""


@dataclass(frozen=True)
class DescentOptions:
    """How to descend. Raises ArgumentError for an unknown method, numbers below 1 and first guesses that do not fit."""

    method: str = DEFAULT_METHOD
    """One of `adam`, `gauss-newton`, `lbfgs`, `momentum`."""
    iterations: int = DEFAULT_ITERATIONS
    """Backward sweeps through the emulators, at most."""
    starts: int = 1
    """First guesses descended from side by side; memory grows with them."""
    first: np.ndarray | None = None
    """(T, C) the first guess, the middle of the bounds if None, after which the others are random; or (starts, T, C) all."""
    seed: int = 0
    """Of the random first guesses."""
    bounds: Bounds | None = None
    """May be tighter than the emulator's own, which they are if None; a `parametrisation` brings its own."""
    parametrisation: Parametrisation | None = None
    """What is varied; one value per super step and control if None."""
    defects: Float[AnyArray, "T V"] | None = None
    """Added to the emulator's super steps, see `find_defects`; none if None."""
    searched: int = 0
    """Number of guesses tried by a rollout each, of which the best are descended from: random controls, or around `first`
    where one guess is given. None if 0."""
    finalists: int = 0
    """Number of starts that go on after the first `SCREENING` of the iterations: the best by then. All of them if 0."""
    varied: tuple[str, ...] = ()
    """Names of the body's parameters that are varied beside its controls."""
    on_iteration: Callable[[int, float], None] | None = None
    """Told the iteration and the least J so far, as the descent goes."""

    def __post_init__(self) -> None:
        check_method(self.method)
        if min(self.iterations, self.starts) < 1:
            raise ArgumentError(
                f"iterations and starts: wanted at least 1, came {self.iterations} and {self.starts}."
            )
        if self.first is not None and self.first.ndim == 3 and len(self.first) != self.starts:
            raise ArgumentError(
                f"first: wanted one guess, or one for each of {self.starts} starts, came {len(self.first)}."
            )

    def parametrisation_of(self, emulator: Emulator, steps: int) -> Parametrisation:
        """Return what is varied in a motion of so many super steps."""
        check_driven(emulator)
        check_steps(steps)
        if self.parametrisation is not None:
            return self.parametrisation
        return EachStep.of(steps, self.bounds or emulator.bounds)


def check_steps(steps: object) -> None:
    """Raise ArgumentError unless `steps` is a whole number of at least 1."""
    if not isinstance(steps, int | np.integer) or steps < 1:
        raise ArgumentError(
            f"steps: wanted a whole number of super steps, at least 1; came {steps}."
        )


def check_driven(emulator: Emulator) -> None:
    """Raise ArgumentError where nothing drives the emulator's system, so that there are no controls to find."""
    if not emulator.control.size:
        raise ArgumentError(
            f"{emulator.system} has nothing to control: its recordings have no control column. 'animate' shows how it moves."
        )


def check_method(name: str) -> None:
    """Raise ArgumentError where there is no method of this name; it lists them."""
    if name not in METHODS:
        raise ArgumentError(f"No method called '{name}'. Methods: {', '.join(sorted(METHODS))}.")
