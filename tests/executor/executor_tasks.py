"""Tasks that workers of the tests compute: some die or complain."""

from __future__ import annotations

import os
import pickle
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from neuroanimator.errors import BadFileError
from neuroanimator.executor.executor import Executor
from neuroanimator.executor.worker import Answer, perform
from neuroanimator.executor.worker_process import packed


class PackedHere(Executor):
    """Tasks go to a worker and back as bytes, as they do between processes, and stay in this one: it knows JAX already."""

    workers = 1
    threads = 1
    shares_disk = True

    def begin(self, packed_call: bytes) -> bytes:
        return packed(perform(packed_call))

    def wait(self, calls: list[bytes]) -> list[bytes]:
        return calls

    def answer(self, call: bytes) -> Answer:
        return pickle.loads(call)

    def cancel(self, call: bytes) -> None:
        """There is nothing to end."""

    def close(self) -> None:
        """There is nothing to end."""


@dataclass(frozen=True)
class Square:
    """The square of a number, after some seconds."""

    number: int
    seconds: float = 0.0
    fault: str = ""
    """What happens before: `dies`, `dies once`, `complains` or `breaks`."""
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
    if task.fault == "dies once" and not Path(task.mark).exists():
        Path(task.mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return task.number**2


def cores(task: Square) -> tuple[str, str, str, str]:
    names = ("NPROC", "OMP_NUM_THREADS", "NEUROANIMATOR_CORES", "JAX_PLATFORMS")
    first, second, third, fourth = (os.environ.get(name, "") for name in names)
    return first, second, third, fourth


def search_path(task: Square) -> list[str]:
    return sys.path


def process_id(task: Square) -> int:
    return os.getpid()
