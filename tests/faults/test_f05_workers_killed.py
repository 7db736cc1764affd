"""Workers killed in the middle of a shard change no byte, and none outlives the command that started it."""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from pathlib import Path

import pytest
from processes import GENERATE, leftovers, start, wait_until_it_listens
from tally import Tally

from neuroanimator import DatasetConfig, NeuroAnimatorError, generate
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.storage.unfinished import is_running

SIX_THOUSAND = DatasetConfig(system="pendulum", count=6000)


def check_same(dataset: Path, folder: Path, tally: Tally) -> None:
    paths = sorted(dataset.glob("*.*s*"))
    assert len(paths) == 3
    for path in paths:
        tally.expect(folder / path.name, path.read_bytes())
    assert not leftovers(folder)


def test_f05_a_worker_killed_in_a_shard_changes_no_byte(
    dataset: Path, tmp_path: Path, tally: Tally
):
    killed: list[int] = []
    with LocalExecutor(2) as executor:

        def kill_some() -> None:
            rng = random.Random(0)
            while len(killed) < 3 and not done.wait(rng.uniform(0.2, 0.6)):
                for process in executor.process_ids()[-1:]:
                    os.kill(process, signal.SIGKILL)
                    killed.append(process)

        done = threading.Event()
        killer = threading.Thread(target=kill_some)
        killer.start()
        generate(SIX_THOUSAND, tmp_path, executor=executor)
        done.set()
        killer.join()
    tally.tried += len(killed)
    assert killed
    check_same(dataset, tmp_path, tally)


def test_f05_a_worker_that_hangs_is_told_of(tmp_path: Path):
    with (
        LocalExecutor(2) as executor,
        pytest.raises(NeuroAnimatorError, match="shard 0: its worker gave no answer for 0.01 s"),
    ):
        generate(SIX_THOUSAND, tmp_path, executor=executor, longest=0.01)


def children(process: int) -> list[int]:
    """Return the processes a process has started."""
    try:
        paths = list(Path(f"/proc/{process}/task").glob("*/children"))
        return [int(word) for path in paths for word in path.read_text().split()]
    except OSError:
        return []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_f17_workers_end_with_the_command_and_it_goes_on_later(
    number: int, dataset: Path, tmp_path: Path, tally: Tally
):
    words = [*GENERATE, tmp_path / "data", "--workers", "2"]
    process = start(tmp_path, *words)
    wait_until_it_listens(process)
    given_up = time.monotonic() + 20
    while len(children(process.pid)) < 2 and time.monotonic() < given_up:
        time.sleep(0.01)
    workers = children(process.pid)
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    assert "Traceback" not in errors
    assert workers
    given_up = time.monotonic() + 10
    while any(is_running(worker) for worker in workers):
        assert time.monotonic() < given_up
        time.sleep(0.01)
    generate(SIX_THOUSAND, tmp_path / "data")
    check_same(dataset, tmp_path / "data", tally)
