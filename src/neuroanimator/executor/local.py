"""Tasks in processes of this machine, or in this very process if one is all there is."""

from __future__ import annotations

import os
import pickle
import shlex
import socket
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from neuroanimator.errors import ArgumentError, NeuroAnimatorError, ResourceError
from neuroanimator.executor.executor import (
    MAX_RETRIES,
    Executor,
    Outcome,
    Result,
    check_function,
    lost,
    same_kind,
)
from neuroanimator.executor.python_command import python_command
from neuroanimator.executor.worker import Answer, pack, worker_environment
from neuroanimator.executor.worker_process import READY
from neuroanimator.storage.unfinished import folder_until_exit

WORKER = "neuroanimator.executor.worker_process"
"""The module that a worker runs."""

MAX_WORKERS = 1024
"""More processes on one machine are a mistake."""

PATIENCE = 5.0
"""Time an idle worker gets to end by itself [s]."""

LOOK_PERIOD = 1.0
"""Interval between checks of running tasks against the longest time they may take [s]."""


class LocalExecutor(Executor):
    """Executor of processes on this machine. One worker is this process itself: nothing is started.

    The processes are new ones, not forked: JAX and MuJoCo have threads, which a fork would lose. They are started when
    there is work, and end with this process however it ends.
    """

    shares_disk = True

    def __init__(self, workers: int = 1, threads: int = 1):
        if not 1 <= workers <= MAX_WORKERS:
            raise ArgumentError(f"workers: wanted 1 to {MAX_WORKERS}, came {workers}.")
        self.workers = workers
        self.threads = threads
        self._processes: list[WorkerProcess] = []

    def outcomes(
        self, function: Callable[[Any], Result], tasks: Sequence[Any], *, longest: float
    ) -> Iterator[Outcome[Result]]:
        """Yield the outcome of each task as soon as it has ended. With one worker tasks have no time limit."""
        check_function(function)
        if self.workers == 1:
            return _one_after_another(function, tasks)
        return self._spread(function, tasks, longest)

    def close(self) -> None:
        for process in self._processes:
            process.end(is_busy=process.index is not None)
        self._processes = []

    def process_ids(self) -> list[int]:
        """Return the ids of the processes that are there."""
        return [process.popen.pid for process in self._processes]

    def _spread(
        self, function: Callable[[Any], Result], tasks: Sequence[Any], longest: float
    ) -> Iterator[Outcome[Result]]:
        waiting = deque(range(len(tasks)))
        retries: Counter[int] = Counter()
        try:
            while waiting or self._busy:
                self._hand_out(function, tasks, waiting)
                outcomes = []
                for process in self._ended(longest):
                    index = process.take_index()
                    answer = process.take_answer()
                    if answer is not None:
                        outcomes.append(outcome_of(index, tasks[index].label, answer))
                        continue
                    self._processes.remove(process)
                    retries[index] += 1
                    if retries[index] <= MAX_RETRIES:
                        waiting.appendleft(index)
                    else:
                        outcomes.append(
                            Outcome(index, error=lost(tasks[index].label, process.fate))
                        )
                # Before these are looked at, which takes time, too: a shard is written then.
                self._hand_out(function, tasks, waiting)
                yield from outcomes
        finally:
            for process in self._busy:
                self._processes.remove(process)
                process.end(is_busy=True)

    def _hand_out(
        self, function: Callable[[Any], Result], tasks: Sequence[Any], waiting: deque[int]
    ) -> None:
        """Give tasks that are waiting to workers that have nothing to do."""
        while waiting and len(self._busy) < self.workers:
            index = waiting.popleft()
            self._idle_process().give(index, pack(function, tasks[index]))

    @property
    def _busy(self) -> list[WorkerProcess]:
        return [process for process in self._processes if process.index is not None]

    def _idle_process(self) -> WorkerProcess:
        """Return a process that has nothing to do; a new one if there is none."""
        for process in self._processes:
            if process.index is None:
                return process
        process = WorkerProcess.started(self.threads)
        self._processes.append(process)
        return process

    def _ended(self, longest: float) -> list[WorkerProcess]:
        """Return the busy processes that have answered, died or hung, once there are any."""
        while True:
            by_connection = {process.connection: process for process in self._busy}
            ready = wait(list(by_connection), timeout=LOOK_PERIOD)
            ended = []
            for connection in ready:
                process = by_connection[connection]  # pyright: ignore[reportArgumentType]
                if process.hear():
                    ended.append(process)
            for process in self._busy:
                if process not in ended and process.seconds > longest:
                    process.fate = f"its worker gave no answer for {longest:g} s"
                    process.end(is_busy=True)
                    ended.append(process)
            if ended:
                return ended


@dataclass(eq=False)
class WorkerProcess:
    """A worker, and the task it computes."""

    popen: subprocess.Popen[bytes]
    connection: Connection
    index: int | None = None
    answer: Answer | None = None
    fate: str = ""
    """The outcome of the task."""
    is_ready: bool = False
    began: float = field(default_factory=time.monotonic)
    """When it got its task [s]."""

    @classmethod
    def started(cls, threads: int) -> WorkerProcess:
        """Start a worker. ResourceError if the machine does not allow another process."""
        ours, theirs = socket.socketpair()
        environment = os.environ | worker_environment(threads)
        environment["PYTHONPATH"] = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
        number = theirs.fileno()
        command = python_command("-m", WORKER, str(number))
        try:
            environment["TMPDIR"] = str(_workers_folder())
            popen = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=environment,
                pass_fds=[number],
            )
        except OSError as error:
            raise ResourceError(f"Could not start a worker: {error.strerror}.") from error
        finally:
            theirs.close()
        return cls(popen, Connection(ours.detach()))

    @property
    def seconds(self) -> float:
        """Time since it got its task [s]."""
        return time.monotonic() - self.began

    def give(self, index: int, call: bytes) -> None:
        """Hand it a task; if it is dead already, that is heard like any later death."""
        self.index = index
        self.began = time.monotonic()
        try:
            self.connection.send_bytes(call)
        except OSError:
            return

    def take_index(self) -> int:
        """Return the task it had, and let it have none."""
        index = self.index
        assert index is not None
        self.index = None
        return index

    def take_answer(self) -> Answer | None:
        """Return what it said, once; None if it died or hung."""
        answer = self.answer
        self.answer = None
        return answer

    def hear(self) -> bool:
        """Take what it says; return whether it is done with its task, or dead."""
        try:
            said = self.connection.recv_bytes()
        except (EOFError, OSError):
            self._learn_fate()
            return True
        if said == READY:
            self.is_ready = True
            self.began = time.monotonic()
            return False
        self.answer = pickle.loads(said)
        return True

    def end(self, *, is_busy: bool) -> None:
        """End it: at once if it is busy, or else by saying that there is no more."""
        if is_busy:
            self.popen.kill()
        self.connection.close()
        try:
            self.popen.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            self.popen.wait()

    def _learn_fate(self) -> None:
        code = self.popen.wait()
        self.connection.close()
        if not self.is_ready:
            raise ResourceError(
                f"A child process ends as it starts (exit code {code}): '{shlex.join(python_command('-m', WORKER))}'. "
                "Free memory, or allow more processes."
            )
        how = f"with exit code {code}"
        if code < 0:
            how = f"of signal {-code}"
        self.fate = f"its worker died {how}"


@cache
def _workers_folder() -> Path:
    """Return the folder for the temporary files of workers: one that is ended at once leaves them to this process."""
    return folder_until_exit()


def _one_after_another(
    function: Callable[[Any], Result], tasks: Sequence[Any]
) -> Iterator[Outcome[Result]]:
    for index, task in enumerate(tasks):
        try:
            outcome = Outcome(index, function(task))
        except NeuroAnimatorError as error:
            outcome = Outcome(index, error=same_kind(error, f"{task.label}: {error}"))
        yield outcome


def outcome_of(index: int, label: str, answer: Answer) -> Outcome[Any]:
    """Return the outcome of a task from its worker's answer: errors name the task."""
    if answer.error is None:
        return Outcome(index, answer.result)
    if answer.trace and os.environ.get("NEUROANIMATOR_DEBUG"):
        sys.stderr.write(answer.trace)
    return Outcome(index, error=same_kind(answer.error, f"{label}: {answer.error}"))
