"""Tasks that measure controllers: random starts, objectives, and criteria of success on the physics."""

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
"""Coordinate of an aim's position along an axis that does not matter."""


@dataclass(frozen=True)
class Aim:
    """A trial's goal in the world, for learners that must observe it: an objective gives only its cost."""

    position: tuple[float, float, float] = (FREE, FREE, FREE)
    """Position in the world [m]."""
    direction: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Unit vector in the world along which the body is to point or move; zeros if it does not matter."""
    is_in_a_fixed_world: bool = False
    """Whether the body's position in the world also matters, as among obstacles."""


@dataclass(frozen=True)
class Trial:
    """One random instance of a task."""

    start: np.ndarray
    """Initial state (S,)."""
    objective: Objective
    is_success: Callable[[np.ndarray], bool]
    """Whether the physics' states (T+1, S) are a success."""
    first: np.ndarray | None = None
    """First guess (T, C); the middle of the bounds if None."""
    aim: Aim = Aim()
    has_failed: Callable[[np.ndarray], bool] = lambda states: False
    """Whether the states so far (K, S) have failed for good, such as by touching something."""


@dataclass(frozen=True)
class Task:
    """A kind of motion."""

    name: str
    system: str
    substeps: int
    seconds: float
    success: str
    """Criterion of success, in words."""
    draw: Callable[[System, np.random.Generator, int, float], Trial]
    """(system, random numbers, number of super steps, super step [s]) → a trial."""
    starts: int = 1
    """Number of first guesses to descend from."""
    knots: int = 0
    """Number of knots of splines; 0 for one value per super step."""
    is_periodic: bool = False
    method: str = "gauss-newton"
    is_held: bool = False
    """Whether the goal must be held, not only reached."""

    def parametrisation(self, system: System, steps: int, dt: float) -> Parametrisation:
        """Return the parametrisation of a descent."""
        if self.is_periodic and system.gait is not None:
            return Periodic.of(steps, dt, system.gait.period, system.bounds)
        if self.knots:
            return Spline.of(steps, self.knots, system.bounds)
        return EachStep.of(steps, system.bounds)


def three(vector: np.ndarray) -> tuple[float, float, float]:
    """Return `vector` (3,) as plain numbers."""
    x, y, z = (float(number) for number in vector)
    return x, y, z
