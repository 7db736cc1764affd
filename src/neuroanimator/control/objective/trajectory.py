"""What an objective looks at."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Array, Float


class Trajectory(NamedTuple):
    """States and the controls that led from each to the next, on emulator or physics."""

    states: Float[Array, "T+1 S"]
    controls: Float[Array, "T C"]
    control_scale: Float[Array, " C"]
    """Magnitude of each control that counts as full effort."""
    dt: float
    """[s] From one state to the next."""
