"""Tasks on a Ray cluster, one that is started here or one that is there already.

Ray hands tasks to nodes, starts workers, computes the tasks of those that died again, and takes nodes in that join later.
What is done here is the rest: one line for each thing that can be wrong, equal versions everywhere, and no more tasks
under way than keep the nodes busy.
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from neuroanimator.errors import ArgumentError, ResourceError
from neuroanimator.executor.executor import (
    MAX_RETRIES,
    Executor,
    Outcome,
    Result,
    check_function,
    lost,
)
from neuroanimator.executor.local import outcome_of
from neuroanimator.executor.versions import difference, installed_versions, machine_name
from neuroanimator.executor.worker import Answer, pack, perform_within, worker_environment
from neuroanimator.text import printable, quoted

CLIENT = "ray://"
"""Prefix of the address of a Ray client's server, as Ray writes it."""

HOW_TO_GET_RAY = "--executor ray: Ray is not installed. pip install 'neuroanimator[ray]'"

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",  # nothing is told to anybody
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    "RAY_DISABLE_IMPORT_WARNING": "1",
}
"""Ray's environment variables that keep it from talking."""

CONNECT_SECONDS = 5.0
"""A cluster that does not answer within this time cannot be reached [s]."""

PROBE_SECONDS = 60.0
"""A node starts a worker and imports this package within this time [s]."""

LOOK_PERIOD = 1.0
"""Interval between looks at whether the head is there and whether nodes have joined [s]."""

LOST_AFTER = 5
"""Number of times in a row without an answer after which the head is lost."""

AHEAD = 2
"""Number of tasks under way for each place to compute: one is computed while the next is sent."""

MAX_SAID = 160
"""Characters of what Ray says that are quoted."""


class RayExecutor(Executor):
    """The workers of a Ray cluster.

    Without an `address` a cluster of this machine alone is started, which ends with the executor. With one,
    `ray://HOST:PORT` or, on a node, `HOST:PORT`, that cluster is joined. Raises ArgumentError and ResourceError where
    that does not work, and where a node has other versions than are here.
    """

    def __init__(self, address: str | None = None, workers: int = 1, threads: int = 1):
        if workers < 1:
            raise ArgumentError(f"workers: wanted 1 or more, came {workers}.")
        self.workers = workers
        self.threads = threads
        self.shares_disk = address is None
        os.environ.update({name: os.environ.get(name, value) for name, value in QUIET.items()})
        self._ray = _imported_ray()
        if address is not None and _has_token():
            _show_token()
        self._address = address
        self._head: tuple[str, int] | None = None
        self._silences = 0
        self._looked = time.monotonic()
        _silence(self._ray)
        if address is None:
            self._start()
        else:
            self._join(address)
        try:
            self._check_nodes()
        except BaseException:
            self.close()
            raise

    def outcomes(
        self, function: Callable[[Any], Result], tasks: Sequence[Any], *, longest: float
    ) -> Iterator[Outcome[Result]]:
        """Yield how each task ended, as soon as it has."""
        check_function(function)
        remote = self._ray.remote(perform_on_node).options(
            num_cpus=self.threads, max_retries=MAX_RETRIES
        )
        environment = worker_environment(self.threads)
        versions = installed_versions()
        waiting = deque(range(len(tasks)))
        under_way: dict[Any, int] = {}
        try:
            while waiting or under_way:
                while waiting and len(under_way) < AHEAD * self.workers:
                    index = waiting.popleft()
                    call = pack(function, tasks[index])
                    under_way[remote.remote(call, longest, environment, versions)] = index
                ready = self._ready(list(under_way))
                for reference in ready:
                    index = under_way.pop(reference)
                    yield self._outcome(index, tasks[index].label, reference, longest)
        finally:
            for reference in under_way:
                with contextlib.suppress(Exception):  # the cluster may be gone
                    self._ray.cancel(reference, force=True)

    def close(self) -> None:
        with contextlib.suppress(Exception):  # the cluster may be gone
            self._ray.shutdown()

    def _start(self) -> None:
        self._check_unused()
        with _one_line("Ray could not be started here"), warnings.catch_warnings():
            # Ray's processes are new programs at once, which JAX's threads cannot disturb.
            warnings.filterwarnings("ignore", "os.fork", RuntimeWarning)
            self._ray.init(
                address="local",
                num_cpus=self.workers * self.threads,
                include_dashboard=False,
                **self._arguments(),
            )
        self._find_head()

    def _join(self, address: str) -> None:
        host, port = _host_and_port(address)
        if not _answers(host, port, CONNECT_SECONDS):
            raise ResourceError(
                f"No Ray cluster answers at {printable(address)}. Start one with 'ray start --head', or check the address."
            )
        self._check_unused()
        refused = f"The Ray cluster at {printable(address)} does not let this process in; its RAY_AUTH_TOKEN may be wanted"
        with _one_line(refused):
            self._ray.init(address=address, **self._arguments())
        if address.startswith(CLIENT):
            self._head = (host, port)
        else:
            self._find_head()
        self._count_workers()

    def _arguments(self) -> dict[str, Any]:
        """Return the arguments of `ray.init` that keep Ray from talking, and the present folder off its workers' path."""
        quiet = {"log_to_driver": False, "configure_logging": False, "logging_level": "ERROR"}
        if self._address is not None and self._address.startswith(CLIENT):
            return quiet  # a client's folder is nowhere put on a path
        job = self._ray.job_config.JobConfig()
        # No public name: it may move. Else Ray puts the folder first on `sys.path`; see `python_command`.
        job._client_job = True
        return {"job_config": job, **quiet}

    def _check_unused(self) -> None:
        if self._ray.is_initialized():
            raise ResourceError("Ray runs in this process already. Call ray.shutdown() before.")

    def _find_head(self) -> None:
        self._head = _host_and_port(self._ray.get_runtime_context().gcs_address)

    def _count_workers(self) -> None:
        """Take nodes that have joined, or left, into account."""
        if self._address is None:
            return
        cores = self._ray.cluster_resources().get("CPU", 0)
        self.workers = max(1, int(cores) // self.threads)

    def _check_nodes(self) -> None:
        """Raise ResourceError if a node has other versions than this process, or not this package at all."""
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        ray = self._ray
        probes = []
        nodes = [node for node in ray.nodes() if node["Alive"]]
        for node in nodes:
            there = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
            remote = ray.remote(installed_versions).options(num_cpus=0, scheduling_strategy=there)
            probes.append(remote.remote())
        for node, probe in zip(nodes, probes, strict=True):
            name = printable(str(node.get("NodeManagerHostname", "a node")))
            with _one_line(f"The node {name} cannot compute: is neuroanimator installed there"):
                found = ray.get(probe, timeout=PROBE_SECONDS)
            _check_versions(installed_versions(), found, name)

    def _ready(self, references: list[Any]) -> list[Any]:
        """Return what is ready of `references`, once anything is; ResourceError if the head is lost meanwhile."""
        while True:
            self._look_after_cluster()
            with _one_line("The Ray cluster is lost. Started again, it goes on where it stopped"):
                ready, _ = self._ray.wait(references, timeout=LOOK_PERIOD)
            if ready:
                return ready

    def _look_after_cluster(self) -> None:
        now = time.monotonic()
        if self._head is None or now - self._looked < LOOK_PERIOD:
            return
        self._looked = now
        if _answers(*self._head, LOOK_PERIOD):
            self._silences = 0
            self._count_workers()
            return
        self._silences += 1
        if self._silences >= LOST_AFTER:
            raise ResourceError(
                "The head of the Ray cluster is lost. Started again, it goes on where it stopped."
            )

    def _outcome(self, index: int, label: str, reference: Any, longest: float) -> Outcome[Any]:
        """Return how a task ended that is ready."""
        errors = self._ray.exceptions
        why = f"its worker died, or took longer than {longest:g} s"
        try:
            answer: Answer = self._ray.get(reference)
        except errors.OutOfMemoryError:
            return Outcome(index, error=lost(label, "its worker ran out of memory"))
        except (errors.WorkerCrashedError, errors.NodeDiedError, errors.ObjectLostError):
            return Outcome(index, error=lost(label, why))
        except errors.RayError as error:
            said = _short(error)
            return Outcome(index, error=ResourceError(f"{label}: Ray could not compute it: {said}"))
        return outcome_of(index, label, answer)


def perform_on_node(
    call: bytes, longest: float, environment: dict[str, str], versions: dict[str, str]
) -> Answer:
    """Compute a packed call in a worker of Ray, which may have joined after the others were checked."""
    os.environ.update(environment)
    try:
        _check_versions(versions, installed_versions(), machine_name())
    except ResourceError as error:
        return Answer(None, error, "")
    return perform_within(call, longest)


def _check_versions(here: dict[str, str], there: dict[str, str], name: str) -> None:
    other = difference(here, there)
    if other:
        raise ResourceError(
            f"The node {name} has {other}: its bytes might differ. Install the same version on every node."
        )


def _imported_ray() -> ModuleType:
    try:
        import ray
        import ray.exceptions
    except ImportError as error:
        raise ResourceError(HOW_TO_GET_RAY) from error
    return ray


def _has_token() -> bool:
    """Return whether there is a token that clusters may want, where Ray looks for it."""
    stated = os.environ.get("RAY_AUTH_TOKEN") or os.environ.get("RAY_AUTH_TOKEN_PATH")
    return bool(stated) or (Path.home() / ".ray" / "auth_token").is_file()


def _show_token() -> None:
    """Let Ray show its token to the cluster: it does so by itself only where it finds the cluster itself."""
    os.environ.setdefault("RAY_AUTH_MODE", "token")
    with contextlib.suppress(ImportError, AttributeError):  # no public name: it may move
        from ray._raylet import Config

        Config.initialize("")  # it has read the mode already, if anybody imported Ray before


def _silence(ray: ModuleType) -> None:
    """Keep Ray from printing pages about each worker that died, on stdout: what matters comes as an error."""
    logging.getLogger("ray").setLevel(logging.CRITICAL)
    with contextlib.suppress(AttributeError):  # no public name: it may move
        ray._private.worker.print_to_stdstream = _print_nothing


def _print_nothing(data: object, ignore_prefix: bool) -> None:
    """Stand in for what Ray prints with."""


def _host_and_port(address: str) -> tuple[str, int]:
    """Return (host, port) of an address; ArgumentError if it is none."""
    host, _, port = address.removeprefix(CLIENT).rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 2**16 or set(host) & set("/@?#"):
        raise ArgumentError(
            f"executor: wanted local, ray, ray://HOST:PORT or HOST:PORT, came {quoted(address)}."
        )
    return host.strip("[]"), int(port)


def _answers(host: str, port: int, seconds: float) -> bool:
    try:
        socket.create_connection((host, port), seconds).close()
    except OSError:
        return False
    return True


@contextlib.contextmanager
def _one_line(what: str) -> Iterator[None]:
    """Make a ResourceError of any error Ray raises: `what` failed, and what Ray says of it."""
    try:
        yield
    except Exception as error:
        raise ResourceError(f"{what}: {_short(error)}") from error


def _short(error: Exception) -> str:
    """Return what Ray says, in one line: of a stack of errors the first line, of a mismatch of versions all versions."""
    lines = [" ".join(line.split()) for line in str(error).splitlines() if line.strip()]
    said = " ".join(lines)
    if "mismatch" not in said:
        said = lines[0] if lines else type(error).__name__
    return printable(said[:MAX_SAID]).rstrip(".") + "."
