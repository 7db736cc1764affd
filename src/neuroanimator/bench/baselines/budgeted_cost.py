"""J of the physics as a function of z, and how a race for the least J goes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from neuroanimator.bench.baselines.fast_physics import FastPhysics
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.trajectory import Trajectory

BLOWN_UP = 1e9
"""J of a motion that blows the physics up, or has no finite J: finite, for rivals take differences of it."""

PROGRAMS = 64
"""Compiled objectives kept: many races are for wishes that differ in numbers alone."""


class Programs(NamedTuple):
    """What a kind of objective and of parameters compiles to; their numbers come first."""

    controls: Callable[..., Array]
    """(numbers, zs (B, Z)) → controls (B, T, C)."""
    slopes: Callable[..., Array]
    """(numbers, z (Z,)) → how controls change with z, (Z, T, C)."""
    costs: Callable[..., Array]
    """(numbers, start, limit, states (G, T, S, L), controls (G L, T, C)) → J (G L,)."""
    pushed: Callable[..., tuple[Array, Array, Array]]
    """(numbers, start, limit, states (T, S), controls (T, C), changes of both (Z, ...)) → what `linearised` returns."""


class CostEvaluator:
    """z → controls → physics → J; for one z, or for as many as `batch` at a time."""

    def __init__(
        self, physics: FastPhysics, objective: Objective, parametrisation: Parametrisation, dt: float, start: np.ndarray,
        control_scale: np.ndarray, batch: int,
    ):  # fmt: skip
        self.physics, self.batch = physics, batch
        numbers, fixed = eqx.partition((objective, parametrisation), eqx.is_array)
        leaves, shape = jax.tree.flatten(numbers)
        rest, rest_shape = jax.tree.flatten(fixed)
        self._programs = _programs(shape, rest_shape, tuple(rest), dt)
        self._numbers = leaves
        self._motion = (
            leaves,
            jnp.asarray(start, jnp.float32),
            jnp.asarray(control_scale, jnp.float32),
        )

    def controls(self, zs: np.ndarray) -> np.ndarray:
        """Return the controls (B, T, C) of `zs` (B, Z)."""
        return np.asarray(self._programs.controls(self._numbers, np.asarray(zs, np.float32)))

    def slopes(self, z: np.ndarray) -> np.ndarray:
        """Return how the controls change with `z` (Z,): (Z, T, C)."""
        return np.asarray(self._programs.slopes(self._numbers, np.asarray(z, np.float32)), float)

    def costs(self, zs: np.ndarray) -> np.ndarray:
        """Return J (B,) of `zs` (B, Z), at most `batch`."""
        count = len(zs)
        padded = zs if count == 1 else zs[np.arange(self.batch).clip(max=count - 1)]
        controls = self.controls(padded)
        states, is_alive = self.physics.follow(controls[:count])
        costs = np.asarray(self._programs.costs(*self._motion, states, controls))[:count]
        return np.where(is_alive & np.isfinite(costs), costs, BLOWN_UP).astype(float)

    def linearised(
        self, states: np.ndarray, controls: np.ndarray, changes: np.ndarray, slopes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return residuals (R,), their derivatives (R, Z) and the slope (Z,) of what is no square.

        `states` (T, S) and `controls` (T, C) change with z by `changes` (Z, T, S) and `slopes` (Z, T, C).
        """
        inputs = (np.asarray(array, np.float32) for array in (states, controls, changes, slopes))
        residuals, jacobian, slope = self._programs.pushed(*self._motion, *inputs)
        return np.asarray(residuals, float), np.asarray(jacobian, float), np.asarray(slope, float)


@lru_cache(maxsize=PROGRAMS)
def _programs(shape: Any, rest_shape: Any, rest: tuple, dt: float) -> Programs:
    fixed = jax.tree.unflatten(rest_shape, rest)

    def made(numbers: list[Array]) -> tuple[Objective, Parametrisation]:
        return eqx.combine(jax.tree.unflatten(shape, numbers), fixed)

    def trajectory(
        start: Array, control_scale: Array, states: Array, controls: Array
    ) -> Trajectory:
        return Trajectory(jnp.concatenate([start[None], states]), controls, control_scale, dt)

    def controls(numbers: list[Array], zs: Array) -> Array:
        return jax.vmap(made(numbers)[1].controls)(zs)

    def slopes(numbers: list[Array], z: Array) -> Array:
        return jnp.moveaxis(jax.jacfwd(made(numbers)[1].controls)(z), -1, 0)

    def costs(
        numbers: list[Array], start: Array, control_scale: Array, states: Array, controls: Array
    ) -> Array:
        def one(states, controls):
            return made(numbers)[0](trajectory(start, control_scale, states, controls))

        grouped = controls.reshape(states.shape[0], states.shape[-1], *controls.shape[1:])
        return jax.vmap(jax.vmap(one, in_axes=(2, 0)))(states, grouped).ravel()

    def pushed(
        numbers: list[Array],
        start: Array,
        control_scale: Array,
        states: Array,
        controls: Array,
        *changes: Array,
    ):
        objective = made(numbers)[0]

        def look(*motion):
            return objective.residuals(trajectory(start, control_scale, *motion))

        def rest(*motion):
            return objective.extra(trajectory(start, control_scale, *motion))

        residuals, push = jax.linearize(look, states, controls)
        push_rest = jax.linearize(rest, states, controls)[1]
        return residuals, jax.vmap(push, out_axes=1)(*changes), jax.vmap(push_rest)(*changes)

    return Programs(*map(jax.jit, (controls, slopes, costs, pushed)))


class IsOver(Exception):  # noqa: N818
    """The target is reached, or the time is up."""


@dataclass(frozen=True)
class Improvement:
    """When a race's best became better."""

    seconds: float
    physics_steps: int
    cost: float


class Contest:
    """A race as it goes: every J is counted and timed, the best is kept. The clock runs from its making on."""

    def __init__(self, pricing: CostEvaluator, target: float, seconds: float):
        self.pricing, self.target, self._seconds = pricing, target, seconds
        self.best: np.ndarray | None = None
        self.curve: list[Improvement] = []
        self.physics_steps = self.evaluations = 0
        self._began = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Time since the beginning."""
        return time.perf_counter() - self._began

    @property
    def is_reached(self) -> bool:
        """Whether the target is."""
        return bool(self.curve) and self.curve[-1].cost <= self.target

    def cost(self, z: np.ndarray) -> float:
        """Return J of `z` (Z,). Raises IsOver once the race is."""
        return float(self.costs(z[None])[0])

    def costs(self, zs: np.ndarray) -> np.ndarray:
        """Return J (B,) of any number of `zs` (B, Z). Raises IsOver once the race is."""
        batch = self.pricing.batch
        return np.concatenate(
            [self._costs(zs[first : first + batch]) for first in range(0, len(zs), batch)]
        )

    def _costs(self, zs: np.ndarray) -> np.ndarray:
        costs = self.pricing.costs(zs)
        self.evaluations += len(zs)
        self.physics_steps += len(zs) * self.pricing.physics.steps
        k = int(costs.argmin())
        if not self.curve or costs[k] < self.curve[-1].cost:
            self.best = np.array(zs[k], float)
            self.curve.append(Improvement(self.seconds, self.physics_steps, float(costs[k])))
        self.spend(0)
        return costs

    def spend(self, physics_steps: int) -> None:
        """Count physics steps taken for other ends than J. Raises IsOver once the race is."""
        self.physics_steps += physics_steps
        if self.is_reached or self.seconds >= self._seconds:
            raise IsOver
