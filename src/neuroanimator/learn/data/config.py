"""Configuration of a dataset: the system, the super step, the number of transitions, the seed."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from neuroanimator.definitions.carried import data_identity, read_definition_text
from neuroanimator.errors import ArgumentError
from neuroanimator.files.atomic import canonical_json
from neuroanimator.files.json_text import MAX_DEFINITION
from neuroanimator.files.names import SystemName
from neuroanimator.files.places import Place
from neuroanimator.files.tables import Settings, Table
from neuroanimator.files.zoo import SHIPPED_SYSTEMS, ShippedSystem
from neuroanimator.physics import carried_system
from neuroanimator.systems.system import System

RUN_STEPS = System.run_steps
"""Number of super steps in a simulated run, unless its system says otherwise."""

SAMPLES_PER_RUN = 12
"""Default number of super steps of a run that become training examples: on average every third."""

USUAL_COUNT = 300_000
"""Default number of transitions of a system: as many runs as 100,000 transitions need with `SAMPLES_PER_RUN`."""

USUAL_SAMPLES_PER_RUN = 36
"""Default number of transitions per run: simulation costs more than storage, and robots with contacts need every example."""

SWIMMER_COUNT = 60_000
"""Default number of transitions of a soft body with muscles, `USUAL_SAMPLES_PER_RUN` of each run."""

SOFT_COUNT = 12_288
"""Default number of transitions of a soft body, each the first of a window of `LONG_WINDOW` super steps: 1,024 runs."""

MAX_GAP = 5
"""Maximum distance between neighbouring examples [super steps] with `SAMPLES_PER_RUN` (eq. 8); less with more samples."""

MAX_UNROLL = System.window_steps
"""Number of super steps that follow every example within its run, unless its system says otherwise."""

RUNS_PER_SHARD = 256
"""Number of runs per file of the dataset: few files, each quick to make again."""


_identity_of = lru_cache(maxsize=4)(data_identity)
"""Cached, as every shard needs the hash and a definition may be long."""


class DatasetTable(Table):
    """Fields of a `DatasetConfig` as stored in a dataset's file, each checked independently."""

    system: SystemName
    """Its name, such as `fish`. For a TOML file: the name of `load_system("my.toml")`, with its `definition`."""
    substeps: int = Field(default=50, ge=1, le=1000)
    count: int = Field(default=100_000, ge=1, le=100_000_000)
    samples_per_run: Literal[12, 18, 24, 36] = SAMPLES_PER_RUN
    """Number of training examples taken from each run of `RUN_STEPS` super steps; more for expensive physics."""
    idle_share: float = Field(default=0.1, ge=0, le=1)
    """Share of runs whose controls cease at some point: emulators should know how bodies come to rest."""
    held_share: float = Field(default=0.1, ge=0, le=1)
    """Share of runs that hold their controls at the bounds, as users who hold a key do; none of pushes and of paths."""
    seed: int = Field(default=0, ge=0, lt=2**31)
    definition: str = Field(default="", max_length=MAX_DEFINITION)
    """Source from which a user's own system is rebuilt; empty for a system that ships."""
    mujoco: str = Field(default=version("mujoco"), pattern=r"^[0-9A-Za-z.+-]{1,40}$")


class DatasetConfig(Settings, DatasetTable):
    """Everything the bytes of a dataset depend on.

    Raises ArgumentError for a wrong field, an unknown system, and super steps that are not a whole number of
    physics steps.
    """

    if not TYPE_CHECKING:  # so that editors offer the fields as arguments

        def __init__(self, **values: Any) -> None:
            if str(values.get("system", "")).endswith(".toml"):
                raise ArgumentError(
                    "system: wanted a name. For a TOML file: made = load_system('my.toml'), then system=made.name, "
                    "definition=made.definition_text."
                )
            super().__init__(**values)

    def check(self) -> None:
        system = carried_system(self.system, self.definition)
        system.truth.steps(self.substeps * system.physics_dt)

    @classmethod
    def of_file(cls, values: dict[str, Any]) -> DatasetConfig:
        """Return the configuration in a dataset's file without loading its system; ValidationError names a wrong field."""
        checked = DatasetTable.model_validate(values)
        return cls.model_construct(**checked.model_dump())

    @classmethod
    def usual(
        cls,
        system: str,
        definition: str,
        substeps: int,
        *,
        count: int | None = None,
        **settings: Any,
    ) -> DatasetConfig:
        """Return a system's default dataset, changed only by `settings`."""
        usual: dict[str, Any] = {"count": USUAL_COUNT, "samples_per_run": USUAL_SAMPLES_PER_RUN}
        is_soft, has_muscles = _softness(system, definition)
        if has_muscles:
            usual["count"] = SWIMMER_COUNT
        elif is_soft:
            usual = {"count": SOFT_COUNT, "samples_per_run": SAMPLES_PER_RUN}
        if count is not None:
            usual["count"] = count
        usual |= settings
        return cls(system=system, definition=definition, substeps=substeps, **usual)

    @property
    def runs(self) -> int:
        """Number of runs simulated: enough for `count` examples."""
        return -(-self.count // self.samples_per_run)

    @property
    def shards(self) -> int:
        """Number of files in which the runs are stored."""
        return -(-self.runs // RUNS_PER_SHARD)

    @property
    def hash(self) -> str:
        """Sixteen hex digits that identify everything the bytes depend on; goals do not count, as they are no physics."""
        values = self.model_dump() | {"definition": _identity_of(self.definition)}
        return hashlib.sha256(canonical_json(values).encode()).hexdigest()[:16]

    def shard_path(self, folder: Place, shard: int) -> Place:
        """Return the path of shard number `shard`."""
        return folder / f"shard-{shard:05d}.safetensors"


def _softness(system: str, definition: str) -> tuple[bool, bool]:
    """Return whether a system is a soft body, whose physics is expensive, and whether it is one with muscles."""
    if not definition:
        shipped = SHIPPED_SYSTEMS.get(system, ShippedSystem(""))
        return shipped.is_soft, shipped.has_muscles
    written = read_definition_text(definition)
    is_soft = written.kind in ("soft", "flex")
    return is_soft, is_soft and getattr(written.definition, "muscles", None) is not None


def window_length(substeps: int) -> int:
    """Return the number of states, one per physics step, in a window, both ends included."""
    return MAX_UNROLL * substeps + 1
