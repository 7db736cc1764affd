"""Symmetries, which make of every motion another true one: a mirror, or like limbs that change places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from neuroanimator.state.arrays import AnyArray


@dataclass(frozen=True)
class Symmetry:
    """State entries and controls change places, some of them reversed; the motion that follows does the same."""

    entries: tuple[int, ...]
    """(S,) which entry of the state comes to stand at each."""
    entry_signs: tuple[int, ...]
    """(S,) 1, or -1 where it is reversed."""
    controls: tuple[int, ...]
    """(C,) which control comes to stand at each."""
    control_signs: tuple[int, ...]
    """(C,) 1, or -1 where it is reversed."""

    @property
    def is_identity(self) -> bool:
        """Whether it leaves everything where it is."""
        stays = self.entries == tuple(range(len(self.entries)))
        return stays and all(sign == 1 for sign in (*self.entry_signs, *self.control_signs))

    def state(self, states: Float[AnyArray, "... S"]) -> Float[AnyArray, "... S"]:
        """Return what becomes of `states`."""
        return states[..., np.array(self.entries)] * np.array(self.entry_signs, states.dtype)

    def control(self, controls: Float[AnyArray, "... C"]) -> Float[AnyArray, "... C"]:
        """Return what becomes of `controls`."""
        return controls[..., np.array(self.controls)] * np.array(self.control_signs, controls.dtype)
