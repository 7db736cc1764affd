"""J as a function of the numbers a descent varies."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.control.descent.defects import rollout_with_defects, step_with_defect
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.objective.objective import Objective, Trajectory
from neuroanimator.emulator.compiled import call_compiled
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.state.arrays import AnyArray

BACKWARD_COST = 3
"""Number of forward sweeps that cost as much as one backward sweep."""


class Linearised(NamedTuple):
    """J near some z: half the sum of squares of residuals that change in proportion, and a rest that does so."""

    residuals: Float[Array, " R"]
    jacobian: Float[Array, "R Z"]
    """How the residuals change with z."""
    slope: Float[Array, " Z"]
    """Of the rest, which is no sum of squares."""
    cost: Float[Array, ""]
    """J at z."""


class MotionTangents(NamedTuple):
    """An emulated motion and how it changes with z."""

    latent: Float[Array, "T+1 I"]
    controls: Float[Array, "T C"]
    push: Callable[[Array], tuple[Array, Array]]
    """Change of z (Z,) → changes of `latent` and of `controls`."""


class Problem(eqx.Module):
    """z (Z,) → controls → emulated trajectory → J. For use inside jit, grad and vmap."""

    emulator: Emulator
    objective: Objective
    parametrisation: Parametrisation
    start: Float[AnyArray, " S"]
    defects: Float[AnyArray, "T V"]
    """Added to the super steps: see `find_defects`."""
    control_scale: Float[AnyArray, " C"]

    def trajectory(self, z: Float[Array, " Z"]) -> Trajectory:
        """Return the emulated motion under the controls of z."""
        controls = self.parametrisation.controls(z)
        return self._trajectory(self._rollout(controls), controls)

    def cost(self, z: Float[Array, " Z"]) -> Float[Array, ""]:
        """Return J."""
        return self.objective(self.trajectory(z))

    def linearised(self, z: Float[Array, " Z"]) -> Linearised:
        """Return J and how it changes near `z`."""
        of_states, of_controls = self.objective.apart()
        if self._has_few_residuals(of_states, z):
            states_part = self._linearise_backward(of_states, z)
        else:
            states_part = self._linearise_forward(of_states, z)
        controls_part = self._linearise_controls(of_controls, z)
        residuals = jnp.concatenate([states_part[0], controls_part[0]])
        jacobian = jnp.concatenate([states_part[1], controls_part[1]])
        cost = jnp.sum(residuals**2) / 2
        slope = jnp.zeros_like(z)
        if self.objective.functions:
            extra, slope = jax.value_and_grad(self._extra)(z)
            cost += extra
        return Linearised(residuals, jacobian, slope, cost)

    def _extra(self, z: Float[Array, " Z"]) -> Float[Array, ""]:
        return self.objective.extra(self.trajectory(z))

    def _has_few_residuals(self, of_states: Objective, z: Float[Array, " Z"]) -> bool:
        """Return whether states make so few residuals that pulling these back is the least work."""
        steps = self.parametrisation.steps
        states = jax.ShapeDtypeStruct((steps + 1, len(self.start)), z.dtype)
        controls = jax.ShapeDtypeStruct((steps, len(self.control_scale)), z.dtype)

        def residuals(states: Array, controls: Array) -> Array:
            motion = Trajectory(states, controls, self.control_scale, self.emulator.dt)
            return of_states.residuals(motion)

        count = jax.eval_shape(residuals, states, controls).shape[0]
        return BACKWARD_COST * count < min(len(z), self._inputs_of_step)

    def _linearise_backward(
        self, of_states: Objective, z: Float[Array, " Z"]
    ) -> tuple[Float[Array, " R"], Float[Array, "R Z"]]:
        """Return residuals and their Jacobian, by a backward sweep for all of them."""

        def residuals_of(z: Array) -> Array:
            return of_states.residuals(self.trajectory(z))

        residuals, pull_back = jax.vjp(residuals_of, z)
        units = jnp.eye(len(residuals), dtype=z.dtype)
        (jacobian,) = jax.vmap(pull_back)(units)
        return residuals, jacobian

    def _linearise_forward(
        self, of_states: Objective, z: Float[Array, " Z"]
    ) -> tuple[Float[Array, " R"], Float[Array, "R Z"]]:
        """Return residuals and their Jacobian, by forward sweeps."""
        if len(z) <= 2 * self._inputs_of_step:
            motion = self._differentiate_at_once(z)
        else:
            motion = self._differentiate_step_by_step(z)

        def residuals_of(latent: Array, controls: Array) -> Array:
            return of_states.residuals(self._trajectory(latent, controls))

        residuals, tangent = jax.linearize(residuals_of, motion.latent, motion.controls)

        def column(unit: Array) -> Array:
            return tangent(*motion.push(unit))

        units = jnp.eye(len(z), dtype=z.dtype)
        return residuals, jax.vmap(column, out_axes=1)(units)

    def _linearise_controls(
        self, of_controls: Objective, z: Float[Array, " Z"]
    ) -> tuple[Float[Array, " R"], Float[Array, "R Z"]]:
        """Return residuals and their Jacobian of terms that depend on nothing but controls."""

        def residuals_of(z: Array) -> Array:
            controls = self.parametrisation.controls(z)
            motion = Trajectory(self.start[None], controls, self.control_scale, self.emulator.dt)
            return of_controls.residuals(motion)

        return residuals_of(z), jax.jacfwd(residuals_of)(z)

    @property
    def _inputs_of_step(self) -> int:
        """How many numbers a super step depends on: single ones are cheaper to differentiate where z has far more."""
        return self.emulator.normaliser.change_scale.shape[0] + len(self.control_scale)

    def _differentiate_at_once(self, z: Float[Array, " Z"]) -> MotionTangents:
        """Return the motion and how it changes with z, by pushing z through the whole rollout."""

        def motion_of(z: Array) -> tuple[Array, Array]:
            controls = self.parametrisation.controls(z)
            return self._rollout(controls), controls

        (latent, controls), push = jax.linearize(motion_of, z)
        return MotionTangents(latent, controls, push)

    def _differentiate_step_by_step(self, z: Float[Array, " Z"]) -> MotionTangents:
        """Return the same by the chain rule: the Jacobians of all super steps side by side, then their products."""
        controls, push_controls = jax.linearize(self.parametrisation.controls, z)
        latent = self._rollout(controls)
        latent_controls = self.emulator.encode_control(controls)

        def advance(latent: Array, control: Array, defect: Array) -> Array:
            return step_with_defect(self.emulator, latent, control, defect)

        jacobians = jax.vmap(jax.jacfwd(advance, (0, 1)))
        by_state, by_control = jacobians(latent[:-1], latent_controls, self.defects)

        def push(unit: Array) -> tuple[Array, Array]:
            control_change = push_controls(unit)

            def advance_change(
                change: Array, inputs: tuple[Array, Array, Array]
            ) -> tuple[Array, Array]:
                of_state, of_control, control_change = inputs
                following = of_state @ change + of_control @ control_change
                return following, following

            no_change = jnp.zeros_like(latent[0])
            inputs = (by_state, by_control, self.emulator.encode_control(control_change))
            _, changes = jax.lax.scan(advance_change, no_change, inputs)
            return jnp.concatenate([no_change[None], changes]), control_change

        return MotionTangents(latent, controls, push)

    def _rollout(self, controls: Float[Array, "T C"]) -> Float[Array, "T+1 I"]:
        # Traced once, however often a program follows the emulator.
        latent = self.emulator.encode(self.start)
        return call_compiled(rollout_with_defects, self.emulator, latent, controls, self.defects)

    def _trajectory(
        self, latent: Float[Array, "T1 I"], controls: Float[Array, "T C"]
    ) -> Trajectory:
        states = jnp.concatenate([self.start[None], self.emulator.decode(latent[1:])])
        return Trajectory(states, controls, self.control_scale, self.emulator.dt)
