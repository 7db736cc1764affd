"""What an emulator was trained on, as much of it as keeps what it knows."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from neuroanimator.data.config import RUNS_PER_SHARD
from neuroanimator.data.store import Transitions, join_transitions, read_config
from neuroanimator.data.stored import open_transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.improvement.config import ImprovementConfig
from neuroanimator.storage.places import place_of


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
    data = open_transitions(place, memory=0)
    of_each = RUNS_PER_SHARD * dataset.samples_per_run
    wanted = -(-config.windows // of_each)
    return join_transitions(list(islice(data.parts(), wanted)))
