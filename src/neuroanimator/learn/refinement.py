"""Refine the emulator of a search: train it on the physics around a motion, as long as the physics disagrees with it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from neuroanimator.control.synthesis.attempt import Attempt, Search, SearchCost, make_attempt
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.store import Transitions
from neuroanimator.terminal import phase

REFINING_MINUTES = 0.5
"""Default maximum time of all refinements together [min]."""


@dataclass(frozen=True)
class Refinement:
    """How an emulator learns the physics around a motion: the `refine` of `SearchOptions` where none is given.

    Transitions around the motion are added to the training data, a copy of the emulator is trained further, and the search
    restarts, if their data and trainings take no longer than `minutes` in all. Raises ArgumentError for a negative time.
    """

    minutes: float = REFINING_MINUTES
    """Maximum time of all refinements of a search together [min]; 0 for none."""
    data: Transitions | None = None
    """The emulator's training data; simulated anew if not given."""
    on_refine: Callable[[float], None] = lambda gap: None
    """Called with the gap before each refinement."""

    def __post_init__(self) -> None:
        if not self.minutes >= 0:
            raise ArgumentError(f"minutes: wanted 0 or more, got {self.minutes:g}.")

    def __call__(self, search: Search, attempt: Attempt) -> Attempt:
        """Return the best of `attempt` and others with emulators trained on the physics around it, with the cost of all."""
        if not self.minutes:
            return attempt
        seconds_left = 60 * self.minutes
        data = self.data
        best = attempt
        latest = attempt
        spent = attempt.spent
        for number in range(1, search.options.refinements + 1):
            if not latest.has_large_gap or search.options.is_enough(best.outcome.physics_states):
                break
            self.on_refine(latest.outcome.gap)
            with phase("training on the physics around the motion"):
                # Imports training, which most motions do not need.
                from neuroanimator.learn.finetune import Deadline, OutOfTimeError, refined

                began = time.monotonic()
                try:
                    emulator, data, physics_steps = refined(
                        latest.emulator,
                        search.system,
                        data,
                        latest.outcome.physics_states,
                        latest.controls,
                        number,
                        Deadline(seconds_left),
                    )
                except OutOfTimeError as late:
                    minutes = self.minutes + (late.seconds - seconds_left) / 60
                    spent = spent + SearchCost(minutes_wanted=minutes)
                    break
                seconds_left -= time.monotonic() - began
            options = replace(search.options.descent, first=latest.controls)
            latest = make_attempt(search, emulator, options)
            spent = spent + latest.spent + SearchCost(refinements=1, physics_steps=physics_steps)
            best = search.better(best, latest)
        return replace(best, spent=spent)
