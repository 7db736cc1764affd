"""What an emulator was trained on, as much of it as keeps what it knows."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.data.config import RUNS_PER_SHARD
from neuroanimator.data.store import (
    Transitions,
    gather_transitions,
    read_config,
    read_shard,
    read_transitions,
)
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.improvement.config import ImprovementConfig
from neuroanimator.storage.places import place_of
from neuroanimator.systems import carried_system


def read_old(folder: str | Path, emulator: Emulator, config: ImprovementConfig) -> Transitions:
    """Return the first shards of the dataset in `folder`, as many as a round learns from; of recordings all.

    Raises BadFileError as `read_transitions` does, ArgumentError for a dataset of another system or super step.
    """
    place = place_of(folder)
    dataset = read_config(place)
    if (dataset.system, dataset.substeps) != (emulator.system, emulator.substeps):
        raise ArgumentError(
            f"data: {folder} is of {dataset.system}, {dataset.substeps} substeps; wanted {emulator.system}, "
            f"{emulator.substeps}. Give the emulator's own dataset, or none."
        )
    system = carried_system(dataset.system, dataset.definition)
    if system.recordings is not None:
        return read_transitions(place)
    of_each = RUNS_PER_SHARD * dataset.samples_per_run
    wanted = min(dataset.shards, -(-config.windows // of_each))
    shards = (read_shard(place, dataset, system, shard) for shard in range(wanted))
    counted = ((tensors, metadata["diverged"]) for tensors, metadata in shards)
    return gather_transitions(dataset, system, counted)
