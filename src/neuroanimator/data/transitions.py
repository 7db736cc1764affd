"""The store of transitions: a folder of shards, and what is read back from it.

A shard holds whole runs and, per run, the super steps picked as training examples, Δt to 5Δt
apart (the seminar paper's eq. 8). Keeping the run lets training unroll from a picked step.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from neuroanimator.data.recorded_splits import cut_stretches
from neuroanimator.data.shard_checks import (
    Wanted,
    check_range,
    check_tensors,
    largest_size,
    refuse,
    whole_number,
)
from neuroanimator.definitions.carried import MAX_TEXT
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.parsing.json_text import parse_json_object
from neuroanimator.parsing.names import SystemName
from neuroanimator.storage.files import (
    HEADER_LIMIT,
    canonical_json,
    one_line,
    read_bounded,
    read_tensors,
    write_whole,
)
from neuroanimator.systems import carried_system
from neuroanimator.systems.recorded.recorded_system import RecordedSystem
from neuroanimator.systems.system import System
from neuroanimator.tables import first_fault

CONFIG_NAME = "dataset.json"
MAX_CONFIG = 2 * 2**20
"""[bytes] A definition, twice escaped, and a few numbers."""
RUN_STEPS = 40
"""Length of a run in super steps."""
PICKS_PER_RUN = 12
"""Training examples per run if nothing else is said: on average every third super step."""
MAX_GAP = 5
"""Super steps between two of these picks, at most (eq. 8); between more of them less."""
MAX_UNROLL = 4
"""Super steps that follow every pick within its run."""
RUNS_PER_SHARD = 256
MAX_SHOWN = 60
"""Characters of a setting shown in an error; a definition has thousands."""
MAX_HELD_OUT = 512 * 2**20
"""[bytes] No larger than the recordings these runs come from."""
HELD_OUT_NAME = "held-out.safetensors"
"""Runs of recordings kept for the test; simulated systems make their tests anew."""


class DatasetConfig(BaseModel):
    """Everything the bytes of a dataset depend on."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    system: SystemName
    substeps: int = Field(50, ge=1, le=1000)
    count: int = Field(100_000, ge=1, le=100_000_000)
    picks: Literal[12, 18, 24, 36] = PICKS_PER_RUN
    """Training examples taken from each run of `RUN_STEPS` super steps; more for physics that is dear."""
    idle_share: float = Field(0.1, ge=0, le=1)
    """Share of runs whose controls cease somewhere: bodies come to rest, and emulators should know how."""
    seed: int = Field(0, ge=0, lt=2**31)
    definition: str = Field("", max_length=MAX_TEXT)
    """What a user's own system can be made from again; empty for one that comes with the package."""
    mujoco: str = Field(mujoco.__version__, pattern=r"^[0-9A-Za-z.+-]{1,40}$")

    @property
    def runs(self) -> int:
        """Runs simulated: enough for `count` picks."""
        return -(-self.count // self.picks)

    @property
    def shards(self) -> int:
        """Files the runs are stored in."""
        return -(-self.runs // RUNS_PER_SHARD)

    @property
    def hash(self) -> str:
        """Sixteen hex digits that name this configuration."""
        return hashlib.sha256(canonical_json(self.model_dump()).encode()).hexdigest()[:16]

    def shard_path(self, folder: Path, shard: int) -> Path:
        """Return where shard number `shard` lies."""
        return folder / f"shard-{shard:05d}.safetensors"


def dataset_config(**values: Any) -> DatasetConfig:
    """Return a checked configuration; ArgumentError names a wrong field."""
    if str(values.get("system", "")).endswith(".toml"):
        raise ArgumentError(
            "system: wanted a name. Of a TOML file: made = load_system('my.toml'), then system=made.name, "
            "definition=made.definition."
        )
    try:
        config = DatasetConfig(**values)
    except ValidationError as error:
        raise ArgumentError(f"{first_fault(error)}.") from error
    system = carried_system(config.system, config.definition)
    system.truth.steps(config.substeps * system.physics_dt)
    if isinstance(system, RecordedSystem):
        system.recording()  # refused here if it is not what the TOML file says, before a folder is claimed
        most = most_windows(system, config)
        return config.model_copy(update={"count": min(config.count, most)})
    return config


def window_length(substeps: int) -> int:
    """Return how many physics steps' states a window spans, both ends included."""
    return MAX_UNROLL * substeps + 1


def most_windows(system: RecordedSystem, config: DatasetConfig) -> int:
    """Return how many windows recordings hold, in whole runs' worth of picks."""
    length = window_length(config.substeps)
    count = sum(stretch.windows(length) for stretch in cut_stretches(system, length)[0])
    if count < config.picks:
        raise BadFileError(f"{system.file}: only {count} windows of super steps. Record longer.")
    return count // config.picks * config.picks


def claim_folder(folder: Path, config: DatasetConfig) -> None:
    """Mark `folder` as holding `config`; refuse a folder that holds another one."""
    path = folder / CONFIG_NAME
    if not path.exists():
        write_whole(path, (json.dumps(config.model_dump(), indent=2) + "\n").encode())
        return
    held = read_config(folder)
    if held != config:
        old, new = held.model_dump(), config.model_dump()

        def short(value):
            return "another" if len(str(value)) > MAX_SHOWN else value

        changes = ", ".join(
            f"{key} {short(old[key])} there, {short(new[key])} asked"
            for key in new
            if old[key] != new[key]
        )
        raise BadFileError(
            f"{folder} holds another dataset ({changes}). Choose another --out, or the same values."
        )


def read_config(folder: Path) -> DatasetConfig:
    """Return the configuration of the dataset in `folder`."""
    path = folder / CONFIG_NAME
    if not path.exists():
        raise BadFileError(
            f"{folder} is not a dataset: no {CONFIG_NAME}. Make one with 'generate'."
        )
    content = read_bounded(path, MAX_CONFIG)
    try:
        return DatasetConfig.model_validate(parse_json_object(content, MAX_CONFIG))
    except ValidationError as error:
        raise BadFileError(
            f"{path} is damaged: {first_fault(error)}. Generate the dataset again."
        ) from error
    except ValueError as error:
        raise BadFileError(
            f"{path} is damaged: {one_line(error)}. Generate the dataset again."
        ) from error


@dataclass(frozen=True)
class Transitions:
    """A dataset in memory: windows of consecutive super steps, one per pick.

    `states` (N, H+1, S), `controls` (N, H, C), `run` (N,): which run each window comes from.
    H is `MAX_UNROLL`; the first step of a window is its training example.
    """

    config: DatasetConfig
    system: System
    states: np.ndarray
    controls: np.ndarray
    run: np.ndarray
    diverged: int
    held_out: tuple[np.ndarray, np.ndarray] | None = None
    """(states (B, T+1, S), controls (B, T, C)) kept for the test; of recordings only."""

    def __repr__(self) -> str:
        return f'Transitions("{self.config.system}", {len(self.states):,} windows, {self.config.substeps} substeps)'

    def where(self, mask: np.ndarray) -> Transitions:
        """Return the windows `mask` (N,) selects."""
        parts = self.states[mask], self.controls[mask], self.run[mask]
        return Transitions(self.config, self.system, *parts, self.diverged, self.held_out)


def read_transitions(folder: Path) -> Transitions:
    """Return every transition in `folder`; BadFileError if a shard is missing, damaged or not what a dataset holds."""
    config = read_config(folder)
    system = carried_system(config.system, config.definition)
    shards = (read_shard(folder, config, system, shard) for shard in range(config.shards))
    found = gather_transitions(
        config, system, ((tensors, metadata["diverged"]) for tensors, metadata in shards)
    )
    is_recorded = isinstance(system, RecordedSystem)
    return replace(found, held_out=read_held_out(folder, config, system)) if is_recorded else found


def read_held_out(
    folder: Path, config: DatasetConfig, system: System
) -> tuple[np.ndarray, np.ndarray]:
    """Return (states (B, T+1, S), controls (B, T, C)) of the recorded runs kept for the test."""
    path = folder / HELD_OUT_NAME
    tensors, metadata = read_tensors(path, "held-out", MAX_HELD_OUT)
    if metadata.get("config") != config.hash:
        raise BadFileError(f"{path} belongs to another dataset. Generate into an empty folder.")
    controls = tensors.get("controls", np.zeros(0))
    steps = controls.shape[1] if controls.ndim == 3 else 1
    wanted = {
        "states": Wanted(np.float64, (None, steps + 1, system.state.size)),
        "controls": Wanted(np.float64, (None, steps, system.control.size)),
    }
    if not check_tensors(path, tensors, wanted) or not 1 <= steps <= RUN_STEPS:
        refuse(path, f"no runs of 1 to {RUN_STEPS} super steps")
    return tensors["states"], tensors["controls"]


def gather_transitions(
    config: DatasetConfig, system: System, shards: Iterable[tuple[dict[str, np.ndarray], int]]
) -> Transitions:
    """Return the transitions in `shards`, pairs of tensors and blow-ups in order of their number."""
    windows, diverged = [], 0
    for shard, (tensors, dropped) in enumerate(shards):
        windows.append(windows_of(tensors, shard))
        diverged += dropped
    states, controls, run = (np.concatenate([part[i] for part in windows]) for i in range(3))
    return Transitions(config, system, states, controls, run, diverged)


def read_shard(
    folder: Path, config: DatasetConfig, system: System, shard: int
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return one shard's (tensors, metadata), checked to belong to `config` and to hold what such a shard does."""
    path = config.shard_path(folder, shard)
    is_recorded = isinstance(system, RecordedSystem)
    wanted = wanted_of_recordings(system) if is_recorded else wanted_of_runs(system, config)
    runs = min(RUNS_PER_SHARD, config.runs - shard * RUNS_PER_SHARD)
    rows = runs * config.picks if is_recorded else runs
    tensors, metadata = read_tensors(path, "shard", HEADER_LIMIT + largest_size(wanted, rows))
    if metadata.get("config") != config.hash or metadata.get("shard") != shard:
        raise BadFileError(f"{path} belongs to another dataset. Generate into an empty folder.")
    diverged = whole_number(path, metadata, "diverged", runs)
    found = check_tensors(path, tensors, wanted)
    if found + diverged != rows:
        refuse(path, f"{found:,} rows and {diverged:,} blow-ups; wanted {rows:,} together")
    check_range(path, "picks", tensors["picks"], 0, tensors["controls"].shape[1] - MAX_UNROLL)
    return tensors, metadata


def wanted_of_runs(system: System, config: DatasetConfig) -> dict[str, Wanted]:
    """Return what a shard of simulated runs holds."""
    return {
        "states": Wanted(np.float32, (None, RUN_STEPS + 1, system.state.size)),
        "controls": Wanted(np.float32, (None, RUN_STEPS, system.control.size)),
        "picks": Wanted(np.int32, (None, config.picks)),
    }


def wanted_of_recordings(system: System) -> dict[str, Wanted]:
    """Return what a shard of windows cut out of recordings holds."""
    return {
        "states": Wanted(np.float32, (None, MAX_UNROLL + 1, system.state.size)),
        "controls": Wanted(np.float32, (None, MAX_UNROLL, system.control.size)),
        "picks": Wanted(np.int32, (None, 1)),
        "runs": Wanted(np.int32, (None,)),
    }


def windows_of(
    tensors: dict[str, np.ndarray], shard: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (states (N, H+1, S), controls (N, H, C), run (N,)): the windows at a shard's picks."""
    states, controls, picks = tensors["states"], tensors["controls"], tensors["picks"]
    rows = np.arange(len(states))[:, None, None]
    steps = picks[:, :, None] + np.arange(MAX_UNROLL + 1)
    numbers = tensors.get("runs", np.arange(len(states)) + shard * RUNS_PER_SHARD)
    run = np.repeat(numbers, picks.shape[1])
    windows = states[rows, steps].reshape(-1, MAX_UNROLL + 1, states.shape[-1])
    held = controls[rows, steps[..., :-1]].reshape(-1, MAX_UNROLL, controls.shape[-1])
    return windows, held, run
