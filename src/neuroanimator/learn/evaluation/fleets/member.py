"""Train one emulator of a fleet and measure it: a task for an executor."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.tensors import emulator_tensors
from neuroanimator.errors import BadFileError
from neuroanimator.files.places import Place, place_of
from neuroanimator.files.unfinished import temporary_folder
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.generate import generate
from neuroanimator.learn.data.store import Dataset, read_config
from neuroanimator.learn.data.stored import open_transitions
from neuroanimator.learn.evaluation.accuracy import unseen_errors
from neuroanimator.learn.evaluation.fleets.fleet_file import Member
from neuroanimator.learn.evaluation.held_out import held_out_runs, recorded_runs
from neuroanimator.learn.training.train import train
from neuroanimator.systems.trusted_files import NO_FILES, TrustedFiles, trust_as_told

TEST_RUNS = 24
"""Number of unseen runs on which each emulator is tested."""


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
