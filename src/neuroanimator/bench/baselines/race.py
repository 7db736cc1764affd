"""Rivals of the emulator: they look for the same controls on the true physics itself.

Each races for a J, on the fastest physics we have: `fast_physics`. A race counts neither compiling nor importing.
"""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from neuroanimator.bench.baselines.budgeted_cost import Contest, CostEvaluator, Improvement, IsOver
from neuroanimator.bench.baselines.fast_physics import cheapest_scheme, fast_physics, side_by_side
from neuroanimator.bench.baselines.ilqr import ilqr, linear_scheme
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.objective.objective import Objective
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.system import Scheme, System

MAX_DISTANCE = 2.0
"""Annealing looks for z between minus this and this: controls up to 96 % of the way to their bounds."""
DIFFERENCE = 1e-3
"""Of z, for slopes of J in annealing's local searches: J is float32, so a smaller one finds rounding."""
SPREAD = 0.5
"""Of z about the first guess: of the first population of CMA-ES, and edges of the first simplex of Nelder-Mead."""
SMALL = 1e-3
"""Falls of J, and of z for a simplex, below which a search ends and begins anew."""
MANY, DIAGONAL = 100, "100*N/popsize**0.5"
"""With more numbers than this, CMA-ES learns only their variances for so many populations, as cma's author proposes:
all covariances of 360 numbers take 30 ms a population, the physics of 32 fish 4 ms."""

Rival = Callable[[Contest, np.ndarray, np.random.Generator], None]
"""(contest, first guess z (Z,), random numbers): searches, anew where it is stuck, until the contest is over."""


@dataclass(frozen=True)
class Race:
    """How far a rival came."""

    name: str
    scheme: Scheme
    """How it stepped the physics."""
    controls: np.ndarray
    """(T, C) the best found."""
    cost: float
    """Their J on this physics."""
    curve: tuple[Improvement, ...]
    """Whenever the best became better."""
    is_reached: bool
    """Whether J came to the target or below."""
    reached_seconds: float | None
    reached_steps: int | None
    """Physics steps taken when it did; None where it did not, as for seconds."""
    seconds: float
    physics_steps: int
    """Of the whole race."""
    evaluations: int
    """Of J."""


def race(
    name: str,
    system: System,
    objective: Objective,
    parametrisation: Parametrisation,
    dt: float,
    start: np.ndarray,
    *,
    target: float,
    seconds: float,
    seed: int = 0,
    control_scale: np.ndarray | None = None,
    scheme: Scheme | None = None,
    first: np.ndarray | None = None,
) -> Race:
    """Return how the rival called `name` fares from `start` (S,) until J is at most `target`, or `seconds` are over.

    J is the emulator's: of states `dt` [s] apart; `control_scale` (C,) counts as full effort, by default the largest controls
    within the system's bounds. The first guess is `first` (T, C), or the middle of the bounds. `scheme` steps the
    physics, by default `cheapest_scheme`, which is measured: give one to get the same race again. The time ends a
    race after the evaluation, population or linearisation it is at.

    Raises ArgumentError for an unknown name, and for systems iLQR cannot be used on.
    """
    if name not in RIVALS:
        raise ArgumentError(f"No baseline called '{name}'. Baselines: {', '.join(sorted(RIVALS))}.")
    start, control_scale = (
        system.state.check(start, "state"),
        system.bounds.magnitude if control_scale is None else control_scale,
    )
    scheme = scheme or cheapest_scheme(system, dt, start)
    scheme = linear_scheme(system, scheme) if name == "ilqr" else scheme
    batch = population(parametrisation.size, side_by_side(system))
    physics = fast_physics(system, scheme, dt, start, parametrisation.steps, batch)
    pricing, guess = (
        CostEvaluator(physics, objective, parametrisation, dt, start, control_scale, batch),
        parametrisation.guess(first),
    )
    _warm_up(name, pricing, guess)
    contest = Contest(pricing, target, seconds)
    with suppress(IsOver):
        contest.cost(guess)
        RIVALS[name](contest, guess, np.random.default_rng([seed, 13]))
    return _report(name, scheme, contest)


def population(size: int, together: int) -> int:
    """Return how many z of `size` numbers CMA-ES should try at a time: its own choice, and full lanes or cores."""
    return math.ceil((4 + 3 * math.log(size)) / together) * together


def _warm_up(name: str, pricing: CostEvaluator, guess: np.ndarray) -> None:
    """Compile and import what the race will need: a race of no time does."""
    pricing.costs(guess[None])
    pricing.costs(np.tile(guess, (pricing.batch, 1)))
    with suppress(IsOver):
        RIVALS[name](Contest(pricing, -math.inf, 0.0), guess, np.random.default_rng(0))


def _report(name: str, scheme: Scheme, contest: Contest) -> Race:
    assert contest.best is not None
    last = contest.curve[-1]
    return Race(
        name=name,
        scheme=scheme,
        controls=contest.pricing.controls(contest.best[None])[0].astype(float),
        cost=last.cost,
        curve=tuple(contest.curve),
        is_reached=contest.is_reached,
        reached_seconds=last.seconds if contest.is_reached else None,
        reached_steps=last.physics_steps if contest.is_reached else None,
        seconds=contest.seconds,
        physics_steps=contest.physics_steps,
        evaluations=contest.evaluations,
    )


def anneal(contest: Contest, first: np.ndarray, rng: np.random.Generator) -> None:
    """Simulated annealing (Xiang et al. 1997) with local searches, their slopes by populations of differences."""
    from scipy.optimize import dual_annealing

    def slope(z: np.ndarray) -> np.ndarray:
        costs = contest.costs(np.concatenate([z[None], z + DIFFERENCE * np.eye(len(z))]))
        return (costs[1:] - costs[0]) / DIFFERENCE

    bounds = [(-MAX_DISTANCE, MAX_DISTANCE)] * len(first)
    local = {"method": "L-BFGS-B", "jac": slope, "bounds": bounds}
    begin = np.clip(first, -MAX_DISTANCE, MAX_DISTANCE)
    while True:
        dual_annealing(
            contest.cost, bounds, x0=begin, rng=rng, minimizer_kwargs=local, maxiter=sys.maxsize
        )


def evolve(contest: Contest, first: np.ndarray, rng: np.random.Generator) -> None:
    """CMA-ES (Hansen), begun anew with twice the population where it is stuck."""
    from cma import CMAEvolutionStrategy

    # cma's own seeds would set NumPy's global random numbers.
    options = {
        "seed": math.nan,
        "randn": lambda *shape: rng.standard_normal(shape),
        "verbose": -9,
        "verb_log": 0,
    }
    options |= {"tolfun": SMALL, "CMA_diagonal": DIAGONAL if len(first) > MANY else 0}
    size = contest.pricing.batch
    with warnings.catch_warnings(
        category=UserWarning, action="ignore"
    ):  # of outliers it deals with itself
        while True:
            search = CMAEvolutionStrategy(first, SPREAD, {**options, "popsize": size})
            while not search.stop():
                zs = np.array(search.ask())
                search.tell(list(zs), list(contest.costs(zs)))
            size *= 2


def flip(contest: Contest, first: np.ndarray, rng: np.random.Generator) -> None:
    """The simplex of Nelder and Mead, adapted to many numbers; begun anew about the best where it has shrunk."""
    from scipy.optimize import minimize

    while True:
        begin = first if contest.best is None else contest.best
        edges = np.diag(SPREAD * rng.choice([-1.0, 1.0], len(first)))
        simplex = np.concatenate([begin[None], begin + edges])
        known = dict(zip(map(np.ndarray.tobytes, simplex), contest.costs(simplex), strict=True))

        def cost(z: np.ndarray, known: dict[bytes, float] = known) -> float:
            key = z.tobytes()
            return known.pop(key) if key in known else contest.cost(z)

        endless = {"maxiter": math.inf, "maxfev": math.inf}
        options = {
            "adaptive": True,
            "initial_simplex": simplex,
            "xatol": SMALL,
            "fatol": SMALL,
            **endless,
        }
        minimize(cost, begin, method="Nelder-Mead", options=options)


RIVALS: dict[str, Rival] = {
    "annealing": anneal,
    "cma-es": evolve,
    "ilqr": ilqr,
    "nelder-mead": flip,
}
