"""Methods of descent: what one iteration of each does. All run compiled, and for many starts at once.

optax is imported where it is needed: Gauss-Newton does without, and starts sooner.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.control.descent.problem import Problem

if TYPE_CHECKING:
    import optax

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

MEMORY = 10
"""L-BFGS remembers so many gradients."""

LINE_SEARCH = 8
"""An iteration of L-BFGS may take so many gradients to find its step."""

FIRST_DAMPING = 1e-2
"""Gauss-Newton begins with this damping, a share of the mean curvature."""

DAMPINGS = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Gauss-Newton tries these times the last good damping, side by side: a batch of rollouts costs little more than one."""

MIN_DAMPING = 1e-6
"""Damping below it makes no difference to a step in float32."""

MAX_DAMPING = 1e6
"""Damping above it leaves no step: a descent that finds nothing better with it is stuck."""


class Progress(NamedTuple):
    """How far one start has come."""

    z: Float[Array, " Z"]
    best: Float[Array, " Z"]
    least: Float[Array, ""]
    """J of `best`; infinite before the first iteration."""
    first: Float[Array, ""]
    """J of the first guess: the first iteration finds it, for it needs it anyway."""
    sweeps: Array
    """Backward sweeps through the chain of emulators: gradients, or Jacobians, all columns of which are one batch."""
    is_done: Array
    is_diverged: Array
    memory: Any
    """What the method remembers."""


class Method(eqx.Module):
    """A method of descent."""

    @abc.abstractmethod
    def memory(self, z: Float[Array, " Z"]) -> Any:
        """Return what the method remembers at first."""

    def begin(self, z: Float[Array, " Z"]) -> Progress:
        """Return the progress before any iteration."""
        return Progress(
            z=z,
            best=z,
            least=jnp.asarray(jnp.inf, z.dtype),
            first=jnp.asarray(jnp.inf, z.dtype),
            sweeps=jnp.zeros((), int),
            is_done=jnp.zeros((), bool),
            is_diverged=jnp.zeros((), bool),
            memory=self.memory(z),
        )

    @abc.abstractmethod
    def iterate(self, problem: Problem, progress: Progress) -> Progress:
        """Return where one more iteration leads."""


class GaussNewton(Method):
    """Levenberg-Marquardt: J is a sum of squares, so its curvature comes for free.

    Terms that are no squares join with their slope alone. Several dampings are tried side by side.
    """

    def memory(self, z: Float[Array, " Z"]) -> Any:
        return jnp.asarray(FIRST_DAMPING, z.dtype)

    def iterate(self, problem: Problem, progress: Progress) -> Progress:
        z = progress.z
        residuals, jacobian, slope_of_rest, cost = problem.linearised(z)
        curvature = jacobian.T @ jacobian
        slope = jacobian.T @ residuals + slope_of_rest
        mean_curvature = jnp.trace(curvature) / len(z) + jnp.finfo(z.dtype).tiny

        def step(damping: Array) -> Array:
            return _solve(curvature + damping * mean_curvature * jnp.eye(len(z)), slope)

        dampings = jnp.clip(progress.memory * jnp.array(DAMPINGS), MIN_DAMPING, MAX_DAMPING)
        trials = z - jax.vmap(step)(dampings)
        costs = jax.vmap(problem.cost)(trials)
        costs = jnp.where(jnp.isfinite(costs), costs, jnp.inf)
        k = jnp.argmin(costs)
        is_first = progress.sweeps == 0
        least = jnp.where(is_first, cost, progress.least)
        is_better = costs[k] < least
        fall = least - costs[k]
        following = jnp.where(is_better, trials[k], z)
        is_finite = jnp.isfinite(slope).all()
        # The first step finds the damping's scale; small falls after it, or none at any damping, are the end.
        is_stuck = ~is_better & (dampings[-1] >= MAX_DAMPING)
        is_small = is_better & (fall < CONVERGED * least)
        return Progress(
            z=following,
            best=following,
            least=jnp.where(is_better, costs[k], least),
            first=jnp.where(is_first, cost, progress.first),
            sweeps=progress.sweeps + 1,
            is_done=(is_small & ~is_first) | is_stuck | ~is_finite,
            is_diverged=~is_finite,
            memory=jnp.where(is_better, dampings[k], dampings[-1] * DAMPINGS[-1]),
        )


def _solve(matrix: Float[Array, "Z Z"], slope: Float[Array, " Z"]) -> Float[Array, " Z"]:
    return jax.scipy.linalg.solve(matrix, slope, assume_a="pos")


class FirstOrder(Method):
    """Any gradient method of optax; the best z seen is kept."""

    make: Callable[[], optax.GradientTransformationExtraArgs] = eqx.field(static=True)
    settles: bool = eqx.field(static=True, default=False)
    """Whether small falls mean the end: those of momentum and Adam come and go."""

    def memory(self, z: Float[Array, " Z"]) -> Any:
        return self.make().init(z)

    def iterate(self, problem: Problem, progress: Progress) -> Progress:
        import optax

        descent = self.make()
        if self.settles:
            cost, slope = optax.value_and_grad_from_state(problem.cost)(
                progress.z, state=progress.memory
            )
        else:
            cost, slope = jax.value_and_grad(problem.cost)(progress.z)
        update, memory = descent.update(
            slope, progress.memory, progress.z, value=cost, grad=slope, value_fn=problem.cost
        )
        following = optax.apply_updates(progress.z, update)
        assert isinstance(following, jax.Array)
        # A line search knows J of where it goes; the others know that of where they were.
        if self.settles:
            reached = optax.tree.get(memory, "value")
            reached_z = following
            sweeps = _line_search_steps(memory)
        else:
            reached = cost
            reached_z = progress.z
            sweeps = 1
        is_first = progress.sweeps == 0
        least = jnp.where(is_first, cost, progress.least)
        is_better = reached < least
        fall = least - reached
        is_finite = jnp.isfinite(cost) & jnp.isfinite(following).all()
        return Progress(
            z=following,
            best=jnp.where(is_better, reached_z, progress.best),
            least=jnp.where(is_better, reached, least),
            first=jnp.where(is_first, cost, progress.first),
            sweeps=progress.sweeps + sweeps + (is_first if self.settles else 0),
            is_done=~is_finite | (self.settles & ~is_first & (fall < SETTLED * least)),
            is_diverged=~is_finite,
            memory=memory,
        )


def _line_search_steps(memory: Any) -> Array:
    import optax

    return jnp.maximum(optax.tree.get(memory, "info").num_linesearch_steps, 1)


def _momentum() -> optax.GradientTransformationExtraArgs:
    """Descent with momentum: eq. 12, with the minus sign that descent needs."""
    import optax

    return optax.with_extra_args_support(
        optax.chain(optax.normalize_by_update_norm(), optax.sgd(MOMENTUM_STEP, momentum=MOMENTUM))
    )


def _adam() -> optax.GradientTransformationExtraArgs:
    import optax

    return optax.with_extra_args_support(optax.adam(ADAM_STEP))


def _lbfgs() -> optax.GradientTransformationExtraArgs:
    import optax

    return optax.lbfgs(memory_size=MEMORY, linesearch=optax.scale_by_zoom_linesearch(LINE_SEARCH))


METHODS: dict[str, Method] = {
    "adam": FirstOrder(_adam),
    "gauss-newton": GaussNewton(),
    "lbfgs": FirstOrder(_lbfgs, settles=True),
    "momentum": FirstOrder(_momentum),
}
