"""Real processes of the command line, interrupted and killed."""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

from waiting import PATIENCE

MAIN = "from neuroanimator.cli.main import main; main()"
GENERATE = ("generate", "pendulum", "--count", "6000", "--samples-per-run", "12", "--out")
"""With a folder behind it: makes there what the fixture `dataset` holds."""

LISTENS = 1 << (signal.SIGTERM - 1)
"""The bit of a process that handles SIGTERM itself: from then on it can be stopped."""


def command(*arguments: object) -> list[str]:
    # A job started in the background inherits 'ignore Ctrl-C', and one of nohup 'ignore SIGHUP'; a user's terminal does not.
    return ["env", "--default-signal=INT,HUP", sys.executable, "-c", MAIN, *map(str, arguments)]


def run(*arguments: object, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        command(*arguments),
        capture_output=True,
        env={**os.environ, **environment},
        timeout=PATIENCE,
    )


def start(folder: Path, *arguments: object, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        command(*arguments),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env={**os.environ, **environment},
    )


def wait_until_it_listens(process: subprocess.Popen[str]) -> None:
    while process.poll() is None and not _caught(process.pid) & LISTENS:
        time.sleep(0.002)


def _caught(pid: int) -> int:
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return int(next((line.split()[1] for line in lines if line.startswith("SigCgt")), "0"), 16)


def stopped_after(
    process: subprocess.Popen[str], seconds: float, number: int
) -> tuple[int, str, float]:
    """Return (exit code, stderr, CPU time it took [s]) of a process that gets the signal after `seconds`."""
    wait_until_it_listens(process)
    time.sleep(seconds)
    spent = _cpu_seconds(process.pid)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    whole = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return process.returncode, errors, whole - spent


def _cpu_seconds(pid: int) -> float:
    """Return the CPU time that a running process has taken so far [s]; 0 if it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    user, system = fields[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def killed_at_random(rng: random.Random, longest: float, *arguments: object) -> bool:
    """Run the command, kill it after up to `longest` seconds; return whether it was still running then."""
    process = subprocess.Popen(
        command(*arguments), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        process.wait(rng.uniform(0, longest))
    except subprocess.TimeoutExpired:
        process.kill()
    return process.wait() == -signal.SIGKILL


def leftovers(folder: Path) -> list[Path]:
    """Return every unfinished file and temporary folder under `folder`."""
    return [path for path in folder.rglob("*") if "tmp-" in path.name]


def children(process: int) -> list[int]:
    """Return the processes a process has started."""
    try:
        paths = list(Path(f"/proc/{process}/task").glob("*/children"))
        return [int(word) for path in paths for word in path.read_text().split()]
    except OSError:
        return []
