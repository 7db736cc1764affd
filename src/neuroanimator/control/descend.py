"""Find controls by gradient descent through the emulator (back-propagation through time).

All ways search over z with u = middle + half · tanh(z): controls are bounded by construction. An iteration
is one backward sweep through the chain of emulators: a gradient of J for `momentum` and `lbfgs`,
the Jacobian of the S end-state errors (S gradients in one batched sweep) for `gauss-newton`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import least_squares, minimize

from neuroanimator.control.objective import Objective
from neuroanimator.emulator.emulator import Emulator, rollout
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.layout import Bounds

MOMENTUM, MOMENTUM_STEP = 0.9, 0.1
"""Of the 1998 method; the step is along the gradient's direction, since J's gradient spans four decades."""

CONVERGED = 1e-3
"""Relative fall of J below which a descent ends."""


@dataclass(frozen=True)
class Descent:
    """What a descent found."""

    method: str
    controls: np.ndarray
    """(T, C) within the bounds."""
    cost: float
    """J on the emulator."""
    costs: tuple[float, ...]
    """J where each backward sweep was taken."""
    seconds: float
    """Compilation excluded."""

    @property
    def iterations(self) -> int:
        """Backward sweeps taken."""
        return len(self.costs)


@dataclass
class Problem:
    """J and its derivatives as compiled functions of the flat z (T·C,); keeps count."""

    emulator: Emulator
    objective: Objective
    start: np.ndarray
    steps: int
    bounds: Bounds

    def __post_init__(self) -> None:
        self.costs: list[float] = []
        arrays = (
            self.emulator,
            self.objective,
            jnp.asarray(self.start, jnp.float32),
            tuple(
                jnp.asarray(part, jnp.float32) for part in (self.bounds.middle, self.bounds.half, self.bounds.largest)
            ),
        )
        self._residuals = eqx.Partial(eqx.filter_jit(_residuals), *arrays)
        self._jacobian = eqx.Partial(eqx.filter_jit(jax.jacrev(_residuals, argnums=4)), *arrays)
        self._gradient = eqx.Partial(eqx.filter_jit(jax.value_and_grad(_cost, argnums=4)), *arrays)

    @property
    def size(self) -> int:
        """Unknowns: controls times steps."""
        return self.steps * self.emulator.identity.control.size

    def controls(self, z: np.ndarray) -> np.ndarray:
        """Return the controls (T, C) that z stands for."""
        return self.bounds.middle + np.tanh(z.reshape(self.steps, -1)) * self.bounds.half

    def residuals(self, z: np.ndarray) -> np.ndarray:
        """Return the numbers whose squares sum to 2J."""
        return np.asarray(self._residuals(jnp.asarray(z, jnp.float32)), float)

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Return the residuals' derivatives (R, T·C); counts as one iteration."""
        self.costs.append(float(np.sum(self.residuals(z) ** 2) / 2))
        return np.asarray(self._jacobian(jnp.asarray(z, jnp.float32)), float)

    def gradient(self, z: np.ndarray) -> tuple[float, np.ndarray]:
        """Return (J, ∂J/∂z); counts as one iteration."""
        cost, slope = self._gradient(jnp.asarray(z, jnp.float32))
        self.costs.append(float(cost))
        return float(cost), np.asarray(slope, float)

    def compile(self) -> None:
        """Compile all functions, so that the stopwatch sees only the search."""
        z = np.zeros(self.size)
        self.jacobian(z)
        self.gradient(z)
        self.costs.clear()


def descend(
    emulator: Emulator,
    objective: Objective,
    start: np.ndarray,
    *,
    steps: int,
    method: str = "gauss-newton",
    iterations: int = 20,
    first: np.ndarray | None = None,
    bounds: Bounds | None = None,
) -> Descent:
    """Return the controls found from `first` (T, C), or from the middle of the bounds, in at most `iterations`.

    `bounds` may be tighter than the emulator's own.
    """
    if method not in METHODS:
        raise ArgumentError(f"No method called '{method}'. Methods: {', '.join(sorted(METHODS))}.")
    if steps < 1 or iterations < 1:
        raise ArgumentError(f"steps and iterations: wanted at least 1, came {steps} and {iterations}.")
    start = emulator.identity.state.check(start, "state")
    bounds = bounds or emulator.identity.bounds
    problem = Problem(emulator, objective, start, steps, bounds)
    problem.compile()
    z = np.zeros(problem.size) if first is None else _z_of(first, bounds)
    began = time.perf_counter()
    z = METHODS[method](problem, z, iterations)
    cost = float(np.sum(problem.residuals(z) ** 2) / 2)
    seconds = time.perf_counter() - began
    return Descent(method, problem.controls(z), cost, tuple(problem.costs), seconds)


def _residuals(
    emulator: Emulator, objective: Objective, start: Array, bounds: tuple[Array, Array, Array], z: Float[Array, " Z"]
) -> Float[Array, " R"]:
    middle, half, largest = bounds
    controls = middle + jnp.tanh(z.reshape(-1, half.shape[0])) * half
    return objective.residuals(rollout(emulator, start, controls), controls, largest, emulator.dt)


def _cost(
    emulator: Emulator, objective: Objective, start: Array, bounds: tuple[Array, Array, Array], z: Float[Array, " Z"]
) -> Float[Array, ""]:
    return jnp.sum(_residuals(emulator, objective, start, bounds, z) ** 2) / 2


def _z_of(controls: np.ndarray, bounds: Bounds) -> np.ndarray:
    share = (np.asarray(controls) - bounds.middle) / bounds.half
    return np.arctanh(np.clip(share, -0.999, 0.999)).ravel()


def _momentum(problem: Problem, z: np.ndarray, iterations: int) -> np.ndarray:
    """Descent with momentum: eq. 12, with the minus sign that descent needs."""
    best, least, velocity = z, np.inf, np.zeros_like(z)
    for _ in range(iterations):
        cost, slope = problem.gradient(z)
        if cost < least:
            best, least = z, cost
        velocity = MOMENTUM * velocity - MOMENTUM_STEP * slope / (np.linalg.norm(slope) + 1e-12)
        z = z + velocity
    return best


def _lbfgs(problem: Problem, z: np.ndarray, iterations: int) -> np.ndarray:
    options = {"maxfun": iterations, "maxiter": iterations}
    return minimize(problem.gradient, z, jac=True, method="L-BFGS-B", tol=CONVERGED * 1e-3, options=options).x


def _gauss_newton(problem: Problem, z: np.ndarray, iterations: int) -> np.ndarray:
    """Gauss-Newton steps in a trust region: J is a sum of squares, so its curvature comes for free."""

    def stop_at_limit(intermediate_result) -> None:
        if len(problem.costs) >= iterations:
            raise StopIteration

    found = least_squares(
        problem.residuals,
        z,
        problem.jacobian,  # pyright: ignore[reportArgumentType] (scipy takes functions too)
        ftol=CONVERGED,
        xtol=1e-6,
        callback=stop_at_limit,
    )
    return found.x


METHODS: dict[str, Callable[[Problem, np.ndarray, int], np.ndarray]] = {
    "gauss-newton": _gauss_newton,
    "lbfgs": _lbfgs,
    "momentum": _momentum,
}
