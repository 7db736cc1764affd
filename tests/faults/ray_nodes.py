"""Ray clusters of several nodes on this machine, real raylets each, and what kills them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from neuroanimator.executor.ray_cluster import RayExecutor

KILL_AFTER = 3.0
"""Time from the work's beginning to a kill, and from each to the next [s]."""


SLOWED_PERIOD = 0.5
"""Period in which a slow node is stopped and goes on again [s]."""


@contextmanager
def cluster_of(nodes: int) -> Iterator[tuple[Any, RayExecutor]]:
    """Yield (cluster, executor): so many nodes of one processor each, the head among them."""
    from ray.cluster_utils import Cluster

    cluster = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
    try:
        for _ in range(nodes - 1):
            cluster.add_node(num_cpus=1)
        cluster.wait_for_nodes()
        with RayExecutor(cluster.address) as executor:
            yield cluster, executor
    finally:
        cluster.shutdown()


@contextmanager
def node_killed(cluster: Any) -> Iterator[list[str]]:
    """Kill a node with -9 while the block runs, and let another join then; yield the list of what was done."""
    done: list[str] = []

    def kill() -> None:
        kill_node(cluster)
        done.append("a node killed")
        if ended.wait(KILL_AFTER):
            return
        joined.append(_join(cluster.address))
        done.append("a node joined")

    joined: list[subprocess.Popen[bytes]] = []
    ended, timer = _begin(kill)
    try:
        yield done
    finally:
        ended.set()
        timer.join()
        for node in joined:
            os.killpg(node.pid, signal.SIGKILL)
            node.wait()


def kill_node(cluster: Any) -> None:
    """Kill a node that is not the head, and all that it started, with -9."""
    victim = next(iter(cluster.worker_nodes))
    for process in _tree(victim.all_processes["raylet"][0].process.pid):
        os.kill(process, signal.SIGKILL)


@contextmanager
def node_slowed(cluster: Any) -> Iterator[None]:
    """Stop what computes on a node for nine tenths of the time while the block runs."""
    raylet = next(iter(cluster.worker_nodes)).all_processes["raylet"][0].process.pid
    ended = threading.Event()

    def signal_workers(number: int) -> None:
        for process in _tree(raylet)[1:]:
            with suppress(ProcessLookupError):  # it has just ended
                os.kill(process, number)

    def slow_down() -> None:
        while not ended.is_set():
            signal_workers(signal.SIGSTOP)
            ended.wait(0.9 * SLOWED_PERIOD)
            signal_workers(signal.SIGCONT)
            ended.wait(0.1 * SLOWED_PERIOD)

    thread = threading.Thread(target=slow_down)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _join(address: str) -> subprocess.Popen[bytes]:
    """Start another node, as one does by hand."""
    words = ["start", "--address", address, "--num-cpus", "1", "--block"]
    return subprocess.Popen(
        [sys.executable, "-m", "ray.scripts.scripts", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _begin(kill: Any) -> tuple[threading.Event, threading.Thread]:
    ended = threading.Event()

    def run() -> None:
        if not ended.wait(KILL_AFTER):
            kill()

    thread = threading.Thread(target=run)
    thread.start()
    return ended, thread


def _tree(process: int) -> list[int]:
    """Return a process and all that it started."""
    found = [process]
    for children in Path(f"/proc/{process}/task").glob("*/children"):
        for word in children.read_text().split():
            found += _tree(int(word))
    return found


def busy(seconds: float) -> None:
    """Use this much time of a processor [s]."""
    began = time.thread_time()
    while time.thread_time() - began < seconds:
        sum(range(1000))
