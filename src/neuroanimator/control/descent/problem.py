"""J as a function of the numbers a descent varies."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.control.descent.defects import rollout_with_defects
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


class VariedParameters(eqx.Module):
    """Parameters of a body that a descent varies beside its controls: middle + half · tanh(w), within their ranges."""

    entries: tuple[int, ...] = eqx.field(static=True)
    """State entries of the parameters."""
    middle: Float[AnyArray, " P"]
    half: Float[AnyArray, " P"]
    growth: Float[AnyArray, "S P"]
    """Change of the start per unit of each parameter: a deformable body of another length begins in another shape."""

    def put(self, start: Float[AnyArray, " S"], w: Float[AnyArray, " P"]) -> Float[Array, " S"]:
        """Return the start of a body with the parameters of `w`."""
        values = self.middle + jnp.tanh(w) * self.half
        entries = np.array(self.entries)
        begin = jnp.asarray(start, w.dtype)
        grown = begin + self.growth @ (values - begin[entries])
        return grown.at[entries].set(values)


class Problem(eqx.Module):
    """z (Z,) → controls → emulated trajectory → J. For use inside jit, grad and vmap."""

    emulator: Emulator
    objective: Objective
    parametrisation: Parametrisation
    start: Float[AnyArray, " S"]
    defects: Float[AnyArray, "T V"]
    """Added to the super steps: see `find_defects`."""
    control_scale: Float[AnyArray, " C"]
    varied: VariedParameters | None = None
    """What of the body is varied, too: the last numbers of z; None if nothing is."""

    def trajectory(self, z: Float[Array, " Z"]) -> Trajectory:
        """Return the emulated motion under the controls of z."""
        controls = self._controls(z)
        start = self.start
        if self.varied is not None:
            start = self.varied.put(start, z[self.parametrisation.size :])
        return self._trajectory(start, self._rollout(start, controls), controls)

    def _controls(self, z: Float[Array, " Z"]) -> Float[Array, "T C"]:
        if self.varied is not None:
            z = z[: self.parametrisation.size]
        return self.parametrisation.controls(z)

    def cost(self, z: Float[Array, " Z"]) -> Float[Array, ""]:
        """Return J."""
        return self.objective(self.trajectory(z))

    def linearised(self, z: Float[Array, " Z"]) -> Linearised:
        """Return J and how it changes near `z`."""
        of_states, of_controls = self.objective.apart()

        def of_motion(z: Array) -> Array:
            return of_states.residuals(self.trajectory(z))

        def of_effort(z: Array) -> Array:
            controls = self._controls(z)
            motion = Trajectory(self.start[None], controls, self.control_scale, self.emulator.dt)
            return of_controls.residuals(motion)

        count = jax.eval_shape(of_motion, z).shape[0]
        if BACKWARD_COST * count < len(z):
            motion_residuals, pull_back = jax.vjp(of_motion, z)
            (by_motion,) = jax.vmap(pull_back)(jnp.eye(count))
        else:
            motion_residuals, push = jax.linearize(of_motion, z)
            by_motion = jax.vmap(push, out_axes=1)(jnp.eye(len(z)))
        residuals = jnp.concatenate([motion_residuals, of_effort(z)])
        jacobian = jnp.concatenate([by_motion, jax.jacfwd(of_effort)(z)])
        cost = jnp.sum(residuals**2) / 2
        slope = jnp.zeros_like(z)
        if self.objective.functions:
            extra, slope = jax.value_and_grad(self._extra)(z)
            cost += extra
        return Linearised(residuals, jacobian, slope, cost)

    def _extra(self, z: Float[Array, " Z"]) -> Float[Array, ""]:
        return self.objective.extra(self.trajectory(z))

    def _rollout(
        self, start: Float[AnyArray, " S"], controls: Float[Array, "T C"]
    ) -> Float[Array, "T+1 I"]:
        # Traced once, however often a program follows the emulator.
        latent = self.emulator.encode(start)
        return call_compiled(rollout_with_defects, self.emulator, latent, controls, self.defects)

    def _trajectory(
        self,
        start: Float[AnyArray, " S"],
        latent: Float[Array, "T1 I"],
        controls: Float[Array, "T C"],
    ) -> Trajectory:
        states = jnp.concatenate([start[None], self.emulator.decode(latent[1:])])
        return Trajectory(states, controls, self.control_scale, self.emulator.dt)
