"""Data, network and validation set of a training run."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.tensors import emulator_tensors
from neuroanimator.errors import ArgumentError
from neuroanimator.files.atomic import digest
from neuroanimator.learn.data.store import Dataset, Transitions
from neuroanimator.learn.training.chunk import TrainingProblem
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.learn.training.feed import Feed
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.learn.training.linear_start import with_linear_start
from neuroanimator.learn.training.pools import Pools
from neuroanimator.learn.training.survey import Survey, base_windows, sample_of
from neuroanimator.state.symmetry import Symmetry
from neuroanimator.systems.system import System

STILL = 0.01
"""Share of a usual change by which a system at rest may move in a super step and still count as staying."""


class Lesson(NamedTuple):
    """The data and validation set of a run."""

    problem: TrainingProblem
    feed: Feed
    validation: tuple[Float[Array, "N T I"], Float[Array, "N H C"]]
    """Latent states and controls of the windows of runs kept out of training."""
    measured: Transitions
    """Windows to which a trust meter is fitted, in latent numbers: those of validation. For recordings all, as these have
    too few segments to leave any out."""
    fingerprint: str
    """Hash of the data, the settings and the initial emulator of the run."""


def lesson_of(data: Dataset, config: TrainingConfig, start_from: Emulator | None) -> Lesson:
    """Return the lesson of `data`, beginning with a fresh emulator or `start_from`."""
    longest = data.system.window_steps
    if config.unroll > longest:
        raise ArgumentError(
            f"unroll: wanted at most {longest} super steps, of {data.system.name}; got {config.unroll}."
        )
    sample = sample_of(data, config)
    survey = Survey(data, config)
    if start_from is None:
        fresh = build_emulator(sample, config, survey.parts())
        base = with_linear_start(fresh, base_windows(fresh, sample))
    else:
        base = start_from
        for _ in survey.parts():
            pass
    symmetries = found_symmetries(data.read_part(0, unroll=1))
    rest = base.rest_streams() if keeps_still(data.system, base) else None
    problem = TrainingProblem(config, data.system.structure, symmetries, base, rest)
    pools = Pools(data, base, config, np.array(survey.counts))
    validation = base_windows(base, survey.validation)
    measured = validation
    if data.system.recordings is not None:
        measured = base_windows(base, data.read_part(0))
    start = digest(emulator_tensors(base))[:16]
    return Lesson(
        problem,
        Feed(problem, pools),
        (as_jax(validation.states), as_jax(validation.controls)),
        measured,
        f"{data.fingerprint[:16]}-{start}-{config.hash}-{pools.size}",
    )


def keeps_still(system: System, emulator: Emulator) -> bool:
    """Return whether the physics stays at rest without control, measured over one super step.

    Recordings and users' functions are not used: training must not depend on whether they exist or may run. A soft body's
    physics is always there.
    """
    if not system.is_self_contained and not system.structure.is_soft:
        return False
    rest = system.rest[None]
    idle = np.tile(system.bounds.idle, (1, 1, 1))
    after = system.simulate(rest, idle, emulator.dt).states[:, -1]
    before_latent = emulator.encode(np.asarray(rest, float))
    after_latent = emulator.encode(np.asarray(after, float))
    moved = np.abs(emulator.frame.difference(before_latent, after_latent)[0])
    return bool((moved <= STILL * np.asarray(emulator.normaliser.unit)).all())


def found_symmetries(data: Transitions) -> tuple[Symmetry, ...]:
    """Return the symmetries of the system, tested on some of `data`.

    As in `keeps_still`, only our own physics is used.
    """
    if not data.system.is_self_contained:
        return ()
    return data.system.symmetries(data.states[:, 0], data.controls[:, 0])
