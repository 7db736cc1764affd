"""J as a function of the numbers that a descent varies."""

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
    """J linearised near some z: half the sum of squares of linear residuals, and a linear rest."""

    residuals: Float[Array, " R"]
    jacobian: Float[Array, "R Z"]
    """Jacobian of the residuals by z."""
    slope: Float[Array, " Z"]
    """Gradient of the rest, which is not a sum of squares."""
    cost: Float[Array, ""]
    """J at z."""


class VariedParameters(eqx.Module):
    """Parameters of a body that a descent varies beside its controls: middle + half · tanh(w), within their ranges.

    The numbers z of the descent are those of the `parametrisation` of the controls, then w.
    """

    parametrisation: Parametrisation
    entries: tuple[int, ...] = eqx.field(static=True)
    """State entries of the parameters."""
    latent_entries: tuple[int, ...] = eqx.field(static=True)
    """Entries of the latent state that hold them unchanged."""
    middle: Float[AnyArray, " P"]
    half: Float[AnyArray, " P"]

    @property
    def size(self) -> int:
        """Length of z."""
        return self.parametrisation.size + len(self.entries)

    def controls(self, z: Float[AnyArray, " Z"]) -> Float[AnyArray, "T C"]:
        """Return the controls of z."""
        return self.parametrisation.controls(z[: self.parametrisation.size])

    def values(self, z: Float[AnyArray, " Z"]) -> Float[AnyArray, " P"]:
        """Return the parameters of z."""
        xp = z.__array_namespace__()
        return self.middle + xp.tanh(z[self.parametrisation.size :]) * self.half


class Problem(eqx.Module):
    """z (Z,) → controls → emulated trajectory → J. For use inside jit, grad and vmap."""

    emulator: Emulator
    objective: Objective
    parametrisation: Parametrisation
    start: Float[AnyArray, " S"]
    defects: Float[AnyArray, "T V"]
    """Defects added to the super steps: see `find_defects`."""
    control_scale: Float[AnyArray, " C"]
    varied: VariedParameters | None = None
    """Parameters of the body that are varied, too, by the last numbers of z; None for none.

    Terms that look at the start see `start`: a body of other parameters begins there, in its own shape.
    """

    def trajectory(self, z: Float[Array, " Z"]) -> Trajectory:
        """Return the emulated motion under the controls of z."""
        controls = self._controls(z)
        # Traced once, however many times a program follows the emulator.
        latent = self.emulator.encode(self.start)
        if self.varied is not None:
            entries = np.array(self.varied.latent_entries)
            latent = jnp.asarray(latent, z.dtype).at[entries].set(self.varied.values(z))
        path = call_compiled(rollout_with_defects, self.emulator, latent, controls, self.defects)
        states = jnp.concatenate([self.start[None], self.emulator.decode(path[1:])])
        return Trajectory(states, controls, self.control_scale, self.emulator.dt)

    def _controls(self, z: Float[Array, " Z"]) -> Float[Array, "T C"]:
        if self.varied is not None:
            return self.varied.controls(z)
        return self.parametrisation.controls(z)

    def cost(self, z: Float[Array, " Z"]) -> Float[Array, ""]:
        """Return J."""
        return self.objective(self.trajectory(z))

    def linearised(self, z: Float[Array, " Z"]) -> Linearised:
        """Return J linearised near `z`."""
        of_states, of_controls = self.objective.apart()

        def of_motion(z: Array) -> Array:
            return of_states.residuals(self.trajectory(z))

        def of_effort(z: Array) -> Array:
            controls = self._controls(z)
            motion = Trajectory(self.start[None], controls, self.control_scale, self.emulator.dt)
            return of_controls.residuals(motion)

        def of_functions(z: Array) -> Array:
            return self.objective.extra(self.trajectory(z))

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
            extra, slope = jax.value_and_grad(of_functions)(z)
            cost += extra
        return Linearised(residuals, jacobian, slope, cost)
