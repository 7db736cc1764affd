"""Real clusters of Ray on this machine: a node is killed and another joins, a client comes from outside."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from executor_tasks import Square, square
from processes import GENERATE, command, start
from ray_nodes import cluster_of, kill_node, node_killed, node_slowed
from tally import Tally
from waiting import PATIENCE, wait_until

from neuroanimator import DatasetConfig, generate
from neuroanimator.errors import ResourceError
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.executor.ray_cluster import RayExecutor
from neuroanimator.files.atomic import read_tensors
from neuroanimator.learn.evaluation.fleets.fleet_file import read_fleet
from neuroanimator.learn.evaluation.fleets.train_fleet import train_fleet
from neuroanimator.learn.training.checkpoint import NAME

pytest.importorskip("ray", reason="Ray is not installed: pip install 'neuroanimator[ray]'")

pytestmark = [pytest.mark.endurance, pytest.mark.filterwarnings("default")]

SIX_THOUSAND = DatasetConfig(system="pendulum", count=6000)


@pytest.fixture(scope="module", autouse=True)
def importable() -> Iterator[None]:
    """Let the workers find the tests' tasks."""
    with pytest.MonkeyPatch.context() as changed:
        changed.setenv("PYTHONPATH", os.pathsep.join(sys.path))
        yield


def test_f05_a_node_is_killed_and_another_joins(tally: Tally):
    tasks = [Square(number, seconds=1.0) for number in range(40)]
    with cluster_of(4) as (cluster, executor), node_killed(cluster) as done:
        assert executor.map(square, tasks) == [task.number**2 for task in tasks]
    assert done[0] == "a node killed"


def test_f05_a_slow_node_gets_less_to_do_and_holds_nobody_up(tally: Tally):
    tasks = [Square(number, seconds=0.2) for number in range(60)]
    with cluster_of(3) as (cluster, executor), node_slowed(cluster):
        began = time.monotonic()
        found = executor.map(square, tasks)
        seconds = time.monotonic() - began
    assert found == [task.number**2 for task in tasks]
    # A third of them on the slow node would take ten times 20 x 0.2 s; the two others need 6 s for all.
    assert seconds < 20


def test_f05_the_driver_is_killed_and_goes_on_where_it_was(tmp_path: Path, tally: Tally):
    words = (
        *GENERATE[:2],
        "--count",
        "30000",
        *GENERATE[4:6],
        "--executor",
        "ray",
        "--workers",
        "2",
    )
    many = DatasetConfig(system="pendulum", count=30_000)
    generate(many, tmp_path / "whole")
    folder = tmp_path / "data"
    driver = start(tmp_path, *words, "--out", folder)
    wait_until(lambda: made_shards(folder) or driver.poll() is not None)
    driver.kill()
    _, said = driver.communicate()
    shards = {path: path.stat().st_mtime_ns for path in made_shards(folder)}
    assert 0 < len(shards) < many.shards, said
    again = command(*words, "--out", folder)
    ended = subprocess.run(again, capture_output=True, text=True, timeout=PATIENCE)
    assert ended.returncode == 0, ended.stderr
    for path in sorted((tmp_path / "whole").glob("*.*s*")):
        tally.expect(folder / path.name, path.read_bytes())
    assert all(path.stat().st_mtime_ns == made for path, made in shards.items())


def made_shards(folder: Path) -> list[Path]:
    return list(folder.glob("shard-*.safetensors"))


def test_a_client_from_outside_gets_the_same_bytes(dataset: Path, tmp_path: Path, tally: Tally):
    client = free_port()
    with started(
        "--head", "--num-cpus", "2", "--port", free_port(), "--ray-client-server-port", client
    ):
        wait_for(client)
        with RayExecutor(f"ray://127.0.0.1:{client}") as executor:
            assert executor.workers == 2
            generate(SIX_THOUSAND, tmp_path, executor=executor)
    for path in sorted(dataset.glob("*.*s*")):
        tally.expect(tmp_path / path.name, path.read_bytes())


def test_f04_the_disk_of_one_node_is_full_and_nobody_minds(tmp_path: Path, tally: Tally):
    """What nodes make is sent to who asked: that one sees a disk of 64 kB, less than a shard, in the dataset's place."""
    folder = tmp_path / "data"
    folder.mkdir()
    small = [
        "unshare",
        "--mount",
        "sh",
        "-c",
        'mount -t tmpfs -o size=64k none "$0" && exec "$@"',
        str(folder),
    ]
    if os.getuid() != 0 or subprocess.run([*small, "true"], capture_output=True).returncode:
        pytest.skip("only root may give a node another disk")
    # Slow enough for Ray to find that there are two nodes.
    many = DatasetConfig(system="truck", count=24_000)
    port = free_port()
    with started("--head", "--num-cpus", "1", "--port", port):
        wait_for_cores(port, 1)
        with started("--address", f"127.0.0.1:{port}", "--num-cpus", "1", before=small):
            wait_for_cores(port, 2)
            with RayExecutor(f"127.0.0.1:{port}") as executor:
                generate(many, folder, executor=executor)
    generate(many, tmp_path / "alone")
    for path in sorted((tmp_path / "alone").glob("*.*s*")):
        tally.expect(folder / path.name, path.read_bytes())


FLEET = """
systems = ["pendulum"]
substeps = [5]
seeds = [0, 1]
count = 1200
[sizes.tiny]
widths = [4]
updates = 20000
batch = 16
"""


def test_f05_a_node_is_killed_and_its_training_goes_on_elsewhere(tmp_path: Path, tally: Tally):
    file = tmp_path / "fleet.toml"
    file.write_text(FLEET)
    fleet = read_fleet(file)
    checkpoints = [tmp_path / "ray" / "data" / member.run_name for member in fleet.members]
    with cluster_of(2) as (cluster, executor), killed_once_all_began(cluster, checkpoints) as seen:
        rows = train_fleet(fleet, tmp_path / "ray", executor)
    for chunks in seen.values():
        # A training that began anew would have fallen back.
        assert chunks == sorted(chunks)
    with LocalExecutor(1) as alone:
        assert train_fleet(fleet, tmp_path / "alone", alone) == rows
    for member in fleet.members:
        content = (tmp_path / "alone" / member.file_name).read_bytes()
        tally.expect(tmp_path / "ray" / member.file_name, content)


@contextmanager
def killed_once_all_began(
    cluster: Any, checkpoints: Sequence[Path]
) -> Iterator[dict[Path, list[int]]]:
    """Kill a node once there are `checkpoints` of all trainings; yield how many chunks each was seen to have done."""
    seen: dict[Path, list[int]] = {path: [] for path in checkpoints}
    ended = threading.Event()
    killed = threading.Event()

    def watch() -> None:
        while not ended.wait(0.02):
            for path in checkpoints:
                if (path / NAME).exists():
                    seen[path].append(read_tensors(path / NAME, "checkpoint")[1]["chunk"])
            if all(seen.values()) and not killed.is_set():
                kill_node(cluster)
                killed.set()

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield seen
    finally:
        ended.set()
        watcher.join()
    assert killed.is_set()


@contextmanager
def started(*words: object, before: Sequence[str] = ()) -> Iterator[None]:
    """Run a node of Ray while the block runs, as one starts it by hand; `before` is the command that starts it."""
    command = [*before, sys.executable, "-m", "ray.scripts.scripts", "start", *map(str, words)]
    # Whatever lies in the home folder: a head that finds a token there would not let this process in.
    environment = os.environ | {"RAY_AUTH_MODE": "disabled"}
    node = subprocess.Popen(
        [*command, "--block", *(["--include-dashboard", "false"] if "--head" in words else [])],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield
    finally:
        os.killpg(node.pid, signal.SIGKILL)
        node.wait()


def wait_for_cores(port: int, cores: int) -> None:
    """Return when the cluster has so many cores."""

    def has_them() -> bool:
        # It listens before it lets anybody in.
        with suppress(ResourceError), RayExecutor(f"127.0.0.1:{port}") as executor:
            return executor.workers == cores
        return False

    wait_until(has_them, every=0.5)


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def wait_for(port: int) -> None:
    """Return when somebody answers on the port."""

    def is_answered() -> bool:
        with suppress(OSError):
            socket.create_connection(("127.0.0.1", port), 1).close()
            return True
        return False

    wait_until(is_answered, every=0.2)
