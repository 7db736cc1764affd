"""Options of the verbs that work in several processes or on a cluster."""

from __future__ import annotations

from typing import Annotated

import typer

from neuroanimator.codegen.cores import core_count
from neuroanimator.errors import ArgumentError
from neuroanimator.executor.executor import Executor
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.text import quoted

LOCAL = "local"
"""Name of processes on this machine."""

RAY = "ray"
"""Name of a Ray cluster started on this machine."""

Where = Annotated[
    str,
    typer.Option(
        "--executor",
        help="Where to run: local; ray starts Ray here; ray://HOST:PORT joins a cluster.",
    ),
]
"""The option `--executor`."""

Workers = Annotated[
    int | None,
    typer.Option(help="Number of parallel processes; the results do not depend on it."),
]
"""The option `--workers`."""


def chosen_executor(where: str, workers: int | None, threads: int | None = None) -> Executor:
    """Return the executor that these options choose.

    `local` is this process, or a number of `workers` processes; `ray` is a Ray cluster on this machine, and an address an
    existing cluster, both with one thread per worker unless `threads` says more. `threads` None or 0 means as many as keep
    all cores busy.
    """
    if threads is not None and threads < 0:
        raise ArgumentError(f"threads: wanted 1 or more, or 0 for all cores; got {threads}.")
    cores = core_count()
    if where == LOCAL:
        count = 1 if workers is None else workers
        return LocalExecutor(count, threads or max(1, cores // max(1, count)))
    if where != RAY and ":" not in where:
        raise ArgumentError(
            f"executor: wanted {LOCAL}, {RAY}, ray://HOST:PORT or HOST:PORT, got {quoted(where)}."
        )
    from neuroanimator.executor.ray_cluster import RayExecutor

    threads = threads or 1
    if where == RAY:
        return RayExecutor(None, workers or max(1, cores // threads), threads)
    return RayExecutor(where, 1, threads)
