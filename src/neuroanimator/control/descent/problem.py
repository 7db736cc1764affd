"""J as a function of the numbers a descent varies."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.control.descent.defects import advance_corrected, follow_corrected
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.emulator.compiled import call_compiled
from neuroanimator.emulator.emulator import Emulator

BACKWARD = 3
"""Forward sweeps that cost as much as one backward."""


class Linearised(NamedTuple):
    """J near some z: the sum of squares of residuals that change in proportion, over two, and of the rest."""

    residuals: Float[Array, " R"]
    jacobian: Float[Array, "R Z"]
    """How they change with z."""
    slope: Float[Array, " Z"]
    """Of what is no square."""
    cost: Float[Array, ""]
    """J at z."""


class Problem(eqx.Module):
    """z (Z,) → controls → emulated trajectory → J. For use inside jit, grad and vmap."""

    emulator: Emulator
    objective: Objective
    parametrisation: Parametrisation
    start: Float[Array, " S"]
    defects: Float[Array, "T V"]
    """Added to the super steps: see `corrected`."""
    control_scale: Float[Array, " C"]

    def trajectory(self, z: Float[Array, " Z"]) -> Trajectory:
        """Return the emulated motion under the controls of z."""
        controls = self.parametrisation.controls(z)
        return self._trajectory(self._follow(controls), controls)

    def cost(self, z: Float[Array, " Z"]) -> Float[Array, ""]:
        """Return J."""
        return self.objective(self.trajectory(z))

    def linearised(self, z: Float[Array, " Z"]) -> Linearised:
        """Return J and how it changes near `z`."""
        of_states, of_controls = self.objective.apart()
        look = self._look_back if self._is_seen_in_few(of_states, z) else self._look_ahead
        rows = [look(of_states, z), self._look_at_controls(of_controls, z)]
        residuals, jacobian = (jnp.concatenate(parts) for parts in zip(*rows, strict=True))
        cost, slope = jnp.sum(residuals**2) / 2, jnp.zeros_like(z)
        if self.objective.functions:
            extra, slope = jax.value_and_grad(lambda z: self.objective.extra(self.trajectory(z)))(z)
            cost += extra
        return Linearised(residuals, jacobian, slope, cost)

    def _is_seen_in_few(self, of_states: Objective, z: Float[Array, " Z"]) -> bool:
        """Return whether states are looked at in so few numbers that pulling these back is the least work."""
        motion = jax.ShapeDtypeStruct((self.parametrisation.steps + 1, len(self.start)), z.dtype)
        held = jax.ShapeDtypeStruct((self.parametrisation.steps, len(self.control_scale)), z.dtype)

        def seen(states, controls):
            return of_states.residuals(
                Trajectory(states, controls, self.control_scale, self.emulator.dt)
            )

        count = jax.eval_shape(seen, motion, held).shape[0]
        return BACKWARD * count < min(len(z), self._entries)

    def _look_back(self, of_states: Objective, z: Float[Array, " Z"]) -> tuple[Array, Array]:
        """Return residuals (R,) and how they change with z (R, Z), by a backward sweep for all of them."""
        residuals, back = jax.vjp(lambda z: of_states.residuals(self.trajectory(z)), z)
        return residuals, jax.vmap(back)(jnp.eye(len(residuals), dtype=z.dtype))[0]

    def _look_ahead(self, of_states: Objective, z: Float[Array, " Z"]) -> tuple[Array, Array]:
        """Return the same by forward sweeps."""
        change = (
            self._changes_at_once if len(z) <= 2 * self._entries else self._changes_step_by_step
        )
        latent, controls, push = change(z)

        def looked_at(latent, controls):
            return of_states.residuals(self._trajectory(latent, controls))

        residuals, pull = jax.linearize(looked_at, latent, controls)
        return residuals, jax.vmap(lambda unit: pull(*push(unit)), out_axes=1)(
            jnp.eye(len(z), dtype=z.dtype)
        )

    def _look_at_controls(
        self, of_controls: Objective, z: Float[Array, " Z"]
    ) -> tuple[Array, Array]:
        """Return the same for what does not look at states."""

        def look(z: Array) -> Array:
            return of_controls.residuals(
                Trajectory(
                    self.start[None],
                    self.parametrisation.controls(z),
                    self.control_scale,
                    self.emulator.dt,
                )
            )

        return look(z), jax.jacfwd(look)(z)

    @property
    def _entries(self) -> int:
        """How many numbers a super step depends on: single ones are cheaper to differentiate where z has far more."""
        return self.emulator.normaliser.change_scale.shape[0] + len(self.control_scale)

    def _changes_at_once(self, z: Array) -> tuple[Array, Array, Callable]:
        """Return the inner trajectory, the controls, and how both change with z."""

        def path(z: Array) -> tuple[Array, Array]:
            controls = self.parametrisation.controls(z)
            return self._follow(controls), controls

        (latent, controls), push = jax.linearize(path, z)
        return latent, controls, push

    def _changes_step_by_step(self, z: Array) -> tuple[Array, Array, Callable]:
        """Return the same by the chain rule: the Jacobians of all super steps side by side, then their products."""
        controls, pushed = jax.linearize(self.parametrisation.controls, z)
        latent = self._follow(controls)
        mixed = self.emulator.encode_control(controls)
        by_state, by_control = jax.vmap(
            jax.jacfwd(lambda s, u, d: advance_corrected(self.emulator, s, u, d), (0, 1))
        )(latent[:-1], mixed, self.defects)

        def push(unit: Array) -> tuple[Array, Array]:
            change = pushed(unit)

            def one(before: Array, given: tuple[Array, Array, Array]) -> tuple[Array, Array]:
                along, by, moved = given
                after = along @ before + by @ moved
                return after, after

            inputs = by_state, by_control, self.emulator.encode_control(change)
            first = jnp.zeros_like(latent[0])
            return jnp.concatenate([first[None], jax.lax.scan(one, first, inputs)[1]]), change

        return latent, controls, push

    def _follow(self, controls: Float[Array, "T C"]) -> Float[Array, "T+1 I"]:
        # Traced once, however often a program follows the emulator.
        return call_compiled(
            follow_corrected,
            self.emulator,
            self.emulator.encode(self.start),
            controls,
            self.defects,
        )

    def _trajectory(
        self, latent: Float[Array, "T+1 I"], controls: Float[Array, "T C"]
    ) -> Trajectory:
        states = jnp.concatenate([self.start[None], self.emulator.decode(latent[1:])])
        return Trajectory(states, controls, self.control_scale, self.emulator.dt)
