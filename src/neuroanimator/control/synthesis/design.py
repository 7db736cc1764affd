"""Design: the body and its motion together, by one gradient, and both proved on the physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from neuroanimator.control.descent.descend import descend
from neuroanimator.control.descent.options import DescentOptions
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.synthesis.synthesise import Synthesis, check_same_system, synthesise
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.system import System

DESIGN_ITERATIONS = 60
"""Maximum number of backward sweeps: body and motion have to find together, which takes longer than a motion alone."""

STARTS = 16
"""Number of bodies to begin with: that of the start, and random ones of the family."""

PROVED = 2
"""Number of bodies that are proved on the physics, the best ones on the emulator: gaps differ from one to the next."""


@dataclass(frozen=True)
class Design:
    """A body of a family and its motion."""

    parameters: dict[str, float]
    """The values that were found, as `Emulator.at` and `System.at` take them."""
    start: np.ndarray
    """(S,) where the motion begins, with these parameters."""
    synthesis: Synthesis
    """The motion of that body, proved on the physics; that of the first body where none is better."""
    nominal: Synthesis
    """The best motion of the body that `start` was of, likewise."""


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

    The named `parameters` are varied beside the controls, over the ranges the emulator was trained on; those of `start`
    are the first guess. The best few are corrected and proved on the physics with their parameters, and so is the
    motion of the body `start` is of, which is kept where no other is better.

    Raises ArgumentError for names that are no parameters, and what `synthesise` raises.
    """
    check_same_system(emulator, system)
    if not parameters:
        raise ArgumentError(
            "parameters: wanted at least one name. Without any, synthesise finds the motion alone."
        )
    options = options or DescentOptions(iterations=DESIGN_ITERATIONS)
    state = emulator.state.check(start, "state")

    def proved(begin: np.ndarray, motion: DescentOptions) -> Synthesis:
        return synthesise(
            emulator,
            system,
            objective,
            begin,
            steps=steps,
            options=motion,
            refinements=0,
        )

    nominal = proved(state, options)
    # From the best motion of the first body, with the parameters of that body and of random ones: from idle controls
    # parameters run to the ends of their ranges before there is a motion.
    guesses = np.stack([nominal.controls] * STARTS)
    searched = replace(
        options, first=guesses, starts=STARTS, finalists=PROVED, varied=tuple(parameters)
    )
    found = descend(emulator, objective, state, steps=steps, options=searched)
    best = nominal
    begin = state
    for start_found, controls in zip(found.candidate_starts, found.candidates, strict=True):
        other = proved(start_found, replace(options, first=controls, starts=1))
        if other.outcome.cost_physics < best.outcome.cost_physics:
            best = other
            begin = start_found
    names = [parameter.name for parameter in emulator.parameters]
    entries = [emulator.parameter_entries[names.index(name)] for name in parameters]
    values = {name: float(begin[entry]) for name, entry in zip(parameters, entries, strict=True)}
    return Design(values, begin, best, nominal)
