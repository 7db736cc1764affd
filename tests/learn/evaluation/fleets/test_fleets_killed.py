"""A training of a fleet goes on from its last checkpoint, on whatever machine: the same bytes, and no update twice."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tally import Tally

from neuroanimator import generate
from neuroanimator.executor.worker import pack
from neuroanimator.files.atomic import read_tensors
from neuroanimator.files.places import Place, UrlPath
from neuroanimator.learn.evaluation.fleets.fleet_file import Member, read_fleet
from neuroanimator.learn.evaluation.fleets.train_fleet import (
    MemberTask,
    TrainedMember,
    run_member_task,
)
from neuroanimator.learn.training.checkpoint import NAME
from neuroanimator.learn.training.config import UPDATES_PER_CHUNK
from neuroanimator.learn.training.feed import Feed
from neuroanimator.learn.training.train import run_folder

ONE = """
systems = ["pendulum"]
substeps = [5]
count = 1200
seconds = 0.02
[sizes.tiny]
widths = [4]
updates = 3000
batch = 16
"""

WORK = """
import sys
from pathlib import Path
from neuroanimator.executor.worker import perform
perform(Path(sys.argv[1]).read_bytes())
"""


@pytest.fixture(scope="module")
def member(tmp_path_factory: pytest.TempPathFactory) -> Member:
    path = tmp_path_factory.mktemp("fleet") / "fleet.toml"
    path.write_text(ONE)
    return read_fleet(path).members[0]


@pytest.fixture(scope="module")
def task(member: Member, tmp_path_factory: pytest.TempPathFactory) -> MemberTask:
    """A training whose workers share nothing but the folder of the datasets."""
    shared = tmp_path_factory.mktemp("shared")
    generate(member.data, shared / member.dataset)
    return MemberTask(
        member,
        data=str(shared / member.dataset),
        workplace="",
        checkpoints=str(shared / member.run_name),
    )


@pytest.fixture(scope="module")
def whole(task: MemberTask) -> TrainedMember:
    """What comes of it when nobody disturbs it."""
    return run_member_task(replace(task, checkpoints=""))


@contextmanager
def counted_chunks(stop_after: int = sys.maxsize) -> Iterator[list[int]]:
    """Yield the numbers of the chunks that are trained while the block runs; stop as Ctrl-C does after so many."""
    chunks: list[int] = []
    train_chunk = Feed.train

    def train(feed: Feed, network: Any, optimizer_state: Any, chunk: int) -> Any:
        if len(chunks) == stop_after:
            raise KeyboardInterrupt
        chunks.append(chunk)
        return train_chunk(feed, network, optimizer_state, chunk)

    with pytest.MonkeyPatch.context() as changed:
        changed.setattr(Feed, "train", train)
        yield chunks


def chunks_done(checkpoints: Place) -> int:
    """Return how many chunks a checkpoint holds."""
    _, metadata = read_tensors(checkpoints / NAME, "checkpoint")
    return metadata["chunk"]


def goes_on(task: MemberTask, whole: TrainedMember, done: int) -> None:
    """Check that a training of which so many chunks are done makes the others, and what an undisturbed one makes."""
    every = range(task.member.training.updates // UPDATES_PER_CHUNK)
    assert 0 < done < len(every)
    with counted_chunks() as chunks:
        assert run_member_task(task) == whole
    assert chunks == list(every[done:])
    # Another worker that is told to train it, too, finds that all is done.
    with counted_chunks() as chunks:
        assert run_member_task(task) == whole
    assert not chunks


def test_f05_a_worker_that_trains_is_killed_and_another_goes_on(
    task: MemberTask, whole: TrainedMember, tmp_path: Path, tally: Tally
):
    checkpoints = Path(task.checkpoints)
    call = tmp_path / "call"
    call.write_bytes(pack(run_member_task, task))
    worker = subprocess.Popen([sys.executable, "-c", WORK, str(call)])
    while worker.poll() is None and not (checkpoints / NAME).exists():
        time.sleep(0.002)
    worker.send_signal(signal.SIGKILL)
    assert worker.wait() == -signal.SIGKILL
    goes_on(task, whole, chunks_done(checkpoints))


@pytest.mark.parametrize("where", ["an object store", "the fleet's own folder"])
def test_whoever_comes_next_finds_the_checkpoints(
    where: str, task: MemberTask, whole: TrainedMember, tmp_path: Path
):
    member = task.member
    if where == "an object store":
        pytest.importorskip("fsspec", reason="no fsspec: pip install 'neuroanimator[s3]'")
        store = UrlPath("memory://bucket/fleet")
        generate(member.data, store / member.dataset)
        checkpoints = store / member.run_name
        task = replace(task, data=str(store / member.dataset), checkpoints=str(checkpoints))
    else:
        checkpoints = run_folder(tmp_path / member.file_name)
        task = replace(task, workplace=str(tmp_path), checkpoints="")
    with pytest.raises(KeyboardInterrupt), counted_chunks(stop_after=6):
        run_member_task(task)
    # A checkpoint is written once in four chunks.
    assert chunks_done(checkpoints) == 4
    goes_on(task, whole, 4)


def test_who_does_not_see_the_dataset_trains_alone(
    task: MemberTask, whole: TrainedMember, tmp_path: Path
):
    elsewhere = tmp_path / "elsewhere"
    task = replace(task, data=str(elsewhere / "data"), checkpoints=str(elsewhere / "run"))
    with counted_chunks() as chunks:
        assert run_member_task(task) == whole
    assert len(chunks) == task.member.training.updates // UPDATES_PER_CHUNK
    assert not elsewhere.exists()
