"""One streaming pass over a dataset before training: statistics and validation samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Int

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.store import Dataset, Transitions, join_transitions
from neuroanimator.learn.data.stored import memory_taken
from neuroanimator.learn.training.config import TrainingConfig

MAX_SAMPLED_PARTS = 64
"""Maximum number of parts from which shape modes are computed."""

MAX_VALIDATION = 8192
"""Maximum number of windows for validation: more would slow training without changing a relevant digit."""


def validation_mask(
    run: Int[np.ndarray, " N"], config: TrainingConfig, part: int = 0
) -> Bool[np.ndarray, " N"]:
    """Return whether each window (N,) of part number `part` of a dataset belongs to a run kept for validation."""
    runs = np.unique(run)
    count = max(1, round(len(runs) * config.validation_share))
    chosen = np.random.default_rng([config.seed, 1, part]).permutation(runs)[:count]
    return np.isin(run, chosen)


def training_windows(data: Dataset, number: int, config: TrainingConfig) -> Transitions:
    """Return the training windows of part `number`."""
    part = data.read_part(number)
    return part.where(~validation_mask(part.run, config, number))


def base_windows(base: Emulator, data: Transitions) -> Transitions:
    """Return the windows in the latent numbers of `base`."""
    states = base.encoding.encode_recorded(data.states)
    controls = base.encode_control(data.controls).astype(np.float32, copy=False)
    return replace(data, states=states, controls=controls)


def sample_of(data: Dataset, config: TrainingConfig) -> Transitions:
    """Return training windows from all over the dataset, as far as memory allows; ArgumentError for none."""
    share = config.memory / memory_taken(data.config, data.system)
    count = min(data.part_count, max(1, int(share * data.part_count)), MAX_SAMPLED_PARTS)
    numbers = np.unique(np.linspace(0, data.part_count - 1, count).astype(int))
    training = []
    for number in numbers:
        training.append(training_windows(data, int(number), config))
    sample = join_transitions(training)
    if not len(sample.states):
        taken = sum(len(data.read_part(int(number)).states) for number in numbers)
        lost = ""
        if sample.diverged:
            lost = f" {sample.diverged} runs diverged and were dropped: use a smaller step."
        raise ArgumentError(
            f"count: {taken} transitions are too few to train on; wanted a few hundred.{lost}"
        )
    return sample


@dataclass
class Survey:
    """One pass over all windows; its results are complete at its end."""

    data: Dataset
    config: TrainingConfig
    counts: list[int] = field(default_factory=list)
    """Number of training windows in each part read so far."""
    held_out: list[Transitions] = field(default_factory=list)
    """Validation windows of each part, at most its share of `MAX_VALIDATION`."""

    def parts(self) -> Iterator[Transitions]:
        """Yield the training windows of each part that has any."""
        share = -(-MAX_VALIDATION // self.data.part_count)
        for number, part in enumerate(self.data.parts()):
            is_held_out = validation_mask(part.run, self.config, number)
            self.held_out.append(part.where(np.flatnonzero(is_held_out)[:share]))
            training = part.where(~is_held_out)
            self.counts.append(len(training.states))
            if len(training.states):
                yield training

    @property
    def validation(self) -> Transitions:
        """At most `MAX_VALIDATION` windows, evenly from the whole dataset."""
        windows = join_transitions(self.held_out)
        rows = np.linspace(0, len(windows.states) - 1, MAX_VALIDATION).astype(int)
        return windows.where(np.unique(rows))
