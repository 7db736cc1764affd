"""What a dataset is made of: the system, the super step, how many transitions, the seed."""

from __future__ import annotations

import hashlib
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from neuroanimator.definitions.carried import MAX_TEXT
from neuroanimator.errors import ArgumentError
from neuroanimator.parsing.names import SystemName
from neuroanimator.storage.files import canonical_json
from neuroanimator.systems import carried_system
from neuroanimator.tables import first_fault

RUN_STEPS = 40
"""A simulated run lasts this many super steps."""

SAMPLES_PER_RUN = 12
"""So many super steps of a run become training examples if nothing else is said: on average every third."""

MAX_GAP = 5
"""With `SAMPLES_PER_RUN` of them, neighbouring examples lie at most so many super steps apart (eq. 8); with more, less."""

MAX_UNROLL = 4
"""So many super steps follow every example within its run, so that training can unroll over them."""

RUNS_PER_SHARD = 256
"""A file of the dataset holds this many runs: large enough to be few, small enough to be made again quickly."""


class DatasetConfig(BaseModel):
    """Everything the bytes of a dataset depend on."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    system: SystemName
    substeps: int = Field(50, ge=1, le=1000)
    count: int = Field(100_000, ge=1, le=100_000_000)
    samples_per_run: Literal[12, 18, 24, 36] = SAMPLES_PER_RUN
    """Training examples taken from each run of `RUN_STEPS` super steps; more for physics that is dear."""
    idle_share: float = Field(0.1, ge=0, le=1)
    """Share of runs whose controls cease somewhere: bodies come to rest, and emulators should know how."""
    seed: int = Field(0, ge=0, lt=2**31)
    definition: str = Field("", max_length=MAX_TEXT)
    """What a user's own system can be made from again; empty for one that comes with the package."""
    mujoco: str = Field(version("mujoco"), pattern=r"^[0-9A-Za-z.+-]{1,40}$")

    @property
    def runs(self) -> int:
        """Runs simulated: enough for `count` examples."""
        return -(-self.count // self.samples_per_run)

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
    return config


def window_length(substeps: int) -> int:
    """Return how many physics steps' states a window spans, both ends included."""
    return MAX_UNROLL * substeps + 1
