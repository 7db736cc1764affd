"""The executor that a name on the command line means."""

from __future__ import annotations

from neuroanimator.errors import ArgumentError
from neuroanimator.executor.executor import Executor
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.text import quoted

LOCAL = "local"
"""The name of processes of this machine."""


def open_executor(name: str, workers: int | None, threads: int | None, cores: int) -> Executor:
    """Return the executor called `name`, of so many workers with so many threads each.

    `workers`: none for one process. `threads`: none, or 0, for as many as make all of this machine's `cores` busy.
    """
    if name != LOCAL:
        raise ArgumentError(f"executor: wanted {LOCAL}, came {quoted(name)}.")
    if threads is not None and threads < 0:
        raise ArgumentError(f"threads: wanted 1 or more, or 0 for all cores; came {threads}.")
    if workers is None:
        workers = 1
    if not threads:
        threads = max(1, cores // max(1, workers))
    return LocalExecutor(workers, threads)
