"""The executor that a name on the command line means."""

from __future__ import annotations

from neuroanimator.errors import ArgumentError
from neuroanimator.executor.executor import Executor
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.text import quoted

LOCAL = "local"
"""The name of processes of this machine."""

RAY = "ray"
"""The name of a Ray cluster that is started on this machine."""


def open_executor(name: str, workers: int | None, threads: int | None, cores: int) -> Executor:
    """Return the executor called `name`, of so many workers with so many threads each.

    `local` is this process, or so many `workers`; `ray` a Ray cluster of this machine's `cores`, and an address
    the cluster that is there, both with one thread for each worker unless `threads` says more. `threads`: none, or 0,
    for as many as make all cores busy.
    """
    if threads is not None and threads < 0:
        raise ArgumentError(f"threads: wanted 1 or more, or 0 for all cores; came {threads}.")
    if name != LOCAL:
        return _on_ray(name, workers, threads or 1, cores)
    if workers is None:
        workers = 1
    if not threads:
        threads = max(1, cores // max(1, workers))
    return LocalExecutor(workers, threads)


def _on_ray(name: str, workers: int | None, threads: int, cores: int) -> Executor:
    if name != RAY and ":" not in name:
        raise ArgumentError(
            f"executor: wanted {LOCAL}, {RAY}, ray://HOST:PORT or HOST:PORT, came {quoted(name)}."
        )
    from neuroanimator.executor.ray_cluster import RayExecutor

    if name == RAY:
        return RayExecutor(None, workers or max(1, cores // threads), threads)
    return RayExecutor(name, 1, threads)
