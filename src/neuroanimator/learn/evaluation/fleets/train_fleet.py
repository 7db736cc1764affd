"""Train the missing members of a fleet, and write the table of all."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.tensors import emulator_tensors
from neuroanimator.errors import BadFileError, NeuroAnimatorError
from neuroanimator.executor.executor import Executor, Outcome, raise_first
from neuroanimator.files.atomic import SIZE_LIMIT, locked, read_bounded, write_whole
from neuroanimator.files.json_text import parse_json_object
from neuroanimator.files.places import Place, place_of
from neuroanimator.files.unfinished import remove_stale, temporary_folder
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.generate import generate
from neuroanimator.learn.data.store import Dataset, read_config
from neuroanimator.learn.data.stored import open_transitions
from neuroanimator.learn.evaluation.accuracy import unseen_errors
from neuroanimator.learn.evaluation.csv_table import write_csv
from neuroanimator.learn.evaluation.fleets.fleet_file import Fleet, Member
from neuroanimator.learn.evaluation.held_out import held_out_runs, recorded_runs
from neuroanimator.learn.training.train import train
from neuroanimator.systems.trusted_files import (
    NO_FILES,
    TrustedFiles,
    trust_as_told,
    trusted_so_far,
)

TABLE = "fleet.csv"
"""Name of the table in the fleet's folder."""

ROWS = "rows"
"""Folder of the rows, a file each, which say that an emulator is done."""

DATA = "data"
"""Folder of the datasets, unless the fleet's file names another place."""

MAX_ROW = 10_000
"""Maximum size of a row's file [bytes]."""

TEST_RUNS = 24
"""Number of unseen runs on which each emulator is tested."""


@dataclass(frozen=True)
class FleetRow:
    """One emulator in the table."""

    name: str
    system: str
    substeps: int
    size: str
    seed: int
    numbers: int
    """Number of weights and other numbers in it."""
    one_step_error: float
    error: float
    """Error after the fleet's time, on unseen runs; infinite if a run diverged."""
    sha256: str
    """Hash of its file."""
    best: bool = False
    """Whether its error is the least of its system's."""


def train_fleet(
    fleet: Fleet,
    out: str | Path,
    executor: Executor,
    *,
    on_start: Callable[[int], None] = lambda count: None,
    on_member: Callable[[], None] = lambda: None,
) -> list[FleetRow]:
    """Train every member of `fleet` into the folder `out`; return their rows, which are also in its `fleet.csv`.

    Members that are there and whole are kept. `on_start` is called with the number of members to train, once their data
    are made, and `on_member` as each is done. All others are trained before the error of one is raised.
    """
    out = Path(out)
    with locked(out):
        remove_stale(out)
        rows: dict[str, FleetRow] = {}
        missing = []
        for member in fleet.members:
            row = _read_row(member, out)
            if row is None:
                missing.append(member)
            else:
                rows[member.name] = row
        data = place_of(fleet.data) if fleet.data else out / DATA
        datasets = {member.dataset: member.data for member in missing}
        for name, config in datasets.items():
            generate(config, data / name, executor=executor)
        on_start(len(missing))
        failed: dict[int, NeuroAnimatorError] = {}
        for outcome in _trained(missing, data, out, executor):
            if outcome.error is not None:
                failed[outcome.index] = outcome.error
                continue
            member = missing[outcome.index]
            rows[member.name] = _keep(member, outcome.value(), out)
            on_member()
        table = _marked([rows[member.name] for member in fleet.members if member.name in rows])
        if table:
            write_csv(out / TABLE, [asdict(row) for row in table])
        raise_first(failed, len(missing))
    return table


def _trained(
    members: list[Member], data: Place, out: Path, executor: Executor
) -> Iterator[Outcome[TrainedMember]]:
    workplace = str(out.resolve()) if executor.shares_disk else ""
    tasks = []
    for member in members:
        checkpoints = ""
        if not executor.shares_disk:
            checkpoints = _as_seen_elsewhere(data / member.run_name)
        task = MemberTask(
            member=member,
            data=_as_seen_elsewhere(data / member.dataset),
            workplace=workplace,
            checkpoints=checkpoints,
            trusted=trusted_so_far(),
        )
        tasks.append(task)
    return executor.outcomes(run_member_task, tasks)


def _as_seen_elsewhere(place: Place) -> str:
    """Return a folder or URL so that a worker in another working directory finds it."""
    return str(place.resolve() if isinstance(place, Path) else place)


def _keep(member: Member, trained: TrainedMember, out: Path) -> FleetRow:
    """Write an emulator, then the row that says it is there; return the row."""
    write_whole(out / member.file_name, trained.content)
    row = FleetRow(
        name=member.name,
        system=member.data.system,
        substeps=member.data.substeps,
        size=member.size,
        seed=member.training.seed,
        numbers=trained.numbers,
        one_step_error=trained.one_step_error,
        error=trained.error,
        sha256=hashlib.sha256(trained.content).hexdigest(),
    )
    values = asdict(row) | {"identity": member.identity, "error": _as_json(row.error)}
    write_whole(_row_path(out, member), f"{json.dumps(values, indent=2)}\n".encode())
    return row


def _read_row(member: Member, out: Path) -> FleetRow | None:
    """Return the row of a member that is there and whole; BadFileError if it belongs to another fleet."""
    path = _row_path(out, member)
    if not path.exists():
        return None
    try:
        values = parse_json_object(read_bounded(path, MAX_ROW), MAX_ROW)
        identity = values.pop("identity")
        values["error"] = float(values["error"])
        row = FleetRow(**values)
        content = read_bounded(out / member.file_name, SIZE_LIMIT)
    except (ValueError, TypeError, KeyError, BadFileError):
        return None  # damaged or truncated: it is made again
    if identity != member.identity:
        raise BadFileError(
            f"{out} holds another fleet's {member.name}. Choose another --out, or the same settings."
        )
    if hashlib.sha256(content).hexdigest() != row.sha256:
        return None
    return row


def _row_path(out: Path, member: Member) -> Path:
    return out / ROWS / f"{member.name}.json"


def _as_json(error: float) -> float | str:
    """Return a number that JSON can hold; it has no infinity."""
    return error if math.isfinite(error) else "inf"


def _marked(rows: list[FleetRow]) -> list[FleetRow]:
    """Return the rows, the best of each system marked: the one with the smallest error, the first of equals."""
    best: dict[str, FleetRow] = {}
    for row in rows:
        if row.system not in best or row.error < best[row.system].error:
            best[row.system] = row
    return [replace(row, best=best[row.system] is row) for row in rows]


@dataclass(frozen=True)
class MemberTask:
    """One training."""

    member: Member
    data: str
    """Folder or URL of its dataset."""
    workplace: str
    """Folder for unfinished work, so that a killed training resumes; empty where the worker may not see this disk."""
    checkpoints: str = ""
    """Folder or URL of its checkpoints beside the dataset, where there is no `workplace`: a worker that sees the
    dataset resumes from them, one that does not starts again."""
    trusted: TrustedFiles = NO_FILES
    """The files that the submitting process may use."""

    @property
    def label(self) -> str:
        """Its name in error messages."""
        return self.member.name


class TrainedMember(NamedTuple):
    """The outcome of a training."""

    content: bytes
    """The emulator's file."""
    numbers: int
    """Number of weights and other numbers in it."""
    one_step_error: float
    """One-step error on unseen runs, over the standard deviation of the change."""
    error: float
    """Rollout error after the fleet's time, over a run's distance from its start; infinite if one diverged."""


def run_member_task(task: MemberTask) -> TrainedMember:
    """Return a trained emulator and its errors: a function of the member alone."""
    trust_as_told(task.trusted)
    with _workplace(task) as folder:
        member = task.member
        place = place_of(task.data)
        checkpoints = None
        if _holds(place, member.data):
            checkpoints = _shared_checkpoints(task)
        else:
            place = folder / member.dataset
            generate(member.data, place)
        data = open_transitions(place, member.training.memory)
        path = folder / member.file_name
        emulator = train(data, member.training, path, checkpoints=checkpoints)
        one_step, error = _errors(emulator, data, member.seconds)
        tensors = emulator_tensors(emulator)
        numbers = sum(np.asarray(tensor).size for tensor in tensors.values())
        return TrainedMember(path.read_bytes(), numbers, one_step, error)


@contextmanager
def _workplace(task: MemberTask) -> Iterator[Path]:
    if task.workplace:
        yield Path(task.workplace)
        return
    with temporary_folder() as folder:
        yield folder


def _holds(place: Place, config: DatasetConfig) -> bool:
    """Return whether this machine sees the dataset there; if not, it makes its own, which is the same."""
    try:
        return read_config(place).hash == config.hash
    except BadFileError:
        return False


def _shared_checkpoints(task: MemberTask) -> Place | None:
    """Return where the next worker, on any machine, will look for checkpoints; None if nowhere."""
    if not task.checkpoints:
        return None
    place = place_of(task.checkpoints)
    if isinstance(place, Path) and not os.access(place.parent, os.W_OK):
        return None  # a read-only folder
    return place


def _errors(emulator: Emulator, data: Dataset, seconds: float) -> tuple[float, float]:
    """Return (one-step error, error after `seconds`) on unseen runs."""
    if data.held_out is not None:
        test = recorded_runs(emulator, data)
    else:
        test = held_out_runs(emulator, count=TEST_RUNS, seconds=max(seconds, emulator.dt))
    return unseen_errors(emulator, test, seconds)
