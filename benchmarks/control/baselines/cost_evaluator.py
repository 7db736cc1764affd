"""J of the physics as a function of z, the numbers a search varies."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from benchmarks.control.baselines.fast_physics import FastPhysics
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.objective.objective import Objective, Trajectory

DIVERGED_COST = 1e9
"""J of a motion that makes the physics diverge, or has no finite J: finite, for baselines take differences of it."""

MAX_PROGRAMS = 64
"""Number of compiled objectives kept: many runs are for cost terms that differ in numbers alone."""


class Linearisation(NamedTuple):
    """The cost terms about one z."""

    residuals: Float[np.ndarray, " R"]
    jacobian: Float[np.ndarray, "R Z"]
    slope: Float[np.ndarray, " Z"]
    """The derivative of what is no sum of squares."""


class CostEvaluator:
    """z → controls → physics → J; for one z, or for as many as `batch` at a time."""

    def __init__(
        self,
        physics: FastPhysics,
        objective: Objective,
        parametrisation: Parametrisation,
        dt: float,
        start: Float[np.ndarray, " S"],
        control_scale: Float[np.ndarray, " C"],
        batch: int,
    ):
        self.physics = physics
        self.batch = batch
        arrays, static = eqx.partition((objective, parametrisation), eqx.is_array)
        self._arrays, arrays_structure = jax.tree.flatten(arrays)
        static_leaves, static_structure = jax.tree.flatten(static)
        template = _Template(arrays_structure, tuple(static_leaves), static_structure)
        self._programs = _compiled(template, dt)
        self._start = jnp.asarray(start, jnp.float32)
        self._control_scale = jnp.asarray(control_scale, jnp.float32)

    def controls(self, zs: Float[np.ndarray, "B Z"]) -> Float[np.ndarray, "B T C"]:
        """Return the controls of each z."""
        return np.asarray(self._programs.controls(self._arrays, np.asarray(zs, np.float32)))

    def slopes(self, z: Float[np.ndarray, " Z"]) -> Float[np.ndarray, "Z T C"]:
        """Return how the controls change with `z`."""
        return np.asarray(self._programs.slopes(self._arrays, np.asarray(z, np.float32)), float)

    def costs(self, zs: Float[np.ndarray, "B Z"]) -> Float[np.ndarray, " B"]:
        """Return J of each z; there may be at most `batch` of them."""
        count = len(zs)
        if count > 1:
            # One compiled program serves any number of them: the last fills the batch up.
            zs = zs[np.arange(self.batch).clip(max=count - 1)]
        controls = self.controls(zs)
        states, has_diverged = self.physics.rollout(controls[:count])
        costs = self._programs.costs(
            self._arrays, self._start, self._control_scale, states, controls
        )
        costs = np.asarray(costs)[:count]
        return np.where(~has_diverged & np.isfinite(costs), costs, DIVERGED_COST).astype(float)

    def linearised(
        self,
        states: Float[np.ndarray, "T S"],
        controls: Float[np.ndarray, "T C"],
        state_changes: Float[np.ndarray, "Z T S"],
        control_changes: Float[np.ndarray, "Z T C"],
    ) -> Linearisation:
        """Return the cost terms about a motion, whose states and controls change with z as given."""
        inputs = [
            np.asarray(array, np.float32)
            for array in (states, controls, state_changes, control_changes)
        ]
        residuals, jacobian, slope = self._programs.linearised(
            self._arrays, self._start, self._control_scale, *inputs
        )
        return Linearisation(
            np.asarray(residuals, float), np.asarray(jacobian, float), np.asarray(slope, float)
        )


class _Template(NamedTuple):
    """An objective and a parametrisation without their arrays: hashable, so that programs are found by it again."""

    arrays_structure: Any
    static_leaves: tuple[Any, ...]
    static_structure: Any

    def filled(self, arrays: list[Array]) -> tuple[Objective, Parametrisation]:
        """Return the objective and the parametrisation with these arrays."""
        dynamic = jax.tree.unflatten(self.arrays_structure, arrays)
        static = jax.tree.unflatten(self.static_structure, list(self.static_leaves))
        return eqx.combine(dynamic, static)


class _Programs:
    """What an objective and a parametrisation compile to. Their arrays come first in every call."""

    def __init__(self, template: _Template, dt: float):
        self._template = template
        self._dt = dt
        self.controls = jax.jit(self._controls)
        self.slopes = jax.jit(self._slopes)
        self.costs = jax.jit(self._costs)
        self.linearised = jax.jit(self._linearised)

    def _controls(self, arrays: list[Array], zs: Float[Array, "B Z"]) -> Float[Array, "B T C"]:
        _, parametrisation = self._template.filled(arrays)
        return jax.vmap(parametrisation.controls)(zs)

    def _slopes(self, arrays: list[Array], z: Float[Array, " Z"]) -> Float[Array, "Z T C"]:
        _, parametrisation = self._template.filled(arrays)
        return jnp.moveaxis(jax.jacfwd(parametrisation.controls)(z), -1, 0)

    def _costs(
        self,
        arrays: list[Array],
        start: Float[Array, " S"],
        control_scale: Float[Array, " C"],
        states: Float[Array, "G T S L"],
        controls: Float[Array, "B T C"],
    ) -> Float[Array, " B"]:
        objective, _ = self._template.filled(arrays)

        def cost(states: Float[Array, "T S"], controls: Float[Array, "T C"]) -> Float[Array, ""]:
            return objective(self._trajectory(start, control_scale, states, controls))

        groups, lanes = states.shape[0], states.shape[-1]
        grouped = controls.reshape(groups, lanes, *controls.shape[1:])
        cost_of_lanes = jax.vmap(cost, in_axes=(2, 0))
        return jax.vmap(cost_of_lanes)(states, grouped).ravel()

    def _linearised(
        self,
        arrays: list[Array],
        start: Float[Array, " S"],
        control_scale: Float[Array, " C"],
        states: Float[Array, "T S"],
        controls: Float[Array, "T C"],
        state_changes: Float[Array, "Z T S"],
        control_changes: Float[Array, "Z T C"],
    ) -> tuple[Float[Array, " R"], Float[Array, "R Z"], Float[Array, " Z"]]:
        objective, _ = self._template.filled(arrays)

        def residuals_of(states: Float[Array, "T S"], controls: Float[Array, "T C"]) -> Array:
            return objective.residuals(self._trajectory(start, control_scale, states, controls))

        def extra_of(states: Float[Array, "T S"], controls: Float[Array, "T C"]) -> Array:
            return objective.extra(self._trajectory(start, control_scale, states, controls))

        residuals, change_residuals = jax.linearize(residuals_of, states, controls)
        _, change_extra = jax.linearize(extra_of, states, controls)
        jacobian = jax.vmap(change_residuals, out_axes=1)(state_changes, control_changes)
        slope = jax.vmap(change_extra)(state_changes, control_changes)
        return residuals, jacobian, slope

    def _trajectory(
        self, start: Array, control_scale: Array, states: Array, controls: Array
    ) -> Trajectory:
        path = jnp.concatenate([start[None], states])
        return Trajectory(path, controls, control_scale, self._dt)


@lru_cache(maxsize=MAX_PROGRAMS)
def _compiled(template: _Template, dt: float) -> _Programs:
    return _Programs(template, dt)
