"""Methods of descent: what one iteration of each does, for several starts side by side."""

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
"""Relative fall of J below which Gauss-Newton ends."""

SETTLED = CONVERGED * 1e-1
"""Relative fall of J below which L-BFGS ends: its falls are smaller and more than those of Gauss-Newton."""

MOMENTUM = 0.9
"""Share of the last step that the method of 1998 goes on with."""

MOMENTUM_STEP = 0.1
"""Step of the method of 1998 in z, along the gradient's direction, since J's gradient spans four decades."""

ADAM_STEP = 0.1
"""Step of Adam in z, whose numbers are of order one."""

ADAM_DECAYS = (0.9, 0.999)
"""Shares of the averages of slopes and of their squares that Adam keeps (Kingma and Ba, ICLR 2015)."""

TINY_SLOPE = 1e-8
"""Slopes far below it make no step: it keeps from dividing by zero."""

MEMORY = 10
"""Number of gradients L-BFGS remembers."""

LINE_SEARCH = 8
"""Maximum number of gradients an iteration of L-BFGS takes to find its step."""

FIRST_DAMPING = 1e-2
"""Gauss-Newton begins with this damping, a share of the mean curvature."""

DAMPINGS = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Gauss-Newton tries these times the last good damping, side by side: a batch of rollouts costs little more than one."""

MIN_DAMPING = 1e-6
"""Damping below it makes no difference to a step in float32."""

MAX_DAMPING = 1e6
"""Damping above it leaves no step: a descent that finds nothing better with it is stuck."""


@dataclass(frozen=True)
class Progress:
    """How far one start has come."""

    z: np.ndarray
    """(Z,)"""
    best: np.ndarray
    """(Z,)"""
    memory: Any
    """What the method remembers."""
    least: float = math.inf
    """J of `best`; infinite before the first iteration."""
    first: float = math.inf
    """J of the first guess: the first iteration finds it, for it needs it anyway."""
    sweeps: int = 0
    """Backward sweeps through the chain of emulators: gradients, or Jacobians, all columns of which are one batch."""
    is_done: bool = False
    is_diverged: bool = False

    @property
    def is_first(self) -> bool:
        """Whether no iteration was taken yet."""
        return self.sweeps == 0


class Method(abc.ABC):
    """A method of descent."""

    @abc.abstractmethod
    def memory(self, z: Float[np.ndarray, " Z"]) -> Any:
        """Return what the method remembers at first."""

    def begin(self, z: Float[np.ndarray, " Z"]) -> Progress:
        """Return the progress before any iteration."""
        return Progress(z, z, self.memory(z))

    @abc.abstractmethod
    def iterate(self, evaluator: Evaluator, starts: Sequence[Progress]) -> list[Progress]:
        """Return where one more iteration leads each start."""


class GaussNewton(Method):
    """Levenberg-Marquardt: J is a sum of squares, so its curvature comes for free.

    Terms that are no squares join with their slope alone. Several dampings are tried side by side.
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
        # The first step finds the damping's scale; small falls after it, or none at any damping, are the end.
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

    A step is not finite where there is no inverse.
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
    """What Adam remembers."""

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
    """Return the progress from `start`, where J was found to be `cost`, to `following`, where it is not known yet."""
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
    """How a step changed the slope."""

    step: Float[np.ndarray, " Z"]
    of_slope: Float[np.ndarray, " Z"]


class Curvature(NamedTuple):
    """What L-BFGS remembers."""

    slope: Float[np.ndarray, " Z"] | None = None
    """dJ/dz at z; None before the first iteration."""
    changes: tuple[Change, ...] = ()
    """The latest last."""

    def newton_step(self) -> Float[np.ndarray, " Z"]:
        """Return the step to where the slope would vanish: Nocedal and Wright's algorithm 7.4, the two-loop recursion."""
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
        """Return what is remembered after `step`, which led to `slope`."""
        change = Change(step, slope - self.slope)
        is_convex = change.step @ change.of_slope > 0
        changes = (*self.changes, change) if is_convex else self.changes
        return Curvature(slope, changes[-MEMORY:])


class LBFGS(Method):
    """L-BFGS: Newton's method, with the curvature of the last steps, and a line search along its steps."""

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
        """Return the starts, those without an iteration so far with J and its slope at their first guess."""
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
        """Whether a step is still looked for."""
        is_over = self._start.is_done or self._line.is_met
        return not is_over and self._tries < LINE_SEARCH

    @property
    def trial(self) -> Float[np.ndarray, " Z"]:
        """Where J and its slope are to be found next."""
        return self._start.z + self._line.step * self._direction

    def learn(self, cost: float, slope: Float[np.ndarray, " Z"]) -> None:
        """Go on by what J and its slope are at `trial`."""
        trial = self.trial
        self._tries += 1
        falls = self._line.learn(cost, float(slope @ self._direction))
        if falls and cost < self._found.least:
            memory = self._start.memory.after(trial - self._start.z, slope)
            self._found = replace(self._start, z=trial, best=trial, least=cost, memory=memory)

    def progress(self, settles: bool) -> Progress:
        """Return where the search led; where `settles`, a small fall is the end, and where no step was found that is."""
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
