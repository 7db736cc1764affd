"""The file that describes a fleet, read and checked before anything starts.

systems = ["pendulum", "my-robot.toml"]     names, or TOML files as 'new' writes them
substeps = [25, 50]                         physics steps of a super step
seeds = [0, 1, 2]
count = 100_000                             transitions of each dataset
[sizes.small]                               any settings of a training, under a name
widths = [32]
updates = 4_000
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from neuroanimator.errors import ArgumentError, BadFileError, NeuroAnimatorError
from neuroanimator.files.names import PartName
from neuroanimator.files.tables import Table, check_table, read_toml
from neuroanimator.learn.data.config import USUAL_COUNT, USUAL_SAMPLES_PER_RUN, DatasetConfig
from neuroanimator.learn.data.recorded_segments import limited_to_recordings
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.physics import carried_system
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.text import listed, quoted

MARK = "systems"
"""Key by which a TOML file describes a fleet; the file of a system has none."""

MAX_MEMBERS = 10_000
"""Maximum number of members: a larger fleet is a mistake."""

USUAL_SIZE = "usual"
"""Name of the size if the file names none: each system's usual settings."""

Seed = Annotated[int, Field(ge=0, lt=2**31)]
Substeps = Annotated[int, Field(ge=1, le=1000)]


class FleetTable(Table):
    """The keys of a fleet's file."""

    systems: tuple[str, ...] = Field(min_length=1)
    substeps: tuple[Substeps, ...] = Field(default=(50,), min_length=1)
    seeds: tuple[Seed, ...] = Field(default=(0,), min_length=1)
    sizes: dict[PartName, dict[str, Any]] = Field(default_factory=lambda: {USUAL_SIZE: {}})
    count: int = Field(default=USUAL_COUNT, ge=1, le=100_000_000)
    samples_per_run: Literal[12, 18, 24, 36] = USUAL_SAMPLES_PER_RUN
    seconds: float = Field(default=1.0, gt=0, le=3600)
    """Time after which the emulators' errors are compared [s]."""
    data: str = Field(default="", max_length=1000)
    """Folder or URL of the datasets; beside the emulators if empty."""


@dataclass(frozen=True)
class Member:
    """One emulator of a fleet."""

    name: str
    size: str
    data: DatasetConfig
    training: TrainingConfig
    seconds: float
    """Time after which its error is measured [s]."""

    @property
    def dataset(self) -> str:
        """The name of its dataset, shared by members that differ only in size and seed."""
        return f"{self.data.system}-{self.data.substeps}"

    @property
    def file_name(self) -> str:
        """The name of its file."""
        return f"{self.name}.emulator.safetensors"

    @property
    def run_name(self) -> str:
        """The name of the folder of its checkpoints, where several fleets may keep theirs."""
        return f"{self.name}-{self.data.hash}-{self.training.hash}.run"

    @property
    def identity(self) -> str:
        """Key that distinguishes it from another of the same name: everything its bytes depend on."""
        return f"{self.data.hash}-{self.training.hash}-{self.seconds:g}"


@dataclass(frozen=True)
class Fleet:
    """The members of a fleet, and where their data lie."""

    members: tuple[Member, ...]
    data: str


def is_fleet(path: Path) -> bool:
    """Return whether a TOML file describes a fleet, rather than a system."""
    return path.suffix == ".toml" and path.is_file() and MARK in read_toml(path)


def read_fleet(path: Path) -> Fleet:
    """Return the fleet a TOML file describes.

    ArgumentError or BadFileError, one line, for an unknown system, a setting that is wrong, and two members of one name.
    """
    table: FleetTable = check_table(read_toml(path), path.name, FleetTable)
    count = len(table.systems) * len(table.substeps) * len(table.sizes) * len(table.seeds)
    if not 1 <= count <= MAX_MEMBERS:
        raise BadFileError(f"{path.name}: {count:,} emulators; wanted 1 to {MAX_MEMBERS:,}.")
    members: list[Member] = []
    for reference in table.systems:
        try:
            members += members_of(reference, table, path.parent)
        except NeuroAnimatorError as error:
            raise ArgumentError(f"{path.name}: {quoted(reference)}: {error}") from error
    _check_names(path.name, members)
    return Fleet(tuple(members), table.data)


def members_of(reference: str, table: FleetTable, folder: Path) -> list[Member]:
    """Return the members of one system; its TOML file is looked for beside the fleet's, and is trusted from now on."""
    if reference.endswith(".toml"):
        reference = str(folder / reference)
        trust_files(reference)
    name, definition, _ = resolve(reference)
    system = carried_system(name, definition)
    members = []
    for substeps, size, seed in product(table.substeps, table.sizes, table.seeds):
        settings = table.sizes[size] | {"seed": seed}
        data = DatasetConfig(
            system=name,
            definition=definition,
            substeps=substeps,
            count=table.count,
            samples_per_run=table.samples_per_run,
        )
        member = Member(
            name=f"{name}-{substeps}-{size}-{seed}",
            size=size,
            data=limited_to_recordings(data, system),
            training=TrainingConfig.usual(system.structure, **settings),
            seconds=table.seconds,
        )
        members.append(member)
    return members


def _check_names(file: str, members: list[Member]) -> None:
    """Raise BadFileError if two members would share a file; some disks ignore case."""
    counts = Counter(member.name.lower() for member in members)
    twice = [name for name, count in counts.items() if count > 1]
    if twice:
        raise BadFileError(
            f"{file}: more than one emulator would be called {listed(twice)}. Name each system, size and seed once."
        )
