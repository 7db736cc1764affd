"""Find controls by gradient descent through the emulator (back-propagation through time)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.control.descent.defects import no_defects
from neuroanimator.control.descent.methods import METHODS, Method, Progress
from neuroanimator.control.descent.parametrisation import EachStep, Parametrisation
from neuroanimator.control.descent.problem import Problem
from neuroanimator.control.objective.feasibility import check_reachable
from neuroanimator.control.objective.objective import Objective, check_objective
from neuroanimator.data.sampling import sample_controls
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.state.layout import Bounds
from neuroanimator.terminal import phase

DEFAULT_METHOD = "gauss-newton"
"""The one that measures best: `benchmarks/control.py descents`."""


DEFAULT_ITERATIONS = 18
"""Backward sweeps: with the two of a correction the 20 of 1998."""


@dataclass(frozen=True)
class Descent:
    """What a descent found."""

    method: str
    controls: np.ndarray
    """(T, C) within the bounds."""
    cost: float
    """J on the emulator."""
    costs: tuple[float, ...]
    """The least J at first and after each iteration that was watched, of the start that ended best."""
    iterations: int
    """Backward sweeps of the start that ended best."""
    seconds: float
    """Compilation excluded."""
    candidates: np.ndarray
    """(K, T, C) what every start came to, the best first."""
    candidate_costs: np.ndarray
    """(K,) J on the emulator of each."""
    is_diverged: bool = False
    """Whether J or its slope stopped being finite; the best before that is kept."""


def descend(
    emulator: Emulator,
    objective: Objective,
    start: np.ndarray,
    *,
    steps: int,
    method: str = DEFAULT_METHOD,
    iterations: int = DEFAULT_ITERATIONS,
    first: np.ndarray | None = None,
    bounds: Bounds | None = None,
    parametrisation: Parametrisation | None = None,
    starts: int = 1,
    seed: int = 0,
    defects: Array | None = None,
    on_iteration: Callable[[int, float], None] | None = None,
) -> Descent:
    """Return the best controls found in at most `iterations` from each of several first guesses.

    The first guess is `first` (T, C), or the middle of the bounds; the other `starts` - 1 are random, unless `first`
    (starts, T, C) has them all. `bounds` may be tighter than the emulator's own; `parametrisation` other than one value
    per super step bring their own. `defects` (T, V) are added to the emulator's super steps (see `corrected`).
    `on_iteration` is told iteration and least J as it goes.

    Raises ArgumentError for an objective that cannot be descended, before anything is tried.
    """
    if method not in METHODS:
        raise ArgumentError(f"No method called '{method}'. Methods: {', '.join(sorted(METHODS))}.")
    if min(steps, iterations, starts) < 1:
        raise ArgumentError(
            f"steps, iterations and starts: wanted at least 1, came {steps}, {iterations} and {starts}."
        )
    start = emulator.state.check(start, "state")
    parametrisation = parametrisation or EachStep.of(steps, bounds or emulator.bounds)
    with phase("compiling"):
        check_objective(objective, emulator, start, steps)
        check_reachable(objective, emulator, start, steps)
    problem = pose_problem(emulator, objective, parametrisation, start, defects)
    guesses = first_guesses(emulator, parametrisation, first, starts, seed)
    return _descend(method, problem, guesses, iterations, on_iteration)


def pose_problem(
    emulator: Emulator,
    objective: Objective,
    parametrisation: Parametrisation,
    start: np.ndarray,
    defects: Array | None = None,
) -> Problem:
    """Return J over the numbers of `parametrisation`, from `start` (S,)."""
    limit = as_jax(emulator.bounds.magnitude)
    defects = no_defects(emulator, parametrisation.steps) if defects is None else defects
    return Problem(emulator, objective, parametrisation, as_jax(start), defects, limit)


def first_guesses(
    emulator: Emulator,
    parametrisation: Parametrisation,
    first: np.ndarray | None,
    starts: int,
    seed: int,
) -> np.ndarray:
    """Return z (K, Z): the given ones, or the first one given and then random ones as training saw them."""
    if first is not None and first.ndim == 3:
        if len(first) != starts:
            raise ArgumentError(
                f"first: wanted one guess, or one for each of {starts} starts, came {len(first)}."
            )
        return np.stack([parametrisation.guess(controls) for controls in first])
    rng, spec = np.random.default_rng([seed, 11]), emulator.spec
    drawn = [
        sample_controls(rng, parametrisation.steps, emulator.dt, spec.bounds, spec.gait)
        for _ in range(starts - 1)
    ]
    return np.stack([parametrisation.guess(controls) for controls in (first, *drawn)])


def _descend(
    name: str,
    problem: Problem,
    guesses: np.ndarray,
    iterations: int,
    on_iteration: Callable[[int, float], None] | None,
) -> Descent:
    method = METHODS[name]
    with phase("compiling"):
        progress = begin(method, as_jax(guesses))
        jax.block_until_ready(advance(method, problem, progress, np.int32(0)))
        controls_of(problem.parametrisation, progress.best)
    began = time.perf_counter()
    history = []
    with phase("descending"):
        for limit in range(1, iterations + 1) if on_iteration else (iterations,):
            progress = advance(method, problem, progress, np.int32(limit))
            history.append(np.asarray(progress.least))
            if on_iteration:
                on_iteration(limit, float(history[-1].min()))
            if np.asarray(progress.is_done).all():
                break
    history.insert(0, np.asarray(progress.first))
    candidates, costs = (
        controls_of(problem.parametrisation, progress.best),
        np.asarray(progress.least, float),
    )
    seconds, order = (
        time.perf_counter() - began,
        np.argsort(np.where(np.isfinite(costs), costs, np.inf)),
    )
    best = order[0]
    return Descent(
        method=name,
        controls=np.asarray(candidates, float)[best],
        cost=float(costs[best]),
        costs=tuple(float(row[best]) for row in history),
        iterations=int(np.asarray(progress.sweeps)[best]),
        seconds=seconds,
        candidates=np.asarray(candidates, float)[order],
        candidate_costs=costs[order],
        is_diverged=bool(np.asarray(progress.is_diverged)[best]),
    )


@eqx.filter_jit
def begin(method: Method, guesses: Array) -> Progress:
    """Return the progress of every first guess (K, Z), before any iteration."""
    return jax.vmap(method.begin)(guesses)


@eqx.filter_jit
def advance(
    method: Method, problem: Problem, progress: Progress, limit: Array | np.integer
) -> Progress:
    """Return the progress of all starts once each is done or has taken `limit` backward sweeps."""

    def one(progress: Progress) -> Progress:
        return jax.lax.while_loop(
            lambda p: ~p.is_done & (p.sweeps < limit),
            lambda p: method.iterate(problem, p),
            progress,
        )

    if len(progress.z) > 1:
        return jax.vmap(one)(progress)
    # Alone, without vmap: traced and compiled in about half the time, and a first controller has one start.
    alone = jax.tree_util.tree_map(lambda leaf: leaf[0], progress)
    return jax.tree_util.tree_map(lambda leaf: leaf[None], one(alone))


@eqx.filter_jit
def controls_of(parametrisation: Parametrisation, z: Array | np.ndarray) -> Float[Array, "K T C"]:
    """Return the controls each row of z (K, Z) stands for."""
    return jax.vmap(parametrisation.controls)(jnp.asarray(z))
