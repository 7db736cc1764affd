"""What a training run learns, and by what it is judged: from a dataset in memory, or from one that stays on disk."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from neuroanimator.data.store import Transitions
from neuroanimator.data.stored import StoredTransitions
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.tensors import emulator_tensors
from neuroanimator.errors import ArgumentError
from neuroanimator.state.symmetry import Symmetry
from neuroanimator.storage.files import digest
from neuroanimator.systems.system import System
from neuroanimator.training.batches import RARE, rare_rows, unusualness
from neuroanimator.training.chunk import TrainingProblem, WindowsInMemory
from neuroanimator.training.config import TrainingConfig
from neuroanimator.training.feed import Feed, MemoryFeed, StreamFeed
from neuroanimator.training.initialise import build_emulator
from neuroanimator.training.survey import Survey, sample_of, validation_of
from neuroanimator.training.window_stream import WindowStream

STILL = 0.01
"""Share of a usual change by which a system at rest may move in a super step and still count as keeping still."""


class Lesson(NamedTuple):
    """What a run needs besides a network."""

    problem: TrainingProblem
    feed: Feed
    validation: Transitions
    """Windows of runs that are not learnt from, in latent numbers."""
    measured: Transitions
    """Windows that a meter of trust is fitted to, in latent numbers: the validation's. Of recordings all, for they have too few
    segments to leave any out."""
    fingerprint: str
    """Names the data, the settings and the emulator the run begins with."""


def lesson_of(
    data: Transitions | StoredTransitions, config: TrainingConfig, start_from: Emulator | None
) -> Lesson:
    """Return what is learnt from `data`, beginning with a fresh emulator or `start_from`."""
    if isinstance(data, StoredTransitions):
        return _from_disk(data, config, start_from)
    return _from_memory(data, config, start_from)


def _from_memory(data: Transitions, config: TrainingConfig, start_from: Emulator | None) -> Lesson:
    is_held_out = validation_mask(data.run, config)
    if not is_held_out.any() or is_held_out.all():
        raise ArgumentError(_too_few(data))
    base = start_from or build_emulator(data.where(~is_held_out), config)
    training = base_windows(base, data.where(~is_held_out))
    problem = _problem(data.system, config, base, found_symmetries(data))
    windows = WindowsInMemory(
        states=as_jax(training.states),
        controls=as_jax(training.controls),
        rare=as_jax(rare_rows(base, training), np.int32),
    )
    validation = base_windows(base, data.where(is_held_out))
    measured = validation
    if data.system.recordings is not None:
        measured = base_windows(base, data)
    contents = {"states": data.states, "controls": data.controls, **emulator_tensors(base)}
    return Lesson(
        problem,
        MemoryFeed(problem, windows),
        validation,
        measured,
        f"{digest(contents)[:16]}-{config.hash}",
    )


def _from_disk(
    data: StoredTransitions, config: TrainingConfig, start_from: Emulator | None
) -> Lesson:
    sample = sample_of(data, config)
    survey = Survey(data, config)
    if start_from is None:
        base = build_emulator(sample, config, survey.parts())
    else:
        base = start_from
        for _ in survey.parts():
            pass
    problem = _problem(data.system, config, base, found_symmetries(sample))
    stream = WindowStream(
        data,
        base,
        config,
        sha256=tuple(survey.sha256),
        counts=np.array(survey.counts),
        rare_from=_rare_from(base, sample),
    )
    shards = hashlib.sha256("".join(survey.sha256).encode()).hexdigest()[:16]
    start = digest(emulator_tensors(base))[:16]
    validation = base_windows(base, validation_of(data, config))
    return Lesson(
        problem,
        StreamFeed(problem, stream),
        validation,
        validation,
        f"{shards}-{start}-{config.hash}-{config.memory}",
    )


def _problem(
    system: System, config: TrainingConfig, base: Emulator, symmetries: tuple[Symmetry, ...]
) -> TrainingProblem:
    rest = None
    if keeps_still(system, base):
        rest = base.rest_streams()
    return TrainingProblem(config, system.structure, symmetries, base, rest)


def _rare_from(base: Emulator, sample: Transitions) -> float:
    """Return how unusual the change of a window must be to be rare, as a tenth of the `sample` is."""
    windows = base_windows(base, sample)
    unusual = unusualness(base, windows.states[:, 0], windows.states[:, 1])
    return float(np.quantile(unusual, 1 - RARE))


def _too_few(data: Transitions) -> str:
    """Return what is said of data that cannot be parted into some to learn from and some to validate by."""
    lost = ""
    if data.diverged:
        lost = f" {data.diverged} runs diverged and were dropped: use a smaller step."
    return f"count: {len(data.run)} transitions are too few to train on; wanted some hundred.{lost}"


def keeps_still(system: System, emulator: Emulator) -> bool:
    """Return whether the physics stays where it is at rest without control, measured over one super step.

    Of recordings and functions of a user's nobody asks: they may be there, or be allowed to run, or not, and what is
    trained must not depend on that.
    """
    if not system.is_self_contained:
        return False
    rest = system.rest[None]
    idle = np.tile(system.bounds.idle, (1, 1, 1))
    after = system.simulate(rest, idle, emulator.dt).states[:, -1]
    before_latent = emulator.encode(np.asarray(rest, float))
    after_latent = emulator.encode(np.asarray(after, float))
    moved = np.abs(emulator.frame.difference(before_latent, after_latent)[0])
    return bool((moved <= STILL * np.asarray(emulator.normaliser.unit)).all())


def found_symmetries(data: Transitions) -> tuple[Symmetry, ...]:
    """Return the symmetries of the system, tried on some of `data`.

    As with `keeps_still`, only physics of our own is asked.
    """
    if not data.system.is_self_contained:
        return ()
    return data.system.symmetries(data.states[:, 0], data.controls[:, 0])


def base_windows(base: Emulator, data: Transitions) -> Transitions:
    """Return the windows in the latent numbers in which `base` makes its super steps."""
    states = base.encoding.encode_recorded(data.states)
    controls = base.encode_control(data.controls).astype(np.float32, copy=False)
    return replace(data, states=states, controls=controls)


def validation_mask(run: Int[np.ndarray, " N"], config: TrainingConfig) -> Bool[np.ndarray, " N"]:
    """Return (N,) True for windows whose whole run is kept for validation."""
    runs = np.unique(run)
    count = max(1, round(len(runs) * config.validation_share))
    chosen = np.random.default_rng([config.seed, 1]).permutation(runs)[:count]
    return np.isin(run, chosen)
