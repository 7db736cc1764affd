"""`Problem` for NumPy callers, compiled by JAX once for all problems that differ only in numbers."""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import cache
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.control.descent.evaluator import EmulatedMotion, Evaluator, QuadraticModel
from neuroanimator.control.descent.problem import Problem
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.emulator.compiled import Compiled
from neuroanimator.terminal import phase


class JaxEvaluator(Evaluator):
    """The definition of evaluators, compiled by JAX."""

    def __init__(self, problem: Problem):
        self._problem = problem
        self._start: Array | np.ndarray = problem.start
        self._programs: dict[Callable[..., Any], Compiled] = {}
        self._most: dict[Callable[..., Any], int] = {}
        """Maximum number of z in calls of each function so far."""

    def costs(self, zs: Float[np.ndarray, "K Z"]) -> Float[np.ndarray, " K"]:
        return _as_float64(self._batch(_costs, zs))[: len(zs)]

    def gradients(
        self, zs: Float[np.ndarray, "K Z"]
    ) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, "K Z"]]:
        costs, slopes = self._batch(_gradients, zs)
        return _as_float64(costs)[: len(zs)], _as_float64(slopes)[: len(zs)]

    def quadratic_models(self, zs: Float[np.ndarray, "K Z"]) -> list[QuadraticModel]:
        curvatures, slopes, costs = self._batch(_quadratic_models, zs)
        batch = (np.asarray(curvatures), _as_float64(slopes), _as_float64(costs))
        models = []
        for curvature, slope, cost in zip(*batch, strict=True):
            models.append(QuadraticModel(curvature, slope, float(cost)))
        return models[: len(zs)]

    def motion(self, z: Float[np.ndarray, " Z"]) -> EmulatedMotion:
        states, controls = self._run(_motion, z)
        return EmulatedMotion(_as_float64(states), _as_float64(controls))

    def at(self, start: Float[np.ndarray, " S"]) -> JaxEvaluator:
        other = copy(self)
        other._start = start.astype(np.float32)
        other.compile_seconds = 0.0
        return other

    def _batch(self, function: Callable[..., Any], zs: Float[np.ndarray, "K Z"]) -> Any:
        """Return `function` of all rows of `zs`, padded by repeating the last, so that one program serves fewer rows, too."""
        count = len(zs)
        most = max(count, self._most.get(function, 0))
        self._most[function] = most
        rows = np.arange(most).clip(max=count - 1)
        return self._run(function, zs[rows])

    def _run(self, function: Callable[..., Any], numbers: Float[np.ndarray, " ..."]) -> Any:
        """Return `function` of the problem, the start and `numbers`.

        The start is a separate argument: planners change it all the time, and flattening a problem takes as long as a rollout.
        """
        program = self._programs.get(function)
        if program is None:
            program = Compiled(_from_start(function), self._problem)
            self._programs[function] = program
        single = as_float32(numbers)
        if not program.is_compiled_for(self._start, single):
            self._compile(program, single)
        return program(self._start, single)

    def _compile(self, program: Compiled, numbers: Float[np.ndarray, " ..."]) -> None:
        began = time.perf_counter()
        with phase("compiling"):
            program.compile(self._start, numbers)
        self.compile_seconds += time.perf_counter() - began


def _as_float64(numbers: Array) -> Float[np.ndarray, " ..."]:
    return np.asarray(numbers, float)


@cache
def _from_start(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function` of a problem and numbers as one of the problem, another start, and numbers; always the same object."""

    def run(problem: Problem, start: Array, numbers: Array) -> Any:
        return function(replace(problem, start=start), numbers)

    return run


def _costs(problem: Problem, zs: Float[Array, "K Z"]) -> Float[Array, " K"]:
    return jax.vmap(problem.cost)(zs)


def _gradients(
    problem: Problem, zs: Float[Array, "K Z"]
) -> tuple[Float[Array, " K"], Float[Array, "K Z"]]:
    return _for_each(jax.value_and_grad(problem.cost), zs)


def _quadratic_models(
    problem: Problem, zs: Float[Array, "K Z"]
) -> tuple[Float[Array, "K Z Z"], Float[Array, "K Z"], Float[Array, " K"]]:
    """Return the curvature, the slope and J at each z."""

    def model_at(z: Array) -> tuple[Array, Array, Array]:
        near = problem.linearised(z)
        curvature = near.jacobian.T @ near.jacobian
        slope = near.jacobian.T @ near.residuals + near.slope
        return curvature, slope, near.cost

    return _for_each(model_at, zs)


def _motion(
    problem: Problem, z: Float[Array, " Z"]
) -> tuple[Float[Array, "T1 S"], Float[Array, "T C"]]:
    trajectory = problem.trajectory(z)
    return trajectory.states, trajectory.controls


def _for_each(function: Callable[[Array], Any], zs: Float[Array, "K Z"]) -> Any:
    """Return `function` of each row, stacked.

    One row needs no vmap: it traces and compiles in about half the time, and a first controller has one start.
    """
    if len(zs) > 1:
        return jax.vmap(function)(zs)
    return jax.tree_util.tree_map(lambda leaf: leaf[None], function(zs[0]))
