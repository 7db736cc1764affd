"""The store of transitions: a folder of shards, and how it is read.

A shard holds whole runs and, for each, the super steps sampled as training examples, Δt to 5Δt
apart (the seminar paper's eq. 8). Storing whole runs lets training unroll from a sampled step.
"""

from __future__ import annotations

import abc
import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import ValidationError

from neuroanimator.definitions.carried import remember_folder
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import (
    HEADER_LIMIT,
    SIZE_LIMIT,
    Metadata,
    Tensors,
    canonical_json,
    digest,
    one_line,
    read_bounded,
    read_tensors,
    write_first,
    write_whole,
)
from neuroanimator.files.json_text import parse_json_object
from neuroanimator.files.places import Place, place_of
from neuroanimator.files.tables import first_fault
from neuroanimator.learn.data.config import MAX_UNROLL, RUN_STEPS, RUNS_PER_SHARD, DatasetConfig
from neuroanimator.learn.data.shard_checks import (
    TensorSpec,
    check_range,
    check_tensors,
    largest_size,
    refuse,
    whole_number,
)
from neuroanimator.physics import carried_system
from neuroanimator.systems.model_files import ModelFiles
from neuroanimator.systems.model_xml import MAX_TOTAL
from neuroanimator.systems.named_files import named_model, named_shapes, names_model
from neuroanimator.systems.system import System
from neuroanimator.systems.trusted_files import know_model
from neuroanimator.text import quoted

CONFIG_NAME = "dataset.json"
"""Name of the file with a dataset's configuration."""

FORMAT = 2
"""Version of the folder's format, raised whenever names or meanings of keys or tensors change."""

MAX_CONFIG = 2 * 2**20
"""Maximum size of a configuration [bytes]: a definition, escaped twice, and a few numbers."""

MAX_SHOWN = 60
"""Maximum length of a setting shown in an error [characters]: a definition has thousands."""

MAX_HELD_OUT = 512 * 2**20
"""Maximum size of a file of held-out runs [bytes]: no larger than the recordings they come from."""

MODEL_NAME = "model.json"
"""Name of the file with the model of a user's own system, so that a dataset can be trained on anywhere."""

MAX_MODEL = MAX_TOTAL // 3 * 4 + 2**20
"""Maximum size of that file [bytes]: the model's files in base64, and their names."""

HELD_OUT_NAME = "held-out.safetensors"
"""Name of the file with the recorded runs kept for the test; simulated systems simulate their tests anew."""


def claim_folder(folder: Place, config: DatasetConfig) -> None:
    """Mark `folder` as the dataset of `config`; refuse a folder that holds another one.

    A dataset that differs in goals alone is the same one, and takes on the goals of `config`.
    """
    path = folder / CONFIG_NAME
    present = read_config(folder) if path.exists() else None
    if present == config:
        return
    if present is not None and present.hash != config.hash:
        raise BadFileError(
            f"{folder} holds another dataset ({_differences(present, config)}). "
            "Choose another --out, or the same values."
        )
    _keep_model(folder, config)
    text = json.dumps({"format": FORMAT} | config.model_dump(), indent=2)
    content = f"{text}\n".encode()
    if present is not None:
        write_whole(path, content)
    elif not write_first(path, content):
        claim_folder(folder, config)


def _keep_model(folder: Place, config: DatasetConfig) -> None:
    """Write the model of a user's own system, or the shapes of a soft body, into `folder`."""
    shapes = named_shapes(config.definition)
    if shapes is not None:
        write_first(folder / shapes.name, read_bounded(shapes, SIZE_LIMIT))
    files = named_model(config.definition)
    if files is not None:
        write_first(folder / MODEL_NAME, canonical_json(files.to_json()).encode())


def _use_model(folder: Place, config: DatasetConfig) -> None:
    """Register the model, or the shapes, of a dataset with this process; digests prove that they are the right ones."""
    if isinstance(folder, Path) and config.definition:
        remember_folder(config.definition, folder)
    path = folder / MODEL_NAME
    if not names_model(config.definition) or not path.exists():
        return
    content = read_bounded(path, MAX_MODEL)
    try:
        files = ModelFiles.from_json(parse_json_object(content, MAX_MODEL))
    except ValueError as error:
        raise _damaged(path, one_line(error)) from error
    know_model(config.system, files)


def _damaged(path: Place, fault: str) -> BadFileError:
    return BadFileError(f"{path} is damaged: {fault}. Generate the dataset again.")


def _differences(present: DatasetConfig, wanted: DatasetConfig) -> str:
    """Return the settings that differ, such as `seed 0 there, 1 asked`."""
    old = present.model_dump()
    new = wanted.model_dump()
    changed = [key for key in new if old[key] != new[key]]
    return ", ".join(f"{key} {_short(old[key])} there, {_short(new[key])} asked" for key in changed)


def _short(value: object) -> object:
    return "another" if len(str(value)) > MAX_SHOWN else value


def read_config(folder: Place) -> DatasetConfig:
    """Return the configuration of the dataset in `folder`; BadFileError if it is no dataset, damaged or of another format."""
    path = folder / CONFIG_NAME
    if not path.exists():
        raise BadFileError(
            f"{folder} is not a dataset: no {CONFIG_NAME}. Make one with 'generate'."
        )
    content = read_bounded(path, MAX_CONFIG)
    try:
        values = parse_json_object(content, MAX_CONFIG)
    except ValueError as error:
        raise _damaged(path, one_line(error)) from error
    _check_format(path, values.pop("format", None))
    try:
        config = DatasetConfig.of_file(values)
    except ValidationError as error:
        raise _damaged(path, first_fault(error)) from error
    _use_model(folder, config)
    return config


def _check_format(path: Place, format_number: object) -> None:
    if type(format_number) is not int or format_number != FORMAT:
        stated = "no format" if format_number is None else f"format {quoted(format_number)}"
        raise BadFileError(
            f"{path} is of another version: {stated}; this one reads {FORMAT}. Generate the dataset again."
        )


class Dataset(abc.ABC):
    """Windows of consecutive super steps, in parts that are loaded into memory one at a time."""

    config: DatasetConfig
    system: System
    held_out: tuple[np.ndarray, np.ndarray] | None = None
    """(states (B, T+1, S), controls (B, T, C)) kept for the test; recordings only."""
    noise: Float[np.ndarray, " S"] | None = None
    """Standard deviation of the noise in each state entry; recordings only."""

    @property
    @abc.abstractmethod
    def part_count(self) -> int:
        """Number of parts."""

    @abc.abstractmethod
    def read_part(self, number: int, unroll: int | None = None) -> Transitions:
        """Return part `number`, the same at every call, in windows of `unroll` super steps, by default the longest there are.

        Raises BadFileError if the part cannot be read.
        """

    @property
    @abc.abstractmethod
    def fingerprint(self) -> str:
        """Hex digits that identify the contents, once every part has been read."""

    def parts(self, unroll: int | None = None) -> Iterator[Transitions]:
        """Yield the parts in order, in windows of `unroll` super steps; see `read_part`."""
        for number in range(self.part_count):
            yield self.read_part(number, unroll)


@final
@dataclass(frozen=True)
class Transitions(Dataset):
    """A dataset in memory, in one part: windows of consecutive super steps, one per example.

    A window spans H = `system.window_steps` super steps and holds T = H + 1 states; its first step is the training example.
    """

    config: DatasetConfig
    system: System
    states: Float[np.ndarray, "N T S"]
    controls: Float[np.ndarray, "N H C"]
    run: Int[np.ndarray, " N"]
    """Run that each window comes from; for recordings, the segment."""
    diverged: int
    held_out: tuple[np.ndarray, np.ndarray] | None = None
    noise: Float[np.ndarray, " S"] | None = None

    def __repr__(self) -> str:
        config = self.config
        return f'Transitions("{config.system}", {len(self.states):,} windows, {config.substeps} substeps)'

    @property
    def part_count(self) -> int:
        return 1

    def read_part(self, number: int, unroll: int | None = None) -> Transitions:
        if unroll is None:
            return self
        states = self.states[:, : unroll + 1]
        return replace(self, states=states, controls=self.controls[:, :unroll])

    @property
    def fingerprint(self) -> str:
        return digest({"states": self.states, "controls": self.controls})

    def where(self, rows: Bool[np.ndarray, " N"] | Int[np.ndarray, " M"] | slice) -> Transitions:
        """Return the windows that `rows` selects."""
        return replace(
            self, states=self.states[rows], controls=self.controls[rows], run=self.run[rows]
        )


@final
@dataclass(frozen=True)
class StoredTransitions(Dataset):
    """A dataset in a folder; each shard is a part, read and checked when it is asked for."""

    folder: Place
    config: DatasetConfig
    system: System
    _seals: dict[int, str] = field(default_factory=dict, compare=False, repr=False)
    """The sha256 of each shard read so far."""

    @classmethod
    def at(cls, folder: str | Place) -> StoredTransitions:
        """Return the dataset in `folder`, of which only the configuration is read."""
        folder = place_of(folder)
        config = read_config(folder)
        return cls(folder, config, carried_system(config.system, config.definition))

    @property
    def part_count(self) -> int:
        return self.config.shards

    def read_part(self, number: int, unroll: int | None = None) -> Transitions:
        """Return shard `number`; BadFileError if it is missing, damaged, of another dataset, or has changed."""
        tensors, metadata = read_shard(self.folder, self.config, self.system, number)
        if self._seals.setdefault(number, metadata["sha256"]) != metadata["sha256"]:
            path = self.config.shard_path(self.folder, number)
            raise BadFileError(f"{path} has changed since it was first read. Start again.")
        return shard_transitions(self.config, self.system, tensors, metadata, unroll)

    def joined(self, shards: int) -> Transitions:
        """Return the first `shards` in memory, as one part; for recordings with what was kept for the test."""
        transitions = join_transitions([self.read_part(number) for number in range(shards)])
        if self.system.recordings is None:
            return transitions
        states, controls, noise = read_held_out(self.folder, self.config, self.system)
        return replace(transitions, held_out=(states, controls), noise=noise)

    @property
    def fingerprint(self) -> str:
        seals = "".join(self._seals[number] for number in range(self.part_count))
        return hashlib.sha256(seals.encode()).hexdigest()


def read_transitions(folder: str | Place, *, at_least: int | None = None) -> Transitions:
    """Return every transition in `folder`; BadFileError if a shard is missing, damaged or not part of the dataset.

    With `at_least`, only as many shards are read as hold that many transitions; recordings are read whole.
    """
    data = StoredTransitions.at(folder)
    count = data.part_count
    if at_least is not None and data.system.recordings is None:
        count = min(count, -(-at_least // (RUNS_PER_SHARD * data.config.samples_per_run)))
    return data.joined(count)


def read_held_out(
    folder: Place, config: DatasetConfig, system: System
) -> tuple[Float[np.ndarray, "B _ S"], Float[np.ndarray, "B T C"], Float[np.ndarray, " S"] | None]:
    """Return (states (B, T+1, S), controls (B, T, C)) of the recorded runs kept for the test, and the recordings' noise.

    Datasets of older versions do not state the noise.
    """
    path = folder / HELD_OUT_NAME
    tensors, metadata = read_tensors(path, "held-out", largest=MAX_HELD_OUT)
    if metadata.get("config") != config.hash:
        raise BadFileError(f"{path} belongs to another dataset. Generate into an empty folder.")
    controls = tensors.get("controls", np.zeros(0))
    steps = controls.shape[1] if controls.ndim == 3 else 1
    specs = {
        "states": TensorSpec(np.float64, (None, steps + 1, system.state.size)),
        "controls": TensorSpec(np.float64, (None, steps, system.control.size)),
    }
    noise = tensors.get("noise")
    if noise is not None:
        specs["noise"] = TensorSpec(np.float64, (system.state.size,))
    runs = check_tensors(path, tensors, specs)
    if not runs or not 1 <= steps <= RUN_STEPS:
        refuse(path, f"no runs of 1 to {RUN_STEPS} super steps")
    if noise is not None and not (noise >= 0).all():  # NaN is refused too
        refuse(path, "the noise is not a number of 0 or more")
    return tensors["states"], tensors["controls"], noise


def shard_transitions(
    config: DatasetConfig,
    system: System,
    tensors: Tensors,
    metadata: Metadata,
    unroll: int | None = None,
) -> Transitions:
    """Return the transitions of a shard's (tensors, metadata), in windows of `unroll` super steps; see `Dataset.read_part`.

    Simulated runs are numbered across all shards.
    """
    states, controls, run = windows_of(tensors, unroll or system.window_steps)
    if "segments" not in tensors:
        run = run + metadata["shard"] * RUNS_PER_SHARD
    return Transitions(config, system, states, controls, run, metadata["diverged"])


def join_transitions(parts: Sequence[Transitions]) -> Transitions:
    """Return the transitions of one or more parts of a dataset, in order."""
    if len(parts) == 1:
        return parts[0]
    return replace(
        parts[0],
        states=np.concatenate([part.states for part in parts]),
        controls=np.concatenate([part.controls for part in parts]),
        run=np.concatenate([part.run for part in parts]),
        diverged=sum(part.diverged for part in parts),
    )


def read_shard(
    folder: Place, config: DatasetConfig, system: System, shard: int
) -> tuple[Tensors, Metadata]:
    """Return one shard's (tensors, metadata), checked to belong to `config` and to match its specs."""
    path = config.shard_path(folder, shard)
    runs = min(RUNS_PER_SHARD, config.runs - shard * RUNS_PER_SHARD)
    specs = shard_specs(system, config)
    rows = runs
    if "segments" in specs:
        rows = runs * config.samples_per_run
    tensors, metadata = read_tensors(
        path, "shard", largest=HEADER_LIMIT + largest_size(specs, rows)
    )
    if metadata.get("config") != config.hash or metadata.get("shard") != shard:
        raise BadFileError(f"{path} belongs to another dataset. Generate into an empty folder.")
    diverged = whole_number(path, metadata, "diverged", runs)
    present = check_tensors(path, tensors, specs)
    if present + diverged != rows:
        refuse(path, f"{present:,} rows and {diverged:,} diverged; wanted {rows:,} together")
    last_sample = tensors["controls"].shape[1] - system.window_steps
    check_range(path, "samples", tensors["samples"], 0, last_sample)
    return tensors, metadata


def shard_specs(system: System, config: DatasetConfig) -> dict[str, TensorSpec]:
    """Return the specs of a shard: of simulated runs, or of windows cut out of recordings, each of its own segment."""
    is_recorded = system.recordings is not None
    steps = MAX_UNROLL if is_recorded else system.run_steps
    samples = 1 if is_recorded else config.samples_per_run
    specs = {
        "states": TensorSpec(np.float32, (None, steps + 1, system.state.size)),
        "controls": TensorSpec(np.float32, (None, steps, system.control.size)),
        "samples": TensorSpec(np.int32, (None, samples)),
    }
    if is_recorded:
        specs["segments"] = TensorSpec(np.int32, (None,))
    return specs


def windows_of(
    tensors: Tensors, unroll: int
) -> tuple[Float[np.ndarray, "N T S"], Float[np.ndarray, "N H C"], Int[np.ndarray, " N"]]:
    """Return the windows of `unroll` super steps that begin at a shard's samples, and the run of each; T = H + 1."""
    states = tensors["states"]
    controls = tensors["controls"]
    samples = tensors["samples"]
    numbers = tensors.get("segments", np.arange(len(states)))
    rows = np.arange(len(states))[:, None, None]
    steps = samples[:, :, None] + np.arange(unroll + 1)
    return (
        states[rows, steps].reshape(samples.size, unroll + 1, states.shape[-1]),
        controls[rows, steps[..., :-1]].reshape(samples.size, unroll, controls.shape[-1]),
        np.repeat(numbers, samples.shape[1]),
    )
