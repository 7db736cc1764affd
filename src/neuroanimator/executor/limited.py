"""One call in a process of its own, with limits and without files: a C library that parses a stranger's data may crash it."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.executor.executor import LostTaskError
from neuroanimator.executor.local import WorkerProcess
from neuroanimator.executor.worker import pack

Result = TypeVar("Result")

WALL_SECONDS = 30
"""Ratio of a call's limit of wall time to that of processor time: the machine may be shared by dozens of programs."""


class ProcessLimits(NamedTuple):
    """Limits of a call's memory and time. It can open no file, either."""

    memory: int
    """Maximum memory its process allocates [bytes]."""
    seconds: int
    """Maximum processor time, including the start of its process [s]."""


class LimitError(NeuroAnimatorError):
    """A call exceeded its limits, or ended its process; the message continues after the name of the call."""


@dataclass(frozen=True)
class _Call:
    """The call the process makes."""

    function: Callable[[Any], Any]
    argument: Any
    limits: ProcessLimits


def call_limited(function: Callable[[Any], Result], argument: Any, limits: ProcessLimits) -> Result:
    """Return `function(argument)`, computed in a new process within `limits`; raise what that raises.

    The function is importable; it, the argument and the result can be pickled. It gets all it needs by its argument: no file
    can be opened in that process. Raises LimitError where the process exceeded its limits or crashed, and ResourceError
    where it cannot be started.
    """
    process = WorkerProcess(threads=1)
    try:
        process.give(pack(_call_here, _Call(function, argument, limits)))
        if not process.connection.poll(WALL_SECONDS * limits.seconds):
            raise LimitError(_too_long(limits))
        answer = process.answer()
    except LostTaskError:
        if process.popen.returncode == -signal.SIGXCPU:
            raise LimitError(_too_long(limits)) from None
        raise LimitError(f"crashes, or {_too_much(limits)}") from None
    finally:
        process.end()
    if answer.error is not None:
        raise answer.error
    return answer.result


def _too_long(limits: ProcessLimits) -> str:
    return f"takes more than {limits.seconds} s"


def _too_much(limits: ProcessLimits) -> str:
    return f"takes more than {limits.memory / 2**30:g} GB of memory"


def _call_here(call: _Call) -> Any:
    """Limit this process for good, and return what the call returns."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)  # for what a library prints as it ends
    _limit(resource.RLIMIT_CORE, 0)
    limit_processor_time(call.limits.seconds)
    _limit(resource.RLIMIT_DATA, call.limits.memory)
    _limit(resource.RLIMIT_NOFILE, 0)
    try:
        return call.function(call.argument)
    except MemoryError:
        raise LimitError(_too_much(call.limits)) from None


def limit_processor_time(seconds: int) -> None:
    """End this process by SIGXCPU once it has taken so much processor time [s]."""
    _limit(resource.RLIMIT_CPU, seconds)


def _limit(what: int, most: int) -> None:
    """Limit a resource of this process, to no more than it may have already."""
    _, hard = resource.getrlimit(what)
    if hard != resource.RLIM_INFINITY:
        most = min(most, hard)
    resource.setrlimit(what, (most, hard))
