"""Methods of descent: one iteration of each, for several starts in parallel."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import get_lapack_funcs

from neuroanimator.control.descent.evaluator import Evaluator, QuadraticModel
from neuroanimator.control.descent.line_search import LineSearch

CONVERGED = 1e-2
"""Relative decrease of J below which Gauss-Newton ends."""

SETTLED = CONVERGED * 1e-1
"""Relative decrease of J below which L-BFGS ends: its decreases are smaller and more numerous than Gauss-Newton's."""

MOMENTUM = 0.9
"""Momentum of the method of 1998: share of the last step that is kept."""

MOMENTUM_STEP = 0.1
"""Step of the method of 1998 in z, along the gradient's direction, since J's gradient spans four decades."""

ADAM_STEP = 0.1
"""Step of Adam in z, whose numbers are of order one."""

ADAM_DECAYS = (0.9, 0.999)
"""Decay rates of Adam's averages of gradients and of their squares (Kingma and Ba, ICLR 2015)."""

TINY_SLOPE = 1e-8
"""Slope far below which there is no step: it prevents division by zero."""

MEMORY = 10
"""Number of gradients that L-BFGS remembers."""

LINE_SEARCH = 8
"""Maximum number of gradients in the line search of an L-BFGS iteration."""

FIRST_DAMPING = 1e-2
"""Initial damping of Gauss-Newton, as a share of the mean curvature."""

DAMPINGS = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Multiples of the last good damping that Gauss-Newton tries in parallel: a batch of rollouts costs little more than one."""

MIN_DAMPING = 1e-6
"""Minimum damping: less makes no difference to a step in float32."""

MAX_DAMPING = 1e6
"""Maximum damping: more leaves no step, and a descent that finds no improvement with it is stuck."""

GAUSS_NEWTON = {
    "converged": CONVERGED,
    "first_damping": FIRST_DAMPING,
    "dampings": list(DAMPINGS),
    "min_damping": MIN_DAMPING,
    "max_damping": MAX_DAMPING,
}
"""Constants of Gauss-Newton, for descents in other languages."""


Vector = Float[np.ndarray, " Z"]
"""Numbers that a descent varies, a step of these, or dJ/dz."""


@dataclass(frozen=True)
class Progress:
    """Progress of the descent from one start."""

    z: np.ndarray
    """Current z (Z,)."""
    best: np.ndarray
    """Best z so far (Z,)."""
    memory: Any
    """Memory of the method."""
    least: float = math.inf
    """J of `best`; infinite before the first iteration."""
    first: float = math.inf
    """J of the initial guess: the first iteration sets it, since it needs it anyway."""
    sweeps: int = 0
    """Number of backward sweeps through the chain of emulators: gradients, or Jacobians with all columns in one batch."""
    is_done: bool = False
    is_diverged: bool = False

    @property
    def is_first(self) -> bool:
        """Whether there was no iteration yet."""
        return self.sweeps == 0


def best_first(costs: Float[np.ndarray, " K"]) -> Int[np.ndarray, " K"]:
    """Return the order of `costs`, the least first; those that are not finite come last."""
    return np.argsort(np.where(np.isfinite(costs), costs, np.inf))


class Method(abc.ABC):
    """A method of descent."""

    @abc.abstractmethod
    def memory(self, z: Vector) -> Any:
        """Return the initial memory of the method."""

    def begin(self, z: Vector) -> Progress:
        """Return the progress before any iteration."""
        return Progress(z, z, self.memory(z))

    @abc.abstractmethod
    def iterate(self, evaluator: Evaluator, starts: Sequence[Progress]) -> list[Progress]:
        """Return the progress of each start after one more iteration."""


class GaussNewton(Method):
    """Levenberg-Marquardt: J is a sum of squares, so its curvature comes for free.

    Terms that are not squares contribute only their gradient. Several dampings are tried in parallel.
    """

    def memory(self, z: Vector) -> float:
        return FIRST_DAMPING

    def iterate(self, evaluator: Evaluator, starts: Sequence[Progress]) -> list[Progress]:
        models = evaluator.quadratic_models(np.stack([start.z for start in starts]))
        trials = []
        for start, model in zip(starts, models, strict=True):
            trials.append(_Trials.of(start, model))
        costs = evaluator.costs(np.concatenate([trial.zs for trial in trials]))
        rows = costs.reshape(len(starts), len(DAMPINGS))
        return [trial.chosen(row) for trial, row in zip(trials, rows, strict=True)]


class _Trials(NamedTuple):
    """Steps of Gauss-Newton from one start, one for each damping."""

    start: Progress
    model: QuadraticModel
    dampings: Float[np.ndarray, " K"]
    zs: Float[np.ndarray, "K Z"]

    @classmethod
    def of(cls, start: Progress, model: QuadraticModel) -> _Trials:
        dampings = np.clip(start.memory * np.array(DAMPINGS), MIN_DAMPING, MAX_DAMPING)
        steps = damped_steps(model.curvature, model.slope, dampings)
        return cls(start, model, dampings, start.z + steps)

    def chosen(self, costs: Float[np.ndarray, " K"]) -> Progress:
        """Return the progress with the best step, given J after each."""
        start = self.start
        costs = np.where(np.isfinite(costs), costs, np.inf)
        k = int(np.argmin(costs))
        cost = float(costs[k])
        if start.is_first:
            start = replace(start, least=self.model.cost, first=self.model.cost)
        is_better = cost < start.least
        is_finite = bool(np.isfinite(self.model.slope).all())
        # The first step finds the scale of the damping; after it, a small decrease, or none at any damping, is the end.
        is_small = is_better and start.least - cost < CONVERGED * start.least and not start.is_first
        is_stuck = not is_better and float(self.dampings[-1]) >= MAX_DAMPING
        following = replace(
            start,
            memory=float(self.dampings[-1]) * DAMPINGS[-1],
            sweeps=start.sweeps + 1,
            is_done=is_small or is_stuck or not is_finite,
            is_diverged=not is_finite,
        )
        if not is_better:
            return following
        z = self.zs[k]
        return replace(following, z=z, best=z, least=cost, memory=float(self.dampings[k]))


def damped_steps(
    curvature: Float[np.ndarray, "Z Z"],
    slope: Vector,
    dampings: Float[np.ndarray, " K"],
) -> Float[np.ndarray, "K Z"]:
    """Return -(curvature + damping · its mean diagonal)⁻¹ slope for each damping, in the precision of `curvature`.

    A step is not finite if there is no inverse.
    """
    (solve,) = get_lapack_funcs(("posv",), (curvature,))
    mean_curvature = np.trace(curvature) / len(slope) + np.finfo(np.float32).tiny
    damped = np.empty_like(curvature, order="F")
    steps = np.empty((len(dampings), len(slope)))
    for row, damping in enumerate(dampings):
        np.copyto(damped, curvature)
        np.fill_diagonal(damped, curvature.diagonal() + damping * mean_curvature)
        _, step, failure = solve(damped, -slope, overwrite_a=True)
        steps[row] = np.nan if failure else step
    return steps


class FirstOrder(Method):
    """A method that steps from each gradient; the best z seen is kept."""

    @abc.abstractmethod
    def step(self, memory: Any, slope: Vector) -> tuple[Vector, Any]:
        """Return (the step after `slope`, the memory after it)."""

    def iterate(self, evaluator: Evaluator, starts: Sequence[Progress]) -> list[Progress]:
        costs, slopes = evaluator.gradients(np.stack([start.z for start in starts]))
        following = []
        for start, cost, slope in zip(starts, costs.tolist(), slopes, strict=True):
            step, memory = self.step(start.memory, slope)
            z = start.z + step
            is_finite = math.isfinite(cost) and bool(np.isfinite(z).all())
            if start.is_first:
                start = replace(start, least=cost, first=cost)
            elif cost < start.least:
                start = replace(start, least=cost, best=start.z)
            moved = replace(
                start,
                z=z,
                memory=memory,
                sweeps=start.sweeps + 1,
                is_done=not is_finite,
                is_diverged=not is_finite,
            )
            following.append(moved)
        return following


class Momentum(FirstOrder):
    """Descent with momentum: eq. 12, with the minus sign that descent needs."""

    def memory(self, z: Vector) -> Vector:
        return np.zeros_like(z)

    def step(self, memory: Vector, slope: Vector) -> tuple[Vector, Vector]:
        direction = slope / (np.linalg.norm(slope) + TINY_SLOPE)
        velocity = MOMENTUM * memory - MOMENTUM_STEP * direction
        return velocity, velocity


class Averages(NamedTuple):
    """Memory of Adam."""

    slope: Vector
    square: Vector
    updates: int


class Adam(FirstOrder):
    """Adam: Kingma and Ba's algorithm 1 (ICLR 2015)."""

    def memory(self, z: Vector) -> Averages:
        return Averages(np.zeros_like(z), np.zeros_like(z), 0)

    def step(self, memory: Averages, slope: Vector) -> tuple[Vector, Averages]:
        slope_decay, square_decay = ADAM_DECAYS
        count = memory.updates + 1
        mean = slope_decay * memory.slope + (1 - slope_decay) * slope
        square = square_decay * memory.square + (1 - square_decay) * slope**2
        mean_unbiased = mean / (1 - slope_decay**count)
        square_unbiased = square / (1 - square_decay**count)
        step = ADAM_STEP * mean_unbiased / (np.sqrt(square_unbiased) + TINY_SLOPE)
        return -step, Averages(mean, square, count)


class Change(NamedTuple):
    """A step and its change of the gradient."""

    step: Vector
    of_slope: Vector


class Curvature(NamedTuple):
    """Memory of L-BFGS."""

    slope: Vector | None = None
    """dJ/dz at z; None before the first iteration."""
    changes: tuple[Change, ...] = ()
    """Changes, the latest last."""

    def newton_step(self) -> Vector:
        """Return the quasi-Newton step: Nocedal and Wright's algorithm 7.4, the two-loop recursion."""
        assert self.slope is not None
        step = -self.slope
        if not self.changes:
            return step / max(1.0, float(np.linalg.norm(step)))
        shares = []
        for change in reversed(self.changes):
            share = change.step @ step / (change.step @ change.of_slope)
            shares.append(share)
            step = step - share * change.of_slope
        latest = self.changes[-1]
        step = step * (latest.step @ latest.of_slope) / (latest.of_slope @ latest.of_slope)
        for change, share in zip(self.changes, reversed(shares), strict=True):
            correction = change.of_slope @ step / (change.step @ change.of_slope)
            step = step + (share - correction) * change.step
        return step

    def after(self, step: Vector, slope: Vector) -> Curvature:
        """Return the memory after `step`, which led to `slope`."""
        change = Change(step, slope - self.slope)
        is_convex = change.step @ change.of_slope > 0
        changes = (*self.changes, change) if is_convex else self.changes
        return Curvature(slope, changes[-MEMORY:])


class LBFGS(Method):
    """L-BFGS: a quasi-Newton method with the curvature of the last steps, and a line search along its steps."""

    def memory(self, z: Vector) -> Curvature:
        return Curvature()

    def iterate(self, evaluator: Evaluator, starts: Sequence[Progress]) -> list[Progress]:
        searches = [_Search(start) for start in self._with_slopes(evaluator, starts)]
        while going := [search for search in searches if search.goes_on]:
            trials = np.stack([search.trial for search in going])
            costs, slopes = evaluator.gradients(trials)
            for search, cost, slope in zip(going, costs, slopes, strict=True):
                search.learn(float(cost), slope)
        pairs = zip(starts, searches, strict=True)
        return [search.progress(settles=not start.is_first) for start, search in pairs]

    def _with_slopes(self, evaluator: Evaluator, starts: Sequence[Progress]) -> list[Progress]:
        """Return the starts; those before their first iteration get J and its gradient at their initial guess."""
        if not any(start.is_first for start in starts):
            return list(starts)
        costs, slopes = evaluator.gradients(np.stack([start.z for start in starts]))
        known = []
        for start, cost, slope in zip(starts, costs.tolist(), slopes, strict=True):
            if start.is_first:
                is_lost = not (math.isfinite(cost) and bool(np.isfinite(slope).all()))
                start = replace(
                    start,
                    least=cost,
                    first=cost,
                    sweeps=1,
                    is_done=is_lost,
                    is_diverged=is_lost,
                    memory=Curvature(slope),
                )
            known.append(start)
        return known


class _Search:
    """One iteration of L-BFGS from one start: a line search, gradient after gradient."""

    def __init__(self, start: Progress):
        self._start = start
        self._direction = start.memory.newton_step()
        slope_along = float(start.memory.slope @ self._direction)
        self._line = LineSearch(start.least, slope_along, step=1.0)
        self._tries = 0
        self._found = start

    @property
    def goes_on(self) -> bool:
        """Whether the search still needs a step."""
        is_over = self._start.is_done or self._line.is_met
        return not is_over and self._tries < LINE_SEARCH

    @property
    def trial(self) -> Vector:
        """The z at which J and its gradient are evaluated next."""
        return self._start.z + self._line.step * self._direction

    def learn(self, cost: float, slope: Vector) -> None:
        """Continue with J and its gradient at `trial`."""
        trial = self.trial
        self._tries += 1
        falls = self._line.learn(cost, float(slope @ self._direction))
        if falls and cost < self._found.least:
            memory = self._start.memory.after(trial - self._start.z, slope)
            self._found = replace(self._start, z=trial, best=trial, least=cost, memory=memory)

    def progress(self, settles: bool) -> Progress:
        """Return the result of the search; it is the end if no step was found, or if `settles` and the decrease is small."""
        fall = self._start.least - self._found.least
        is_settled = settles and fall < SETTLED * self._start.least
        is_stuck = self._found is self._start
        return replace(
            self._found,
            sweeps=self._start.sweeps + self._tries,
            is_done=self._start.is_done or is_settled or is_stuck,
        )


METHODS: dict[str, Method] = {
    "adam": Adam(),
    "gauss-newton": GaussNewton(),
    "lbfgs": LBFGS(),
    "momentum": Momentum(),
}
