"""Methods of descent: one iteration of each, for several starts in parallel."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
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


class Method(abc.ABC):
    """A method of descent."""

    @abc.abstractmethod
    def memory(self, z: Float[np.ndarray, " Z"]) -> Any:
        """Return the initial memory of the method."""

    def begin(self, z: Float[np.ndarray, " Z"]) -> Progress:
        """Return the progress before any iteration."""
        return Progress(z, z, self.memory(z))

    @abc.abstractmethod
    def iterate(self, evaluator: Evaluator, starts: Sequence[Progress]) -> list[Progress]:
        """Return the progress of each start after one more iteration."""


class GaussNewton(Method):
    """Levenberg-Marquardt: J is a sum of squares, so its curvature comes for free.

    Terms that are not squares contribute only their gradient. Several dampings are tried in parallel.
    """

    def memory(self, z: Float[np.ndarray, " Z"]) -> float:
        return FIRST_DAMPING

    def iterate(self, evaluator: Evaluator, starts: Sequence[Progress]) -> list[Progress]:
        models = evaluator.quadratic_models(np.stack([start.z for start in starts]))
        trials = []
        for start, model in zip(starts, models, strict=True):
            steps = damped_steps(model.curvature, model.slope, self._dampings(start))
            trials.append(start.z + steps)
        costs = evaluator.costs(np.concatenate(trials)).reshape(len(starts), len(DAMPINGS))
        following = []
        for start, model, zs, costs_of_start in zip(starts, models, trials, costs, strict=True):
            following.append(self._choose(start, model, zs, costs_of_start))
        return following

    def _dampings(self, start: Progress) -> Float[np.ndarray, " K"]:
        return np.clip(start.memory * np.array(DAMPINGS), MIN_DAMPING, MAX_DAMPING)

    def _choose(
        self,
        start: Progress,
        model: QuadraticModel,
        trials: Float[np.ndarray, "K Z"],
        costs: Float[np.ndarray, " K"],
    ) -> Progress:
        """Return the progress with the best of `trials`."""
        dampings = self._dampings(start)
        costs = np.where(np.isfinite(costs), costs, np.inf)
        k = int(np.argmin(costs))
        cost = float(costs[k])
        first = model.cost if start.is_first else start.first
        least = model.cost if start.is_first else start.least
        is_better = cost < least
        is_finite = bool(np.isfinite(model.slope).all())
        # The first step finds the scale of the damping; after it, a small decrease, or none at any damping, is the end.
        is_small = is_better and least - cost < CONVERGED * least and not start.is_first
        is_stuck = not is_better and float(dampings[-1]) >= MAX_DAMPING
        following = replace(
            start,
            least=least,
            first=first,
            sweeps=start.sweeps + 1,
            is_done=is_small or is_stuck or not is_finite,
            is_diverged=not is_finite,
        )
        if not is_better:
            return replace(following, memory=float(dampings[-1]) * DAMPINGS[-1])
        return replace(
            following, z=trials[k], best=trials[k], least=cost, memory=float(dampings[k])
        )


def damped_steps(
    curvature: Float[np.ndarray, "Z Z"],
    slope: Float[np.ndarray, " Z"],
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


class Momentum(Method):
    """Descent with momentum: eq. 12, with the minus sign that descent needs; the best z seen is kept."""

    def memory(self, z: Float[np.ndarray, " Z"]) -> Float[np.ndarray, " Z"]:
        return np.zeros_like(z)

    def iterate(self, evaluator: Evaluator, starts: Sequence[Progress]) -> list[Progress]:
        costs, slopes = evaluator.gradients(np.stack([start.z for start in starts]))
        following = []
        for start, cost, slope in zip(starts, costs, slopes, strict=True):
            direction = slope / (np.linalg.norm(slope) + TINY_SLOPE)
            velocity = MOMENTUM * start.memory - MOMENTUM_STEP * direction
            following.append(_moved(start, float(cost), start.z + velocity, velocity))
        return following


class Averages(NamedTuple):
    """Memory of Adam."""

    slope: Float[np.ndarray, " Z"]
    square: Float[np.ndarray, " Z"]
    updates: int


class Adam(Method):
    """Adam: Kingma and Ba's algorithm 1 (ICLR 2015); the best z seen is kept."""

    def memory(self, z: Float[np.ndarray, " Z"]) -> Averages:
        return Averages(np.zeros_like(z), np.zeros_like(z), 0)

    def iterate(self, evaluator: Evaluator, starts: Sequence[Progress]) -> list[Progress]:
        costs, slopes = evaluator.gradients(np.stack([start.z for start in starts]))
        following = []
        for start, cost, slope in zip(starts, costs, slopes, strict=True):
            averages, step = self._step(start.memory, slope)
            following.append(_moved(start, float(cost), start.z - step, averages))
        return following

    def _step(
        self, averages: Averages, slope: Float[np.ndarray, " Z"]
    ) -> tuple[Averages, Float[np.ndarray, " Z"]]:
        slope_decay, square_decay = ADAM_DECAYS
        count = averages.updates + 1
        mean = slope_decay * averages.slope + (1 - slope_decay) * slope
        square = square_decay * averages.square + (1 - square_decay) * slope**2
        mean_unbiased = mean / (1 - slope_decay**count)
        square_unbiased = square / (1 - square_decay**count)
        step = ADAM_STEP * mean_unbiased / (np.sqrt(square_unbiased) + TINY_SLOPE)
        return Averages(mean, square, count), step


def _moved(
    start: Progress, cost: float, following: Float[np.ndarray, " Z"], memory: Any
) -> Progress:
    """Return the progress from `start`, where J is `cost`, to `following`, where J is not known yet."""
    is_finite = math.isfinite(cost) and bool(np.isfinite(following).all())
    is_better = start.is_first or cost < start.least
    return replace(
        start,
        z=following,
        best=start.z if is_better else start.best,
        least=cost if is_better else start.least,
        first=cost if start.is_first else start.first,
        memory=memory,
        sweeps=start.sweeps + 1,
        is_done=not is_finite,
        is_diverged=not is_finite,
    )


class Change(NamedTuple):
    """A step and its change of the gradient."""

    step: Float[np.ndarray, " Z"]
    of_slope: Float[np.ndarray, " Z"]


class Curvature(NamedTuple):
    """Memory of L-BFGS."""

    slope: Float[np.ndarray, " Z"] | None = None
    """dJ/dz at z; None before the first iteration."""
    changes: tuple[Change, ...] = ()
    """Changes, the latest last."""

    def newton_step(self) -> Float[np.ndarray, " Z"]:
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

    def after(self, step: Float[np.ndarray, " Z"], slope: Float[np.ndarray, " Z"]) -> Curvature:
        """Return the memory after `step`, which led to `slope`."""
        change = Change(step, slope - self.slope)
        is_convex = change.step @ change.of_slope > 0
        changes = (*self.changes, change) if is_convex else self.changes
        return Curvature(slope, changes[-MEMORY:])


class LBFGS(Method):
    """L-BFGS: a quasi-Newton method with the curvature of the last steps, and a line search along its steps."""

    def memory(self, z: Float[np.ndarray, " Z"]) -> Curvature:
        return Curvature()

    def iterate(self, evaluator: Evaluator, starts: Sequence[Progress]) -> list[Progress]:
        searches = []
        for start in self._with_slopes(evaluator, starts):
            searches.append(_Search(start))
        while True:
            going = [search for search in searches if search.goes_on]
            if not going:
                break
            trials = np.stack([search.trial for search in going])
            costs, slopes = evaluator.gradients(trials)
            for search, cost, slope in zip(going, costs, slopes, strict=True):
                search.learn(float(cost), slope)
        following = []
        for start, search in zip(starts, searches, strict=True):
            following.append(search.progress(settles=not start.is_first))
        return following

    def _with_slopes(self, evaluator: Evaluator, starts: Sequence[Progress]) -> list[Progress]:
        """Return the starts; those before their first iteration get J and its gradient at their initial guess."""
        if not any(start.is_first for start in starts):
            return list(starts)
        costs, slopes = evaluator.gradients(np.stack([start.z for start in starts]))
        known = []
        for start, cost, slope in zip(starts, costs, slopes, strict=True):
            known.append(self._with_slope(start, float(cost), slope))
        return known

    def _with_slope(self, start: Progress, cost: float, slope: Float[np.ndarray, " Z"]) -> Progress:
        if not start.is_first:
            return start
        is_finite = math.isfinite(cost) and bool(np.isfinite(slope).all())
        return replace(
            start,
            least=cost,
            first=cost,
            sweeps=1,
            is_done=not is_finite,
            is_diverged=not is_finite,
            memory=Curvature(slope),
        )


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
    def trial(self) -> Float[np.ndarray, " Z"]:
        """The z at which J and its gradient are evaluated next."""
        return self._start.z + self._line.step * self._direction

    def learn(self, cost: float, slope: Float[np.ndarray, " Z"]) -> None:
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
