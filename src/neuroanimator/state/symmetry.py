"""Symmetries, which turn every motion into another true one: a mirror, or equal limbs that swap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from neuroanimator.state.arrays import AnyArray


@dataclass(frozen=True)
class Symmetry:
    """A permutation of state entries and controls, some reversed, under which motions stay true."""

    entries: tuple[int, ...]
    """State entry (S,) moved to each."""
    entry_signs: tuple[int, ...]
    """Sign of each entry (S,): 1, or -1 if reversed."""
    controls: tuple[int, ...]
    """Control (C,) moved to each."""
    control_signs: tuple[int, ...]
    """Sign of each control (C,): 1, or -1 if reversed."""

    @property
    def is_identity(self) -> bool:
        """Whether it changes nothing."""
        stays = self.entries == tuple(range(len(self.entries)))
        return stays and all(sign == 1 for sign in (*self.entry_signs, *self.control_signs))

    def state(self, states: Float[AnyArray, "... S"]) -> Float[AnyArray, "... S"]:
        """Return `states` mirrored or permuted."""
        return states[..., np.array(self.entries)] * np.array(self.entry_signs, states.dtype)

    def control(self, controls: Float[AnyArray, "... C"]) -> Float[AnyArray, "... C"]:
        """Return `controls` mirrored or permuted."""
        return controls[..., np.array(self.controls)] * np.array(self.control_signs, controls.dtype)
