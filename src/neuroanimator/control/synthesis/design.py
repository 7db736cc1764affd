"""Design: optimise the body and its motion together, by one gradient, and prove both on the physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from neuroanimator.control.descent.descend import descend
from neuroanimator.control.descent.options import DescentOptions
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.synthesis.attempt import CORRECTING_ITERATIONS, SearchOptions
from neuroanimator.control.synthesis.synthesise import Synthesis, check_same_system, synthesise
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.system import System

DESIGN_ITERATIONS = 40
"""Maximum number of backward sweeps: body and motion together take longer than a motion alone."""

STARTS = 16
"""Number of initial bodies: that of the start, and random ones of the family."""

PROVED = 2
"""Number of bodies that are proved on the physics, the best ones on the emulator: their gaps differ."""


@dataclass(frozen=True)
class Design:
    """A body of a family and its motion."""

    parameters: dict[str, float]
    """Values found, for `Emulator.at` and `System.at`."""
    start: np.ndarray
    """Initial state (S,) of the motion, with these parameters."""
    synthesis: Synthesis
    """Motion of that body, proved on the physics; that of the body of `start` if no other is better."""
    nominal: Synthesis
    """Best motion of the body of the given start, proved on the physics."""


def design(
    emulator: Emulator,
    system: System,
    objective: Objective,
    start: ArrayLike,
    *,
    parameters: Sequence[str],
    steps: int,
    options: DescentOptions | None = None,
) -> Design:
    """Return the body whose motion of `steps` super steps from `start` (S,) is the best by `objective`, and that motion.

    The named `parameters` are varied beside the controls, over their ranges in training; those of `start`
    are the first guess. The best few are corrected and verified on the physics with their parameters, and so is the
    motion of the body of `start`, which is kept if no other is better.

    Raises ArgumentError for names that are not parameters, and what `synthesise` raises.
    """
    check_same_system(emulator, system)
    if not parameters:
        raise ArgumentError(
            "parameters: wanted at least one name. Without any, synthesise finds the motion alone."
        )
    options = options or DescentOptions(iterations=DESIGN_ITERATIONS)
    state = emulator.state.check(start, "state")

    def proved(begin: np.ndarray, descent: DescentOptions) -> Synthesis:
        search = SearchOptions(descent)
        return synthesise(emulator, system, objective, begin, steps=steps, options=search)

    nominal = proved(state, options)
    # Start from the best motion of the first body, with its parameters and random ones: from idle controls,
    # parameters would run to the ends of their ranges before there is a motion.
    guesses = np.stack([nominal.controls] * STARTS)
    searched = replace(
        options, first=guesses, starts=STARTS, finalists=PROVED, varied=tuple(parameters)
    )
    found = descend(emulator, objective, state, steps=steps, options=searched)
    best = nominal
    begin = state
    starts, is_closed = system.closed(found.candidate_starts)
    for start_found, controls in zip(starts[is_closed], found.candidates[is_closed], strict=True):
        # No more sweeps than after a correction: these would follow the emulator's errors.
        again = replace(options, first=controls, starts=1, iterations=CORRECTING_ITERATIONS)
        other = proved(start_found, again)
        if other.outcome.cost_physics < best.outcome.cost_physics:
            best = other
            begin = start_found
    names = [parameter.name for parameter in emulator.parameters]
    entries = [emulator.parameter_entries[names.index(name)] for name in parameters]
    values = {name: float(begin[entry]) for name, entry in zip(parameters, entries, strict=True)}
    return Design(values, begin, best, nominal)
