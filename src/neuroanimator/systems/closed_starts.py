"""Starts of emulators whose system ties its parts together: by its physics, where that is at hand."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.systems.system import System


def closed_starts(
    spec: EmulatorSpec, states: Float[np.ndarray, "N S"], system: System | None
) -> Float[np.ndarray, "N S"]:
    """Return `states` with parts that are tied together meeting; rest for those that cannot, and without the `system`."""
    if not spec.is_tied:
        return states
    rest = np.tile(spec.rest, (len(states), 1))
    if system is None:
        return rest
    closed, is_closed = system.closed(np.asarray(states, float))
    return np.where(is_closed[:, None], closed, rest)
