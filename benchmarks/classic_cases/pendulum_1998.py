"""The network of 1998 on the pendulum, as several cases look at it: trained once in a process."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import neuroanimator as na
from classic_cases.lessons import (
    FEATURES,
    Lesson,
    NetworkOf,
    random_batches,
    train_side_by_side,
)
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks.network import Network
from neuroanimator.training.optimizer import make_optimizer

UNITS = 35
"""Number of hidden units: the middle of the seminar's 20 to 50."""

COUNT = 60_000
"""Number of transitions that are learnt from."""

QUICK_COUNT = 3_600
"""The same where it must be quick."""

UPDATES = 6_000
"""Number of updates of a training."""

QUICK_UPDATES = 250
"""The same where it must be quick."""

BATCH = 256
"""Number of transitions in a batch."""

SEEDS = 3
"""Number of trainings for each super step."""


class Taught(NamedTuple):
    """A lesson and the networks trained on it, one for each seed."""

    lesson: Lesson
    networks: list[Network]

    @property
    def emulators(self) -> list[Emulator]:
        """The emulators of these networks."""
        return [self.lesson.emulator(network) for network in self.networks]


@lru_cache
def pendulum_lesson(substeps: int, is_quick: bool) -> Lesson:
    """Return the lesson of super steps of so many physics steps."""
    return Lesson.of("pendulum", substeps, QUICK_COUNT if is_quick else COUNT, FEATURES)


@lru_cache
def classic_networks(substeps: int, is_quick: bool) -> Taught:
    """Return networks of 1998 for super steps of so many physics steps."""
    lesson = pendulum_lesson(substeps, is_quick)
    settings = na.TrainingConfig(network="classic", widths=(UNITS,), updates=UPDATES)
    network_of = lesson.network("classic", (UNITS,))
    return taught(lesson, network_of, settings, is_quick, SEEDS)


def taught(
    lesson: Lesson, network_of: NetworkOf, settings: na.TrainingConfig, is_quick: bool, seeds: int
) -> Taught:
    """Return what training by the package's usual optimiser makes of fresh networks."""
    (networks,) = train_side_by_side(
        lesson,
        network_of,
        make_optimizer(settings),
        random_batches(BATCH, lesson.size),
        (QUICK_UPDATES if is_quick else settings.updates,),
        1 if is_quick else seeds,
    )
    return Taught(lesson, networks)
