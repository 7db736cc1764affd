"""The work of a worker, in a process of this machine or in one of a cluster."""

from __future__ import annotations

import pickle
import traceback
from collections.abc import Callable
from typing import Any, NamedTuple

from neuroanimator.errors import NeuroAnimatorError, ResourceError
from neuroanimator.text import printable

THREAD_VARIABLES = (
    "NPROC",  # all of XLA's own threads
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NEUROANIMATOR_CORES",
)
"""Environment variables with the number of threads that libraries may start."""


class Answer(NamedTuple):
    """The result of a task, or its error."""

    result: Any
    error: NeuroAnimatorError | None
    trace: str
    """Traceback of an unforeseen error; empty otherwise."""


def worker_environment(threads: int) -> dict[str, str]:
    """Return the environment variables of a worker of `threads` threads, whose JAX runs on the processor."""
    return {name: str(threads) for name in THREAD_VARIABLES} | {"JAX_PLATFORMS": "cpu"}


def pack(function: Callable[[Any], Any], task: Any) -> bytes:
    """Return a call as bytes, for `perform`."""
    return pickle.dumps((function, task))


def perform(call: bytes) -> Answer:
    """Compute a packed call; anything it raises comes back as an error."""
    try:
        function, task = pickle.loads(call)
        return Answer(function(task), None, "")
    except NeuroAnimatorError as error:
        return Answer(None, error, "")
    except MemoryError:
        return Answer(None, ResourceError("out of memory. Use fewer workers."), "")
    except Exception as error:
        line = " ".join(f"{type(error).__name__}: {error}".split())
        return Answer(None, NeuroAnimatorError(printable(line)), traceback.format_exc())
