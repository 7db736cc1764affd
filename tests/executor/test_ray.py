"""A Ray cluster gives what processes of this machine give, whatever happens to its workers."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

import pytest
from executor_tasks import Square, cores, search_path, square
from tally import Tally

from neuroanimator import DatasetConfig, generate
from neuroanimator.cli.worker_options import chosen_executor
from neuroanimator.errors import ArgumentError, BadFileError, ResourceError
from neuroanimator.executor.executor import Executor, LostTaskError, Outcome
from neuroanimator.executor.ray_cluster import RayExecutor

pytestmark = pytest.mark.filterwarnings("default")  # Ray's own

NUMBERS = range(6)


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Executor]:
    """Two workers of a cluster on this machine, begun in a folder that tests put on no path."""
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'neuroanimator[ray]'")
    with chdir(tmp_path_factory.mktemp("present")), RayExecutor(None, workers=2) as executor:
        yield executor


def test_results_come_in_the_order_of_the_tasks(two: Executor):
    tasks = [Square(number, seconds=0.05 * (5 - number)) for number in NUMBERS]
    assert two.map(square, tasks) == [n**2 for n in NUMBERS]
    assert two.map(square, []) == []
    assert two.map(cores, [Square(0)]) == [("1", "1", "1", "cpu")]


def test_a_python_file_of_the_present_folder_does_not_run_in_ray(two: Executor):
    [folders] = two.map(search_path, [Square(0)])
    assert not {"", os.getcwd()} & set(folders)


def test_an_error_names_its_task_and_the_others_end(two: Executor):
    tasks = [Square(n, fault="complains" if n == 2 else "") for n in NUMBERS]
    ended: list[Outcome[int]] = []
    with pytest.raises(BadFileError, match="^number 2: it is damaged.$"):
        two.map(square, tasks, on_done=ended.append)
    assert len(ended) == len(NUMBERS)


@pytest.mark.endurance
def test_f05_who_dies_in_ray_is_replaced_by_ray(
    two: Executor, tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    tasks = [
        Square(1, fault="dies once", mark=str(tmp_path / "1")),
        Square(2, fault="dies"),
        Square(3),
    ]
    ended: list[Outcome[int]] = []
    with pytest.raises(LostTaskError, match="^number 2: its worker died: "):
        two.map(square, tasks, on_done=ended.append)
    assert {outcome.index: outcome.result for outcome in ended} == {0: 1, 1: None, 2: 9}
    assert capfd.readouterr().out == ""


@pytest.mark.endurance
def test_f20_the_bytes_are_those_of_one_process_though_a_worker_is_killed(
    two: Executor, dataset: Path, tmp_path: Path, tally: Tally
):
    generate(DatasetConfig(system="pendulum", count=12), tmp_path / "first", executor=two)
    workers = ray_workers()
    assert workers
    killer = threading.Timer(0.3, lambda: [os.kill(worker, signal.SIGKILL) for worker in workers])
    killer.start()
    generate(DatasetConfig(system="pendulum", count=6000), tmp_path / "data", executor=two)
    killer.join()
    for path in sorted(dataset.glob("*.*s*")):
        tally.expect(tmp_path / "data" / path.name, path.read_bytes())


def ray_workers() -> list[int]:
    """Return the processes on this machine that are idle workers of Ray of this test."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            name = (entry / "cmdline").read_bytes().split(b"\0")[0]
            ours = f"executor_owner={os.getpid()}".encode()
            if name.startswith(b"ray::") and ours in (entry / "environ").read_bytes():
                found.append(int(entry.name))
        except OSError:
            continue
    return [process for process in found if b"Agent" not in cmdline(process)]


def cmdline(process: int) -> bytes:
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""


@pytest.fixture(scope="module", autouse=True)
def owner() -> Iterator[None]:
    """Mark the processes this module starts, and let them find the tests' tasks."""
    with pytest.MonkeyPatch.context() as changed:
        changed.setenv("PYTHONPATH", os.pathsep.join(sys.path))
        changed.setenv("executor_owner", str(os.getpid()))
        yield


def test_a_cluster_that_does_not_answer_is_said_before_anything_starts():
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'neuroanimator[ray]'")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        for address in (f"ray://127.0.0.1:{port}", f"127.0.0.1:{port}"):
            with pytest.raises(ResourceError, match=f"No Ray cluster answers at {address}. Start"):
                chosen_executor(address, None)


@pytest.mark.parametrize("name", ["rey", "ray://", "ray://host", "host:0", "ray://me@host:1"])
def test_an_address_that_is_none_is_refused(name: str):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'neuroanimator[ray]'")
    with pytest.raises(ArgumentError, match="executor: wanted local, ray, ray://HOST:PORT or HOST"):
        chosen_executor(name, None)


def test_without_ray_the_line_that_installs_it_is_said(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ResourceError, match="pip install 'neuroanimator\\[ray\\]'"):
        chosen_executor("ray", None)
