"""Find controls by gradient descent through the emulator (back-propagation through time)."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.codegen.backend import backend
from neuroanimator.control.descent.c_evaluator import (
    c_evaluator,
    controls_in_c,
    loading_programs,
)
from neuroanimator.control.descent.defects import no_defects
from neuroanimator.control.descent.evaluator import Evaluator
from neuroanimator.control.descent.jax_evaluator import JaxEvaluator
from neuroanimator.control.descent.methods import METHODS, Method, Progress, best_first
from neuroanimator.control.descent.options import SCREENING, DescentOptions, check_steps
from neuroanimator.control.descent.parametrisation import NEARLY_ALL, Parametrisation
from neuroanimator.control.descent.problem import Problem, VariedParameters
from neuroanimator.control.objective.feasibility import check_reachable
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.objective_cost import check_objective
from neuroanimator.emulator.arrays import as_float32, as_parameter
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.super_step import latent_size
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray
from neuroanimator.systems.random_controls import sample_controls
from neuroanimator.terminal import phase
from neuroanimator.text import listed, quoted


@dataclass(frozen=True)
class Descent:
    """The result of a descent."""

    method: str
    controls: np.ndarray
    """Controls (T, C) within the bounds."""
    cost: float
    """J on the emulator."""
    costs: tuple[float, ...]
    """Least J initially and after each backward sweep, of the start that ended best."""
    iterations: int
    """Number of backward sweeps of the start that ended best."""
    seconds: float
    """Time taken [s], compilation excluded."""
    candidates: np.ndarray
    """Final controls (K, T, C) of every start, the best first."""
    candidate_costs: np.ndarray
    """J (K,) of each on the emulator."""
    candidate_starts: np.ndarray
    """Initial state (K, S) of each motion, with the parameters found if some were varied."""
    is_diverged: bool = False
    """Whether J or its gradient stopped being finite; the best before that is kept."""


def descend(
    emulator: Emulator,
    objective: Objective,
    start: ArrayLike,
    *,
    steps: int,
    options: DescentOptions = DescentOptions(),
) -> Descent:
    """Return the best controls for `steps` super steps from the state `start` (S,), by J on the emulator.

    Raises ArgumentError for an objective that cannot be descended, before any descent.
    """
    check_steps(steps)
    state = emulator.state.check(start, "state")
    parametrisation = options.parametrisation_of(emulator, steps)
    with phase("compiling"), loading_programs(emulator, parametrisation):
        check_objective(objective, emulator, state, steps)
        check_reachable(objective, emulator, state, steps)
    problem = pose_problem(emulator, objective, parametrisation, state, options.defects)
    if options.searched:
        guesses = searched_guesses(problem, options)
    else:
        guesses = first_guesses(emulator, parametrisation, options)
    if options.varied:
        varied = vary_parameters(emulator, options.varied, parametrisation)
        problem = replace(problem, varied=varied)
        first = guess_parameters(varied, state, len(guesses), options.seed)
        guesses = np.concatenate([guesses, first], axis=1)
    return _descend(problem, guesses, options)


def vary_parameters(
    emulator: Emulator, names: Sequence[str], parametrisation: Parametrisation
) -> VariedParameters:
    """Return the variation of the parameters called `names` beside controls, over the ranges of training.

    ArgumentError lists the known ones.
    """
    known = {p.name: number for number, p in enumerate(emulator.parameters)}
    for name in names:
        if name not in known:
            raise ArgumentError(
                f"varied: no parameter called {quoted(name)}. Parameters: {listed(known) or 'none'}."
            )
    chosen = [emulator.parameters[known[name]] for name in names]
    entries = tuple(emulator.parameter_entries[known[name]] for name in names)
    behind = latent_size(emulator) - emulator.state.size
    return VariedParameters(
        parametrisation=parametrisation,
        entries=entries,
        latent_entries=tuple(entry + behind for entry in entries),
        middle=as_parameter(np.array([(p.high + p.low) / 2 for p in chosen])),
        half=as_parameter(np.array([(p.high - p.low) / 2 for p in chosen])),
    )


def start_of_body(
    emulator: Emulator,
    start: Float[np.ndarray, " S"],
    entries: Sequence[int],
    values: Float[np.ndarray, " P"],
) -> Float[np.ndarray, " S"]:
    """Return the `start` (S,) of the body with these parameters, at these state `entries`, in its own shape."""
    changed = np.array(start, float)
    changed[list(entries)] = values
    cloud = emulator.state_structure.cloud
    if cloud is None or not cloud.parameters:
        return changed
    return cloud.reshaped(np.asarray(start, float), changed[len(changed) - cloud.parameters :])


def guess_parameters(
    varied: VariedParameters, start: Float[np.ndarray, " S"], count: int, seed: int
) -> Float[np.ndarray, "K P"]:
    """Return the numbers w of the parameters of `count` initial guesses: those of `start`, then random ones."""
    values = start[list(varied.entries)]
    shares = (values - np.asarray(varied.middle)) / np.asarray(varied.half)
    others = np.random.default_rng([seed, FIRST_GUESSES]).uniform(-1, 1, (count - 1, len(shares)))
    return np.arctanh(np.clip(np.vstack([shares, others]), -NEARLY_ALL, NEARLY_ALL))


def pose_problem(
    emulator: Emulator,
    objective: Objective,
    parametrisation: Parametrisation,
    start: ArrayLike,
    defects: Float[AnyArray, "T V"] | None = None,
) -> Problem:
    """Return J as a function of the numbers of `parametrisation`, from the state `start` (S,)."""
    control_scale = as_parameter(emulator.bounds.magnitude)
    if defects is None:
        defects = no_defects(emulator, parametrisation.steps)
    return Problem(
        emulator, objective, parametrisation, as_parameter(start), defects, control_scale
    )


def first_guesses(
    emulator: Emulator, parametrisation: Parametrisation, options: DescentOptions
) -> Float[np.ndarray, "K Z"]:
    """Return the initial z: the given ones, or the given first one and then random ones as in training."""
    first = options.first
    if first is not None and first.ndim == 3:
        # Often all are the same, and finding the frequency of a gait takes as long as several sweeps.
        different, numbers = np.unique(first, axis=0, return_inverse=True)
        guesses = np.stack([parametrisation.guess(controls) for controls in different])
        return guesses[numbers.reshape(-1)]
    others = random_guesses(emulator, parametrisation, options.starts - 1, options.seed)
    return np.concatenate([parametrisation.guess(first)[None], others])


def random_guesses(
    emulator: Emulator, parametrisation: Parametrisation, count: int, seed: int
) -> Float[np.ndarray, "K Z"]:
    """Return the z of `count` random controls as in training."""
    spec = emulator.spec
    rng = np.random.default_rng([seed, FIRST_GUESSES])
    guesses = np.empty((count, parametrisation.size))
    for guess in guesses:
        controls = sample_controls(rng, parametrisation.steps, emulator.dt, spec.bounds, spec.gait)
        guess[:] = parametrisation.guess(controls)
    return guesses


def searched_guesses(problem: Problem, options: DescentOptions) -> Float[np.ndarray, "K Z"]:
    """Return the z of the best of many guesses, by J of one rollout each: around the first guess if given, otherwise random.

    A body whose motor is too weak for a direct motion has to pump: then gradients from nearly all guesses lead nowhere,
    but some of thousands of random motions come near. An animal comes near by motions like its gait.
    """
    parametrisation = problem.parametrisation
    if options.first is None:
        drawn = random_guesses(problem.emulator, parametrisation, options.searched, options.seed)
    else:
        first = first_guesses(problem.emulator, parametrisation, options)[0]
        drawn = guesses_around(first, options.searched, options.seed)
    with phase("searching"):
        costs = evaluator_of(problem).costs(drawn)
    order = best_first(costs)
    return drawn[order[: options.starts]]


def guesses_around(
    first: Float[np.ndarray, " Z"], count: int, seed: int
) -> Float[np.ndarray, "K Z"]:
    """Return `count` z around that of the first guess, with noise over the range of `SCATTER`."""
    rng = np.random.default_rng([seed, FIRST_GUESSES])
    least, greatest = np.log(SCATTER)
    sizes = np.exp(rng.uniform(least, greatest, (count, 1)))
    return first + sizes * rng.normal(size=(count, len(first)))


SCATTER = (0.05, 2.0)
"""Minimum and maximum standard deviation in z of guesses around the first one: from nearly equal to at the bounds, as
controls are hyperbolic tangents of z."""

FIRST_GUESSES = 11
"""Number joined to the seed of random initial guesses, so that they differ from other random numbers of that seed."""


def _descend(
    problem: Problem, guesses: Float[np.ndarray, "K Z"], options: DescentOptions
) -> Descent:
    method = METHODS[options.method]
    evaluator = evaluator_of(problem)
    began = time.perf_counter()
    with phase("descending"):
        starts, history = _iterate(method, evaluator, guesses, options)
    best_zs = np.stack([start.best for start in starts])
    seconds = time.perf_counter() - began - evaluator.compile_seconds
    with phase("compiling"):
        candidates = controls_of(
            problem.parametrisation, best_zs[:, : problem.parametrisation.size]
        )
    costs = np.array([start.least for start in starts])
    order = best_first(costs)
    best = order[0]
    begins = np.repeat(np.asarray(problem.start, float)[None], len(best_zs), axis=0)
    if problem.varied is not None:
        varied = problem.varied
        emulator = problem.emulator
        known = dict(zip(emulator.parameter_entries, emulator.parameters, strict=True))
        ranges = [known[entry] for entry in varied.entries]
        # Rounding to float32 may leave the range.
        values = np.clip(
            [varied.values(z) for z in as_float32(best_zs)],
            [parameter.low for parameter in ranges],
            [parameter.high for parameter in ranges],
        )
        begins = np.stack(
            [start_of_body(emulator, begins[0], varied.entries, one) for one in values]
        )
    return Descent(
        method=options.method,
        controls=candidates[best],
        cost=starts[best].least,
        costs=tuple(row[best] for row in history),
        iterations=starts[best].sweeps,
        seconds=seconds,
        candidates=candidates[order],
        candidate_costs=costs[order],
        candidate_starts=begins[order],
        is_diverged=starts[best].is_diverged,
    )


def _iterate(
    method: Method,
    evaluator: Evaluator,
    guesses: Float[np.ndarray, "K Z"],
    options: DescentOptions,
) -> tuple[list[Progress], list[list[float]]]:
    """Return the final progress, and the least J of every start initially and after each sweep."""
    starts = [method.begin(guess) for guess in guesses]
    history: list[list[float]] = []
    for limit in range(1, options.iterations + 1):
        starts = advance(method, evaluator, starts, limit)
        least = [start.least for start in starts]
        history.append(least)
        if options.finalists and limit == math.ceil(SCREENING * options.iterations):
            finalists = best_first(np.array(least))[: options.finalists]
            starts = [starts[number] for number in finalists]
            history = [[row[number] for number in finalists] for row in history]
        if options.on_iteration is not None:
            options.on_iteration(limit, min(least))
        if all(start.is_done for start in starts):
            break
    return starts, [[start.first for start in starts], *history]


def advance(
    method: Method, evaluator: Evaluator, starts: Sequence[Progress], limit: int
) -> list[Progress]:
    """Return the progress of all starts once each is done or has taken `limit` backward sweeps."""
    starts = list(starts)
    # A start may diverge: its numbers show it, and it ends.
    with np.errstate(over="ignore", invalid="ignore"):
        while True:
            going = []
            for number, start in enumerate(starts):
                if not start.is_done and start.sweeps < limit:
                    going.append(number)
            if not going:
                return starts
            following = method.iterate(evaluator, [starts[number] for number in going])
            for number, progress in zip(going, following, strict=True):
                starts[number] = progress


def controls_of(
    parametrisation: Parametrisation, zs: Float[np.ndarray, "K Z"]
) -> Float[np.ndarray, "K T C"]:
    """Return the controls of each row of `zs`, by the `backend`."""
    single = as_float32(zs)
    if backend() != "jax":
        controls = controls_in_c(parametrisation, single)
        if controls is not None:
            return controls.astype(float)
    return np.asarray(controls_in_jax(parametrisation, single), float)


@eqx.filter_jit
def controls_in_jax(
    parametrisation: Parametrisation, zs: Float[Array | np.ndarray, "K Z"]
) -> Float[Array, "K T C"]:
    """Return the controls of each z, in float64 if JAX has it enabled."""
    return jax.vmap(parametrisation.controls)(jnp.asarray(zs))


def evaluator_of(problem: Problem) -> Evaluator:
    """Return the evaluator of `problem`, by the `backend`."""
    if backend() != "jax":
        in_c = c_evaluator(problem)
        if in_c is not None:
            return in_c
    return JaxEvaluator(problem)
