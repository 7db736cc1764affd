"""Tasks that workers of the tests compute: some die, hang or complain."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from neuroanimator.errors import BadFileError


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
