"""Tasks in processes of this machine, or in this process if there is only one worker."""

from __future__ import annotations

import contextlib
import os
import pickle
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from neuroanimator.errors import ArgumentError, NeuroAnimatorError, ResourceError
from neuroanimator.executor.executor import (
    Executor,
    LostTaskError,
    Outcome,
    Result,
    check_function,
    failed_outcome,
)
from neuroanimator.executor.python_command import python_command
from neuroanimator.executor.worker import Answer, worker_environment
from neuroanimator.files.unfinished import folder_until_exit

WORKER = "neuroanimator.executor.worker_process"
"""Module that a worker runs."""

MAX_WORKERS = 1024
"""Maximum number of worker processes: more on one machine are a mistake."""


class LocalExecutor(Executor):
    """Executor of processes on this machine. A single worker is this process itself: nothing is started.

    The processes are new, not forked: a fork would lose the threads of JAX and MuJoCo. They are started when there is
    work, and end with this process however it ends. Those of `concurrent.futures` would import the user's script again,
    with the current folder first on their path, and all would be lost with one.
    """

    shares_disk = True

    def __init__(self, workers: int = 1, threads: int = 1):
        if not 1 <= workers <= MAX_WORKERS:
            raise ArgumentError(f"workers: wanted 1 to {MAX_WORKERS}, got {workers}.")
        self.workers = workers
        self.threads = threads
        self._idle: list[WorkerProcess] = []

    def outcomes(
        self, function: Callable[[Any], Result], tasks: Sequence[Any]
    ) -> Iterator[Outcome[Result]]:
        if self.workers == 1:
            check_function(function)
            return _one_after_another(function, tasks)
        return super().outcomes(function, tasks)

    def begin(self, packed_call: bytes) -> WorkerProcess:
        process = self._idle.pop() if self._idle else WorkerProcess(self.threads)
        process.give(packed_call)
        return process

    def wait(self, calls: list[WorkerProcess]) -> list[Any]:
        return wait(calls)  # pyright: ignore[reportArgumentType] - it asks them for their descriptors

    def answer(self, call: WorkerProcess) -> Answer:
        answer = call.answer()
        self._idle.append(call)
        return answer

    def cancel(self, call: WorkerProcess) -> None:
        call.end()

    def close(self) -> None:
        while self._idle:
            self._idle.pop().end()


class WorkerProcess:
    """A process that computes the packed calls it is given, one at a time."""

    def __init__(self, threads: int):
        """Start it. ResourceError if the machine does not allow another process."""
        ours, theirs = socket.socketpair()
        environment = os.environ | worker_environment(threads)
        environment["PYTHONPATH"] = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
        number = theirs.fileno()
        try:
            environment["TMPDIR"] = str(_workers_folder())
            self.popen = subprocess.Popen(
                python_command("-m", WORKER, str(number)),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=environment,
                pass_fds=[number],
            )
        except OSError as error:
            raise ResourceError(f"Could not start a worker: {error.strerror}.") from error
        finally:
            theirs.close()
        self.connection = Connection(ours.detach())

    def fileno(self) -> int:
        """Return the descriptor that can be read once it answers or is dead."""
        return self.connection.fileno()

    def give(self, packed_call: bytes) -> None:
        """Hand it a call; if it is dead already, its answer says so."""
        with contextlib.suppress(OSError):
            self.connection.send_bytes(packed_call)

    def answer(self) -> Answer:
        """Return its answer once it is there; LostTaskError if it died."""
        try:
            return pickle.loads(self.connection.recv_bytes())
        except (EOFError, OSError):
            code = self.popen.wait()
            self.connection.close()
        how = f"of signal {-code}" if code < 0 else f"with exit code {code}"
        raise LostTaskError(
            f"its worker died {how}. Use fewer workers or more memory, and run it again: it resumes where it stopped."
        )

    def end(self) -> None:
        """Kill it at once."""
        self.popen.kill()
        self.popen.wait()
        self.connection.close()


@cache
def _workers_folder() -> Path:
    """Return the folder for the temporary files of workers: a killed worker leaves them to this process."""
    return folder_until_exit()


def _one_after_another(
    function: Callable[[Any], Result], tasks: Sequence[Any]
) -> Iterator[Outcome[Result]]:
    for index, task in enumerate(tasks):
        try:
            outcome = Outcome(index, function(task))
        except NeuroAnimatorError as error:
            outcome = failed_outcome(index, task, error)
        yield outcome
