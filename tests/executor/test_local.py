"""Processes of this machine give what one process gives, whatever happens to them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator

import pytest
from executor_tasks import Square, cores, square
from processes import children
from waiting import wait_until

from neuroanimator.errors import ArgumentError, BadFileError, NeuroAnimatorError
from neuroanimator.executor.executor import Executor, LostTaskError, Outcome
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.files.unfinished import is_running

NUMBERS = range(6)


@pytest.fixture(scope="module")
def two() -> Iterator[Executor]:
    with LocalExecutor(2) as executor:
        yield executor


def test_results_come_in_the_order_of_the_tasks_however_long_each_takes(two: Executor):
    tasks = [Square(number, seconds=0.05 * (5 - number)) for number in NUMBERS]
    ended: list[int] = []
    found = two.map(square, tasks, on_done=lambda outcome: ended.append(outcome.index))
    assert found == LocalExecutor(1).map(square, tasks) == [n**2 for n in NUMBERS]
    assert sorted(ended) == list(NUMBERS)
    assert ended != list(NUMBERS)


def test_no_tasks_are_no_results(two: Executor):
    assert two.map(square, []) == []


def test_workers_use_the_threads_they_may_and_no_graphics_card(two: Executor):
    assert two.map(cores, [Square(0)]) == [("1", "1", "1", "cpu")]


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_names_its_task_and_the_others_end(workers: int):
    tasks = [Square(n, fault="complains" if n in (2, 4) else "") for n in NUMBERS]
    ended: list[Outcome[int]] = []
    with LocalExecutor(workers) as executor, pytest.raises(BadFileError) as raised:
        executor.map(square, tasks, on_done=ended.append)
    assert str(raised.value) == "number 2: it is damaged. 2 of 6 tasks failed."
    results = sorted(outcome.value() for outcome in ended if outcome.error is None)
    assert results == [0, 1, 9, 25]


def test_what_nobody_foresaw_is_said_in_one_line(two: Executor):
    with pytest.raises(NeuroAnimatorError) as raised:
        two.map(square, [Square(0, fault="breaks")])
    assert str(raised.value) == "number 0: RuntimeError: an error nobody foresaw"


def test_f05_a_task_whose_worker_dies_is_told_and_the_others_end(two: Executor):
    tasks = [Square(n, fault="dies" if n == 1 else "") for n in NUMBERS]
    ended: list[Outcome[int]] = []
    with pytest.raises(LostTaskError, match="number 1: its worker died of signal 9. Use"):
        two.map(square, tasks, on_done=ended.append)
    assert len(ended) == len(NUMBERS)


def test_who_stops_asking_ends_what_is_on_its_way():
    others = set(children(os.getpid()))
    with LocalExecutor(2) as executor:
        tasks = [Square(0), Square(1, seconds=600), Square(2, seconds=600)]
        outcomes = executor.outcomes(square, tasks)
        assert next(outcomes).value() == 0
        workers = set(children(os.getpid())) - others
        assert len(workers) == 2
        outcomes.close()  # pyright: ignore[reportAttributeAccessIssue]
        assert not any(is_running(process) for process in workers)
        assert executor.map(square, [Square(3)]) == [9]


STARTED = """
import os, sys
from executor_tasks import Square, process_id
from neuroanimator.executor.local import LocalExecutor
executor = LocalExecutor(2)
print(*executor.map(process_id, [Square(0), Square(1)]), flush=True)
os.kill(os.getpid(), 9)
"""


def test_workers_end_with_the_process_that_started_them():
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    started = subprocess.run([sys.executable, "-c", STARTED], capture_output=True, env=environment)
    processes = [int(word) for word in started.stdout.split()]
    assert len(processes) == 2
    wait_until(lambda: not any(is_running(process) for process in processes))


def test_a_function_that_cannot_be_imported_is_refused(two: Executor):
    with pytest.raises(ArgumentError, match="wanted one that workers can import"):
        two.map(lambda task: task, [Square(0)])


@pytest.mark.parametrize("workers", [0, -1, 5000])
def test_a_number_of_workers_nobody_can_have_is_refused(workers: int):
    with pytest.raises(ArgumentError, match=f"workers: wanted 1 to 1024, got {workers}"):
        LocalExecutor(workers)
