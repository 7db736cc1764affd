"""Starts of emulators whose system ties its parts together: by its model, where that is at hand."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.errors import BadFileError
from neuroanimator.systems import carried_system
from neuroanimator.systems.system import System

SYSTEMS_KEPT = 4
"""Number of systems kept, as each reset of an environment needs one."""


def tied_system(spec: EmulatorSpec) -> System | None:
    """Return the system of an emulator, if it ties its parts together; None if it does not, or if its model is missing."""
    if not spec.is_tied:
        return None
    try:
        return _carried(spec.system, spec.definition)
    except (BadFileError, ImportError):
        return None


def closed_starts(spec: EmulatorSpec, states: Float[np.ndarray, "N S"]) -> Float[np.ndarray, "N S"]:
    """Return `states` with parts that are tied together meeting; rest for those that cannot, and where the model is missing."""
    if not spec.is_tied:
        return states
    rest = np.tile(spec.rest, (len(states), 1))
    system = tied_system(spec)
    if system is None:
        return rest
    closed, is_closed = system.closed(np.asarray(states, float))
    return np.where(is_closed[:, None], closed, rest)


@lru_cache(SYSTEMS_KEPT)
def _carried(name: str, definition: str) -> System:
    """Return the system; a missing one is looked for again the next time."""
    return carried_system(name, definition)
