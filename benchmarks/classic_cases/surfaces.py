"""Two surfaces one can look at: the training error over two weights, and J over two torques with descents on it."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

import neuroanimator as na
from classic_cases.pendulum_1998 import classic_networks
from neuroanimator.control.descent.descend import descend
from neuroanimator.control.descent.options import DescentOptions
from neuroanimator.control.descent.parametrisation import NEARLY_ALL, Parametrisation
from neuroanimator.control.objective.costs import effort
from neuroanimator.control.objective.goals import reach_goal
from neuroanimator.control.objective.objective import Objective, Trajectory
from neuroanimator.emulator.arrays import as_parameter
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks.classic import Classic
from neuroanimator.emulator.super_step import rollout
from neuroanimator.state.arrays import AnyArray
from neuroanimator.systems.system import System

Rows = list[dict[str, Any]]

SUBSTEPS = 50
"""Number of physics steps in a super step."""

EXAMPLES = 2_048
"""Number of transitions of training over which the error of the surface is taken."""

EXAMPLES_OF_CURVATURES = 1_024
"""Number of transitions of training over which the curvatures are taken."""

LARGE_CURVATURE = 0.01
"""Share of the largest curvature above which another one counts as large."""

REACH = 6.0
"""Distance to which a weight is varied about its trained value."""

WEIGHTS_SIDE = 41
"""Number of values of each weight."""

TORQUES_SIDE = 49
"""Number of values of each torque."""

STEPS = 30
"""Number of super steps of the motion."""

MAX_SHARE = 0.98
"""Largest torque on the surface, as a share of the motor's bound."""

ITERATIONS = 18
"""Number of iterations of a descent."""

STARTS_SIDE = 5
"""Number of first guesses along each axis."""

METHODS = ("momentum", "gauss-newton")
"""The method of 1998 (eq. 12, with the sign that descends), and today's."""

AS_GOOD = 1.05
"""Ratio to the least J of the surface up to which a descent has found it."""


def weight_rows(is_quick: bool) -> Rows:
    """Return a row per pair of weights: the root mean square error of training, and of the trained network itself."""
    side = 5 if is_quick else WEIGHTS_SIDE
    lesson, networks = classic_networks(SUBSTEPS, is_quick)
    network = networks[0]
    assert isinstance(network, Classic)
    unit = int(jnp.linalg.norm(network.out, axis=1).argmax())
    first, second = np.argsort(-np.abs(np.asarray(network.odd_in[:, unit])))[:2]
    trained = np.asarray(network.odd_in[:, unit])[[first, second]]

    @jax.jit
    def error(weights: Float[Array, " 2"]) -> Float[Array, ""]:
        changed = network.odd_in.at[jnp.array([first, second]), unit].set(weights)
        varied = eqx.tree_at(lambda network: network.odd_in, network, changed)
        loss = lesson.loss(varied, lesson.states[:EXAMPLES], lesson.controls[:EXAMPLES])
        return jnp.sqrt(loss)

    offsets = np.linspace(-REACH, REACH, side)
    curvature = np.linalg.eigvalsh(np.asarray(jax.hessian(error)(jnp.asarray(trained))))
    rows = []
    for to_first in offsets:
        for to_second in offsets:
            weights = trained + np.array([to_first, to_second])
            rows.append(
                {
                    "weight_1": float(weights[0]),
                    "weight_2": float(weights[1]),
                    "from_trained_1": float(to_first),
                    "from_trained_2": float(to_second),
                    "error": float(error(jnp.asarray(weights, jnp.float32))),
                    "curvature_largest": float(curvature[1]),
                    "curvature_least": float(curvature[0]),
                }
            )
    return rows


def curvature_rows(is_quick: bool) -> Rows:
    """Return one row: how the training error curves in all weights of the trained network."""
    lesson, networks = classic_networks(SUBSTEPS, is_quick)
    weights, restored = ravel_pytree(networks[0])
    count = 32 if is_quick else EXAMPLES_OF_CURVATURES

    def loss(weights: Float[Array, " W"]) -> Float[Array, ""]:
        network = restored(weights)
        return lesson.loss(network, lesson.states[:count], lesson.controls[:count])

    @jax.jit
    def hessian(weights: Float[Array, " W"]) -> Float[Array, "W W"]:
        # Column by column, for all of them at once take gigabytes.
        def column(direction: Float[Array, " W"]) -> Float[Array, " W"]:
            return jax.jvp(jax.grad(loss), (weights,), (direction,))[1]

        return jax.lax.map(column, jnp.eye(len(weights)))

    curvatures = np.linalg.eigvalsh(np.asarray(hessian(weights), float))
    sizes = np.abs(curvatures)
    return [
        {
            "weights": len(curvatures),
            "largest": float(curvatures.max()),
            "median_size": float(np.median(sizes)),
            "least": float(curvatures.min()),
            "large": int((sizes > LARGE_CURVATURE * curvatures.max()).sum()),
            "negative": int((curvatures < 0).sum()),
        }
    ]


class TwoTorques(Parametrisation):
    """z (2,) → the shoulder's torque in the first and in the second half of the motion; the other motors rest."""

    halves: Float[AnyArray, "T 2"]
    motor: Float[AnyArray, " C"]

    @classmethod
    def of(cls, steps: int, system: System) -> TwoTorques:
        """Return the parameters of a motion of so many super steps."""
        bounds = system.bounds
        is_late = np.arange(steps) >= steps // 2
        halves = np.stack([~is_late, is_late], axis=1).astype(float)
        motor = np.eye(len(bounds.half))[0]
        return cls(
            as_parameter(bounds.middle),
            as_parameter(bounds.half),
            steps,
            as_parameter(halves),
            as_parameter(motor),
        )

    @property
    def size(self) -> int:
        return 2

    def controls(self, z: Float[AnyArray, " 2"]) -> Float[AnyArray, "T C"]:
        shares = self.halves @ z.__array_namespace__().tanh(z)
        return self.middle + shares[:, None] * (self.motor * self.half)

    def guess(self, controls: np.ndarray | None) -> np.ndarray:
        if controls is None:
            return np.zeros(2)
        shares = np.asarray(controls)[[0, -1], 0] / float(self.half[0])
        return np.arctanh(np.clip(shares, -NEARLY_ALL, NEARLY_ALL))


def swing_objective(system: System) -> Objective:
    """Return eq. 11: little effort, and the arm upright and still at the end."""
    return Objective.of(effort(), reach_goal(system, system.goals["upright"]))


def torque_rows(is_quick: bool) -> Rows:
    """Return a row per pair of torques: J on the emulator and on the true physics."""
    system = na.load_system("pendulum")
    emulator = na.load_emulator("pendulum-50")
    parametrisation = TwoTorques.of(STEPS, system)
    side = 5 if is_quick else TORQUES_SIDE
    largest = MAX_SHARE * system.bounds.magnitude[0]
    torques = np.linspace(-largest, largest, side)
    pairs = np.array([(first, second) for first in torques for second in torques])
    zs = np.arctanh(pairs / system.bounds.magnitude[0])
    controls = np.stack([np.asarray(parametrisation.controls(z), float) for z in zs])
    starts = np.repeat(system.rest[None], len(pairs), axis=0)
    runs = system.simulate(starts, controls, emulator.dt)
    objective = swing_objective(system)
    on_emulator = emulated_costs(objective, emulator, starts, controls)
    on_physics = costs_of(objective, emulator, runs.states, controls)
    rows = []
    for pair, emulated, true in zip(pairs, on_emulator, on_physics, strict=True):
        row = {"torque_1": float(pair[0]), "torque_2": float(pair[1])}
        row["j_emulator"] = float(emulated)
        row["j_physics"] = float(true)
        rows.append(row)
    return rows


def emulated_costs(
    objective: Objective,
    emulator: Emulator,
    starts: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B T C"],
) -> Float[np.ndarray, " B"]:
    """Return J of the emulator's motions."""
    roll = jax.jit(jax.vmap(lambda start, held: rollout(emulator, start, held)))
    states = roll(jnp.asarray(starts, jnp.float32), jnp.asarray(controls, jnp.float32))
    return costs_of(objective, emulator, np.asarray(states), controls)


def costs_of(
    objective: Objective,
    emulator: Emulator,
    states: Float[np.ndarray, "B F S"],
    controls: Float[np.ndarray, "B T C"],
) -> Float[np.ndarray, " B"]:
    """Return J of each motion."""
    scale = jnp.asarray(emulator.bounds.magnitude, jnp.float32)

    def cost(states: Array, controls: Array) -> Array:
        return objective(Trajectory(states, controls, scale, emulator.dt))

    of_all = jax.jit(jax.vmap(cost))
    return np.asarray(of_all(jnp.asarray(states, jnp.float32), jnp.asarray(controls, jnp.float32)))


def descent_rows(is_quick: bool) -> Rows:
    """Return a row per method, first guess and iteration: the torques and J by then, and J on the physics."""
    system = na.load_system("pendulum")
    emulator = na.load_emulator("pendulum-50")
    parametrisation = TwoTorques.of(STEPS, system)
    objective = swing_objective(system)
    side = 2 if is_quick else STARTS_SIDE
    shares = np.linspace(-0.8, 0.8, side)
    guesses = [np.arctanh(np.array([first, second])) for first in shares for second in shares]
    rows = []
    for method in METHODS:
        for number, guess in enumerate(guesses):
            first = np.asarray(parametrisation.controls(guess), float)
            path = [first]
            for iterations in range(1, ITERATIONS + 1):
                # The same descent, ended sooner: it shows where it was by then.
                options = DescentOptions(
                    method=method,
                    iterations=iterations,
                    first=first,
                    parametrisation=parametrisation,
                )
                found = descend(emulator, objective, system.rest, steps=STEPS, options=options)
                path.append(np.asarray(found.controls, float))
            rows += _path_rows(system, emulator, objective, method, number, np.stack(path))
    return rows


def _path_rows(
    system: System,
    emulator: Emulator,
    objective: Objective,
    method: str,
    number: int,
    path: Float[np.ndarray, "K T C"],
) -> Rows:
    starts = np.repeat(system.rest[None], len(path), axis=0)
    emulated = emulated_costs(objective, emulator, starts, path)
    runs = system.simulate(starts, path, emulator.dt)
    true = costs_of(objective, emulator, runs.states, path)
    rows = []
    for iteration, controls in enumerate(path):
        rows.append(
            {
                "method": method,
                "start": number,
                "iteration": iteration,
                "torque_1": float(controls[0, 0]),
                "torque_2": float(controls[-1, 0]),
                "j_emulator": float(emulated[iteration]),
                "j_physics": float(true[iteration]),
            }
        )
    return rows


def minima(heights: Float[np.ndarray, "N M"]) -> int:
    """Return the number of points of a grid that are lower than their eight neighbours, none of them at its edge."""
    inner = heights[1:-1, 1:-1]
    is_lowest = np.ones(inner.shape, bool)
    rows, columns = heights.shape
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            if down or right:
                neighbour = heights[1 + down : rows - 1 + down, 1 + right : columns - 1 + right]
                is_lowest &= inner < neighbour
    return int(is_lowest.sum())
