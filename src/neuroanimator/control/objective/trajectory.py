"""What an objective looks at."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from neuroanimator.state.arrays import AnyArray


class Trajectory(NamedTuple):
    """States and the controls that led from each to the next, on emulator or physics: all arrays of JAX, or of NumPy."""

    states: Float[AnyArray, "T+1 S"]
    controls: Float[AnyArray, "T C"]
    control_scale: Float[AnyArray, " C"]
    """Magnitude of each control that counts as full effort."""
    dt: float
    """[s] From one state to the next."""

    def beside(self, numbers: Iterable[Any]) -> Trajectory:
        """Return it in arrays of JAX if any of its own, or any of `numbers`, is one."""
        arrays = (self.states, self.controls, self.control_scale)
        if not any(isinstance(array, jax.Array) for array in (*arrays, *numbers)):
            return self
        states, controls, control_scale = map(jnp.asarray, arrays)
        return Trajectory(states, controls, control_scale, self.dt)
