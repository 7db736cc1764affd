"""Workers killed in the middle of a shard change no byte, and none outlives the command that started it."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import pytest
from processes import GENERATE, children, leftovers, start, wait_until_it_listens
from tally import Tally
from waiting import PATIENCE, wait_until

from neuroanimator import DatasetConfig, generate
from neuroanimator.executor.executor import LostTaskError
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.files.unfinished import is_running

SIX_THOUSAND = DatasetConfig(system="pendulum", count=6000)


def check_same(dataset: Path, folder: Path, tally: Tally) -> None:
    paths = sorted(dataset.glob("*.*s*"))
    assert len(paths) == 3
    for path in paths:
        tally.expect(folder / path.name, path.read_bytes())
    assert not leftovers(folder)


def test_f05_a_worker_killed_in_a_shard_is_told_of_and_changes_no_byte(
    dataset: Path, tmp_path: Path, tally: Tally
):
    others = set(children(os.getpid()))
    killed = threading.Event()

    def kill_one() -> None:
        while not killed.is_set():
            for process in sorted({*children(os.getpid())} - others)[:1]:
                os.kill(process, signal.SIGKILL)
                killed.set()
            time.sleep(0.01)

    killer = threading.Thread(target=kill_one)
    killer.start()
    with LocalExecutor(2) as executor:
        with pytest.raises(LostTaskError, match="shard [01]: its worker died of signal 9"):
            generate(SIX_THOUSAND, tmp_path, executor=executor)
        killer.join()
        generate(SIX_THOUSAND, tmp_path, executor=executor)
    check_same(dataset, tmp_path, tally)


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(
            signal.SIGINT, marks=pytest.mark.endurance
        ),  # the command can tell them itself
        signal.SIGKILL,
    ],
)
def test_f17_workers_end_with_the_command_and_it_goes_on_later(
    number: int, dataset: Path, tmp_path: Path, tally: Tally
):
    words = [*GENERATE, tmp_path / "data", "--workers", "2"]
    process = start(tmp_path, *words)
    wait_until_it_listens(process)
    wait_until(lambda: len(children(process.pid)) >= 2)
    workers = children(process.pid)
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in errors
    assert workers
    wait_until(lambda: not any(is_running(worker) for worker in workers))
    generate(SIX_THOUSAND, tmp_path / "data")
    check_same(dataset, tmp_path / "data", tally)
