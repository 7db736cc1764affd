"""Tasks that workers of the tests compute: some die, hang or complain."""

from __future__ import annotations

import os
import pickle
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neuroanimator.errors import BadFileError
from neuroanimator.executor.executor import Executor, Outcome, Result
from neuroanimator.executor.local import outcome_of
from neuroanimator.executor.worker import pack, perform
from neuroanimator.executor.worker_process import packed


class PackedHere(Executor):
    """Tasks go to a worker and back as bytes, as they do between processes, and stay in this one: it knows JAX already."""

    workers = 1
    threads = 1
    shares_disk = True

    def outcomes(
        self, function: Callable[[Any], Result], tasks: Sequence[Any], *, longest: float
    ) -> Iterator[Outcome[Result]]:
        for index, task in enumerate(tasks):
            answer = pickle.loads(packed(perform(pack(function, task))))
            yield outcome_of(index, task.label, answer)

    def close(self) -> None:
        """There is nothing to end."""


@dataclass(frozen=True)
class Square:
    """The square of a number, after some seconds."""

    number: int
    seconds: float = 0.0
    fault: str = ""
    """What happens before: `dies`, `dies once`, `hangs once`, `complains` or `breaks`."""
    mark: str = ""
    """A file that says that it has happened."""

    @property
    def label(self) -> str:
        return f"number {self.number}"


def square(task: Square) -> int:
    time.sleep(task.seconds)
    if task.fault == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    if task.fault == "complains":
        raise BadFileError("it is damaged.")
    if task.fault == "breaks":
        raise RuntimeError("an error\nnobody foresaw")
    if task.fault.endswith("once") and not Path(task.mark).exists():
        Path(task.mark).touch()
        if task.fault == "dies once":
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(600)
    return task.number**2


def cores(task: Square) -> tuple[str, str, str, str]:
    names = ("NPROC", "OMP_NUM_THREADS", "NEUROANIMATOR_CORES", "JAX_PLATFORMS")
    first, second, third, fourth = (os.environ.get(name, "") for name in names)
    return first, second, third, fourth


def search_path(task: Square) -> list[str]:
    return sys.path
