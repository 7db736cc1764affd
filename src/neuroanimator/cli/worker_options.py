"""Options of the verbs that work in several processes or on a cluster."""

from __future__ import annotations

from typing import Annotated

import typer

from neuroanimator.errors import ArgumentError
from neuroanimator.executor.cores import core_count
from neuroanimator.executor.executor import Executor
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.text import quoted

LOCAL = "local"
"""The name of processes of this machine."""

RAY = "ray"
"""The name of a Ray cluster that is started on this machine."""

Where = Annotated[
    str,
    typer.Option(
        "--executor", help="Where: local; ray starts Ray here; ray://HOST:PORT joins a cluster."
    ),
]
"""The option `--executor`."""

Workers = Annotated[
    int | None,
    typer.Option(help="Processes that work at a time; the results do not depend on it."),
]
"""The option `--workers`."""


def chosen_executor(where: str, workers: int | None, threads: int | None = None) -> Executor:
    """Return the executor these options choose.

    `local` is this process, or so many `workers`; `ray` a Ray cluster of this machine, and an address the cluster that is
    there, both with one thread for each worker unless `threads` says more. `threads`: none, or 0, for as many as make all
    cores busy.
    """
    if threads is not None and threads < 0:
        raise ArgumentError(f"threads: wanted 1 or more, or 0 for all cores; came {threads}.")
    cores = core_count()
    if where == LOCAL:
        count = 1 if workers is None else workers
        return LocalExecutor(count, threads or max(1, cores // max(1, count)))
    if where != RAY and ":" not in where:
        raise ArgumentError(
            f"executor: wanted {LOCAL}, {RAY}, ray://HOST:PORT or HOST:PORT, came {quoted(where)}."
        )
    from neuroanimator.executor.ray_cluster import RayExecutor

    threads = threads or 1
    if where == RAY:
        return RayExecutor(None, workers or max(1, cores // threads), threads)
    return RayExecutor(where, 1, threads)
