"""Find controls by gradient descent through the emulator (back-propagation through time)."""

from __future__ import annotations

import time
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.control.descent.defects import no_defects
from neuroanimator.control.descent.methods import METHODS, Method, Progress
from neuroanimator.control.descent.options import DescentOptions
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.descent.problem import Problem
from neuroanimator.control.objective.feasibility import check_reachable
from neuroanimator.control.objective.objective import Objective, check_objective
from neuroanimator.data.sampling import sample_controls
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.terminal import phase


@dataclass(frozen=True)
class Descent:
    """The result of a descent."""

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
    """Time taken [s], compilation excluded."""
    candidates: np.ndarray
    """(K, T, C) what every start came to, the best first."""
    candidate_costs: np.ndarray
    """(K,) J on the emulator of each."""
    is_diverged: bool = False
    """Whether J or its slope stopped being finite; the best before that is kept."""


def descend(
    emulator: Emulator,
    objective: Objective,
    start: ArrayLike,
    *,
    steps: int,
    options: DescentOptions = DescentOptions(),
) -> Descent:
    """Return the best controls for `steps` super steps from the state `start` (S,), by J on the emulator.

    Raises ArgumentError for an objective that cannot be descended, before anything is tried.
    """
    if steps < 1:
        raise ArgumentError(f"steps: wanted at least 1, came {steps}.")
    state = emulator.state.check(start, "state")
    parametrisation = options.parametrisation_of(emulator, steps)
    with phase("compiling"):
        check_objective(objective, emulator, state, steps)
        check_reachable(objective, emulator, state, steps)
    problem = pose_problem(emulator, objective, parametrisation, state, options.defects)
    guesses = first_guesses(emulator, parametrisation, options)
    return _descend(problem, guesses, options)


def pose_problem(
    emulator: Emulator,
    objective: Objective,
    parametrisation: Parametrisation,
    start: ArrayLike,
    defects: Float[Array, "T V"] | None = None,
) -> Problem:
    """Return J over the numbers of `parametrisation`, from the state `start` (S,)."""
    control_scale = as_jax(emulator.bounds.magnitude)
    if defects is None:
        defects = no_defects(emulator, parametrisation.steps)
    return Problem(emulator, objective, parametrisation, as_jax(start), defects, control_scale)


def first_guesses(
    emulator: Emulator, parametrisation: Parametrisation, options: DescentOptions
) -> Float[np.ndarray, "K Z"]:
    """Return the z to begin with: the given ones, or the first one given and then random ones as training saw them."""
    first = options.first
    if first is not None and first.ndim == 3:
        return np.stack([parametrisation.guess(controls) for controls in first])
    spec = emulator.spec
    rng = np.random.default_rng([options.seed, FIRST_GUESSES])
    guesses = [parametrisation.guess(first)]
    for _ in range(options.starts - 1):
        controls = sample_controls(rng, parametrisation.steps, emulator.dt, spec.bounds, spec.gait)
        guesses.append(parametrisation.guess(controls))
    return np.stack(guesses)


FIRST_GUESSES = 11
"""Joins the seed of random first guesses, so that they are not those of something else with the same seed."""


def _descend(
    problem: Problem, guesses: Float[np.ndarray, "K Z"], options: DescentOptions
) -> Descent:
    method = METHODS[options.method]
    with phase("compiling"):
        progress = begin(method, as_jax(guesses))
        jax.block_until_ready(advance(method, problem, progress, np.int32(0)))
        controls_of(problem.parametrisation, progress.best)
    began = time.perf_counter()
    with phase("descending"):
        progress, history = _iterate(method, problem, progress, options)
    candidates = np.asarray(controls_of(problem.parametrisation, progress.best), float)
    costs = np.asarray(progress.least, float)
    seconds = time.perf_counter() - began
    order = np.argsort(np.where(np.isfinite(costs), costs, np.inf))
    best = order[0]
    return Descent(
        method=options.method,
        controls=candidates[best],
        cost=float(costs[best]),
        costs=tuple(float(row[best]) for row in history),
        iterations=int(np.asarray(progress.sweeps)[best]),
        seconds=seconds,
        candidates=candidates[order],
        candidate_costs=costs[order],
        is_diverged=bool(np.asarray(progress.is_diverged)[best]),
    )


def _iterate(
    method: Method, problem: Problem, progress: Progress, options: DescentOptions
) -> tuple[Progress, list[np.ndarray]]:
    """Return the last progress, and (K,) the least J at first and whenever it was looked at."""
    on_iteration = options.on_iteration
    if on_iteration is None:
        progress = advance(method, problem, progress, np.int32(options.iterations))
        return progress, [np.asarray(progress.first), np.asarray(progress.least)]
    history: list[np.ndarray] = []
    for limit in range(1, options.iterations + 1):
        progress = advance(method, problem, progress, np.int32(limit))
        least = np.asarray(progress.least)
        history.append(least)
        on_iteration(limit, float(least.min()))
        if np.asarray(progress.is_done).all():
            break
    return progress, [np.asarray(progress.first), *history]


@eqx.filter_jit
def begin(method: Method, guesses: Float[Array, "K Z"]) -> Progress:
    """Return the progress of every first guess, before any iteration."""
    return jax.vmap(method.begin)(guesses)


@eqx.filter_jit
def advance(
    method: Method,
    problem: Problem,
    progress: Progress,
    limit: Array | np.integer,
) -> Progress:
    """Return the progress of all starts once each is done or has taken `limit` backward sweeps."""

    def goes_on(progress: Progress) -> Array:
        return ~progress.is_done & (progress.sweeps < limit)

    def iterate(progress: Progress) -> Progress:
        return method.iterate(problem, progress)

    def advance_one(progress: Progress) -> Progress:
        return jax.lax.while_loop(goes_on, iterate, progress)

    if len(progress.z) > 1:
        return jax.vmap(advance_one)(progress)
    # Alone, without vmap: traced and compiled in about half the time, and a first controller has one start.
    alone = jax.tree_util.tree_map(lambda leaf: leaf[0], progress)
    return jax.tree_util.tree_map(lambda leaf: leaf[None], advance_one(alone))


@eqx.filter_jit
def controls_of(
    parametrisation: Parametrisation, z: Float[Array | np.ndarray, "K Z"]
) -> Float[Array, "K T C"]:
    """Return the controls each row of z stands for."""
    return jax.vmap(parametrisation.controls)(jnp.asarray(z))
