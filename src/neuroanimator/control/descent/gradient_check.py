"""Check that the emulator's gradient of J points in the direction of the physics', on which every descent relies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.codegen.kept import has_code_in_sources
from neuroanimator.control.descent.descend import controls_in_jax, evaluator_of, pose_problem
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.descent.problem import Problem
from neuroanimator.control.objective.c_objective import is_known_by_name
from neuroanimator.control.objective.objective import Objective, Trajectory
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.state.arrays import AnyArray
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase

WARN_BELOW = 0.5
"""Cosine below which there is a warning: 60° between gradients; a step along one still gains half as much as the other."""

DIFFERENCE_STEP = 1e-5
"""Step of central differences in z, whose numbers are of order one: with a tenth of it gradients change by less than a
millionth, even with contacts."""

Simulate = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(starts (B, S), controls (B, T, C)) → states (B, T+1, S) in float64."""


@dataclass(frozen=True)
class GradientTrust:
    """Agreement of the emulator's dJ/dz with the physics'."""

    cosine: float
    """Cosine of the angle between the gradients: 1 if parallel, 0 if orthogonal or if one of them is zero."""
    emulator_gradient: np.ndarray
    """Gradient (Z,) by back-propagation through the emulator; or its slopes (D,) along the given directions."""
    physics_gradient: np.ndarray
    """The same by central differences of the true physics."""

    @classmethod
    def of(cls, emulator_gradient: np.ndarray, physics_gradient: np.ndarray) -> GradientTrust:
        """Return the agreement of two gradients (Z,) of the same J."""
        lengths = np.linalg.norm(emulator_gradient) * np.linalg.norm(physics_gradient)
        cosine = float(emulator_gradient @ physics_gradient / lengths) if lengths else 0.0
        return cls(cosine, emulator_gradient, physics_gradient)

    def warning(self) -> str:
        """Return one line for the user if the emulator misleads; empty if it does not."""
        if self.cosine >= WARN_BELOW:
            return ""
        return (
            f"The emulator's gradient disagrees with the physics': cosine {self.cosine:.2f}, "
            f"wanted {WARN_BELOW}. Shorten the motion, or refine the emulator."
        )


def gradient_trust(
    emulator: Emulator,
    system: System,
    objective: Objective,
    parametrisation: Parametrisation,
    start: ArrayLike,
    controls: np.ndarray | None,
    defects: Float[AnyArray, "T V"] | None = None,
    directions: int | None = None,
) -> GradientTrust:
    """Return the agreement of dJ/dz on the emulator with that on `system`, at the z of `controls` (T, C).

    `start` (S,) is the initial state; without `controls`, the middle of the bounds is used. `defects` are added to
    the emulator's super steps (see `find_defects`).
    Check where a descent begins: at the emulator's own optimum its gradient vanishes, and the angle is meaningless.
    Takes 2Z runs of the physics, in one batch; or two for each of `directions` random directions, along which alone both
    gradients are then compared: the cosine is then accurate to about one over the root of their number.

    Raises NeuroAnimatorError if the physics diverges.
    """
    state = emulator.state.check(start, "state")
    z = parametrisation.guess(controls)
    problem = pose_problem(emulator, objective, parametrisation, state, defects)
    along = random_directions(len(z), directions or len(z))

    def simulate(starts: np.ndarray, controls: np.ndarray) -> np.ndarray:
        runs = system.simulate_fastest(starts, controls, emulator.dt)
        if runs.has_diverged.any():
            raise NeuroAnimatorError(
                "The physics diverged under these controls, so it has no gradient. Shorten the motion."
            )
        return runs.states

    with phase("checking the gradient"):
        on_emulator = along @ evaluator_of(problem).gradients(z[None])[1][0]
        on_physics = difference_gradient(simulate, problem, z, along)
    return GradientTrust.of(on_emulator, on_physics)


def random_directions(size: int, count: int) -> Float[np.ndarray, "D Z"]:
    """Return `count` orthonormal vectors of `size` numbers, at most `size`."""
    if count >= size:
        return np.eye(size)
    drawn = np.random.default_rng(0).normal(size=(size, count))
    return np.linalg.qr(drawn)[0].T


def difference_gradient(
    simulate: Simulate,
    problem: Problem,
    z: Float[np.ndarray, " Z"],
    along: Float[np.ndarray, "D Z"],
    step: float = DIFFERENCE_STEP,
) -> Float[np.ndarray, " D"]:
    """Return the slopes of J along unit vectors, by central differences of `simulate` in float64 from the problem's start."""
    shifts = step * along
    start = np.asarray(problem.start, float)
    starts = np.broadcast_to(start, (2 * len(shifts), len(start)))
    points = np.concatenate([z + shifts, z - shifts])
    controls = _precise_controls(problem.parametrisation, points)
    states = simulate(starts, controls)
    costs = _precise_costs(problem, states, controls)
    above, below = np.split(costs, 2)
    return (above - below) / (2 * step)


def _precise_controls(
    parametrisation: Parametrisation, zs: Float[np.ndarray, "K Z"]
) -> Float[np.ndarray, "K T C"]:
    """Return the controls of each z in float64."""
    # The package's own parametrisations also work with NumPy.
    if has_code_in_sources(parametrisation):
        return np.stack([parametrisation.controls(z) for z in zs])
    with jax.enable_x64(True):
        return np.asarray(controls_in_jax(parametrisation, zs))


def _precise_costs(
    problem: Problem, states: Float[np.ndarray, "K T1 S"], controls: Float[np.ndarray, "K T C"]
) -> Float[np.ndarray, " K"]:
    """Return J of each motion in float64."""
    objective = problem.objective
    control_scale = np.asarray(problem.control_scale, float)
    dt = problem.emulator.dt
    if not is_known_by_name(objective):
        with jax.enable_x64(True):
            return np.asarray(_costs(objective, states, controls, control_scale, dt))
    costs = []
    for motion, held in zip(states, controls, strict=True):
        costs.append(objective(Trajectory(motion, held, control_scale, dt)))
    return np.array(costs)


@eqx.filter_jit
def _costs(
    objective: Objective,
    states: Array | np.ndarray,
    controls: Array | np.ndarray,
    control_scale: Array | np.ndarray,
    dt: float,
) -> Array:
    scale = jnp.asarray(control_scale)

    def cost(states: Array, controls: Array) -> Array:
        return objective(Trajectory(states, controls, scale, dt))

    return jax.vmap(cost)(jnp.asarray(states), jnp.asarray(controls))
