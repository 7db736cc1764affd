"""Tasks on a Ray cluster, started here or already running.

Ray assigns tasks to nodes, starts workers, repeats the tasks of those that died, and uses nodes that join later.
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import warnings
from collections.abc import Iterator
from types import ModuleType
from typing import Any

from neuroanimator.errors import ArgumentError, ResourceError
from neuroanimator.executor.executor import Executor, LostTaskError
from neuroanimator.executor.worker import Answer, perform, worker_environment
from neuroanimator.text import printable, quoted

CLIENT = "ray://"
"""Prefix of the address of a Ray client's server, as Ray writes it."""

HOW_TO_GET_RAY = "--executor ray: Ray is not installed. pip install 'neuroanimator[ray]'"

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",  # no telemetry
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    "RAY_DISABLE_IMPORT_WARNING": "1",
}
"""Environment variables that keep Ray quiet."""

CONNECT_SECONDS = 5.0
"""Time within which a reachable cluster answers [s]."""

LOOK_PERIOD = 1.0
"""Interval between counts of a cluster's nodes [s]."""

MAX_SAID = 300
"""Maximum number of characters quoted from Ray's messages."""


class RayExecutor(Executor):
    """The workers of a Ray cluster.

    Without an `address`, a cluster on this machine alone is started, which ends with the executor. With one,
    `ray://HOST:PORT` or, on a node, `HOST:PORT`, that cluster is joined. Raises ArgumentError or ResourceError if that
    fails.
    """

    ahead = 2  # one is computed while the next is sent

    def __init__(self, address: str | None = None, workers: int = 1, threads: int = 1):
        if workers < 1:
            raise ArgumentError(f"workers: wanted 1 or more, got {workers}.")
        self.workers = workers
        self.threads = threads
        self.shares_disk = address is None
        os.environ.update({name: os.environ.get(name, value) for name, value in QUIET.items()})
        self._ray = _imported_ray()
        _silence(self._ray)
        if address is None:
            self._start()
        else:
            self._join(address)
        self._remote = self._ray.remote(perform_on_node).options(num_cpus=threads)

    def begin(self, packed_call: bytes) -> Any:
        return self._remote.remote(packed_call, worker_environment(self.threads))

    def wait(self, calls: list[Any]) -> list[Any]:
        with _one_line(
            "The Ray cluster is lost. Run the command again: it resumes where it stopped"
        ):
            ended, _ = self._ray.wait(calls, timeout=LOOK_PERIOD)
            self._count_workers()
        return ended

    def answer(self, call: Any) -> Answer:
        errors = self._ray.exceptions
        try:
            return self._ray.get(call)
        except (errors.OutOfMemoryError, errors.WorkerCrashedError, errors.NodeDiedError) as error:
            raise LostTaskError(f"its worker died: {_short(error)}") from error
        except errors.RayError as error:
            raise ResourceError(f"Ray could not compute it: {_short(error)}") from error

    def cancel(self, call: Any) -> None:
        with contextlib.suppress(Exception):  # the cluster may be gone
            self._ray.cancel(call, force=True)

    def close(self) -> None:
        with contextlib.suppress(Exception):  # the cluster may be gone
            self._ray.shutdown()

    def _start(self) -> None:
        with _one_line("Ray could not be started here"), warnings.catch_warnings():
            # Ray's processes exec at once, so JAX's threads cannot disturb them.
            warnings.filterwarnings("ignore", "os.fork", RuntimeWarning)
            self._ray.init(
                address="local",
                num_cpus=self.workers * self.threads,
                include_dashboard=False,
                job_config=self._job(),
                **TALKS_LITTLE,
            )

    def _join(self, address: str) -> None:
        host, port = _host_and_port(address)
        try:  # Ray itself tries for minutes, and may end this process
            socket.create_connection((host, port), CONNECT_SECONDS).close()
        except OSError as error:
            raise ResourceError(
                f"No Ray cluster answers at {printable(address)}. Start one with 'ray start --head', or check the address."
            ) from error
        # A client's folder is put on no path.
        job = None if address.startswith(CLIENT) else self._job()
        with _one_line(
            f"The Ray cluster at {printable(address)} does not let this process in; "
            "RAY_AUTH_MODE=token and its RAY_AUTH_TOKEN may be needed"
        ):
            self._ray.init(address=address, job_config=job, **TALKS_LITTLE)
            self._count_workers()

    def _job(self) -> Any:
        """Return a job whose workers do not have the current folder first on `sys.path`; see `python_command`."""
        job = self._ray.job_config.JobConfig()
        job._client_job = True  # no public name: it may move
        return job

    def _count_workers(self) -> None:
        """Account for nodes that have joined or left."""
        if not self.shares_disk:
            cores = self._ray.cluster_resources().get("CPU", 0)
            self.workers = max(1, int(cores) // self.threads)


TALKS_LITTLE = {"log_to_driver": False, "configure_logging": False, "logging_level": "ERROR"}
"""Arguments of `ray.init` that keep Ray quiet."""


def perform_on_node(packed_call: bytes, environment: dict[str, str]) -> Answer:
    """Compute a packed call in a Ray worker."""
    os.environ.update(environment)
    return perform(packed_call)


def _imported_ray() -> ModuleType:
    try:
        import ray
        import ray.exceptions
    except ImportError as error:
        raise ResourceError(HOW_TO_GET_RAY) from error
    return ray


def _silence(ray: ModuleType) -> None:
    """Keep Ray from printing pages about each worker that died, on stdout: what matters comes as an error."""
    logging.getLogger("ray").setLevel(logging.CRITICAL)
    with contextlib.suppress(AttributeError):  # no public name: it may move
        ray._private.worker.print_to_stdstream = _print_nothing


def _print_nothing(data: object, ignore_prefix: bool) -> None:
    """Replace Ray's printing function."""


def _host_and_port(address: str) -> tuple[str, int]:
    """Return (host, port) of an address; ArgumentError if it is not one."""
    host, _, port = address.removeprefix(CLIENT).rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 2**16 or set(host) & set("/@?#"):
        raise ArgumentError(
            f"executor: wanted local, ray, ray://HOST:PORT or HOST:PORT, got {quoted(address)}."
        )
    return host.strip("[]"), int(port)


@contextlib.contextmanager
def _one_line(what: str) -> Iterator[None]:
    """Turn any error of Ray into a ResourceError: `what` failed, and Ray's message."""
    try:
        yield
    except Exception as error:
        raise ResourceError(f"{what}: {_short(error)}") from error


def _short(error: Exception) -> str:
    """Return the beginning of Ray's message, in one line."""
    said = " ".join(str(error).split()) or type(error).__name__
    return printable(said[:MAX_SAID]).rstrip(".") + "."
