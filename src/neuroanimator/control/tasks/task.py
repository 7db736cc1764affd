"""The tasks controllers are measured by: random starts, what is wanted, and when the physics has done it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from neuroanimator.control.descent.parametrisation import (
    EachStep,
    Parametrisation,
    Periodic,
    Spline,
)
from neuroanimator.control.objective.objective import Objective
from neuroanimator.systems.system import System

FREE = math.nan
"""Stands in the position of an aim for an axis along which anywhere will do."""


@dataclass(frozen=True)
class Aim:
    """Position of a trial's goal, for learners that must see it: an objective gives its cost only."""

    position: tuple[float, float, float] = (FREE, FREE, FREE)
    """[m] In the world."""
    direction: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Unit vector in the world where the body shall point or go; zeros if it does not matter."""
    is_in_a_fixed_world: bool = False
    """Whether it also matters where in the world the body is, as among obstacles."""


@dataclass(frozen=True)
class Trial:
    """One random instance of a task."""

    start: np.ndarray
    """(S,)"""
    objective: Objective
    is_success: Callable[[np.ndarray], bool]
    """Whether the physics' states (T+1, S) have done it."""
    first: np.ndarray | None = None
    """(T, C) a first guess; the middle of the bounds if None."""
    aim: Aim = Aim()
    has_failed: Callable[[np.ndarray], bool] = lambda states: False
    """Whether the states so far (K, S) are beyond repair: something was touched that must not be."""


@dataclass(frozen=True)
class Task:
    """A kind of motion."""

    name: str
    system: str
    substeps: int
    seconds: float
    success: str
    """When a motion counts as a success, in words."""
    draw: Callable[[System, np.random.Generator, int, float], Trial]
    """(system, random numbers, super steps, super step [s]) → a trial."""
    starts: int = 1
    """First guesses descended from."""
    knots: int = 0
    """Of splines; 0 for one value per super step."""
    is_periodic: bool = False
    method: str = "gauss-newton"
    is_held: bool = False
    """Whether the goal must be held, not only reached."""

    def parametrisation(self, system: System, steps: int, dt: float) -> Parametrisation:
        """Return what a descent may vary."""
        if self.is_periodic and system.gait is not None:
            return Periodic.of(steps, dt, system.gait.period, system.bounds)
        if self.knots:
            return Spline.of(steps, self.knots, system.bounds)
        return EachStep.of(steps, system.bounds)
