"""Trainings started from the page: processes of their own, which outlive the page and the server."""

from __future__ import annotations

import fcntl
import json
import os
import re
import secrets
import shutil
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from neuroanimator import ArgumentError, NeuroAnimatorError, ResourceError
from neuroanimator.authoring import private_folders, python_command, write_whole
from neuroanimator_studio.job_plan import MODEL, PLAN, Plan, read_plan, write_plan
from neuroanimator_studio.job_worker import RUN, STATUS

JOB_ID = re.compile(r"[0-9a-f]{16}")
"""The id of a job: the name of its folder."""

ID_BYTES = 8
"""Random bytes of an id."""

WORKER = "neuroanimator_studio.job_worker"
"""The module that does a job."""

LOG = "log.txt"
"""The file of a job's folder for whatever its process prints."""

MAX_RUNNING = 2
"""Trainings that run at once: each takes all the cores there are."""

MAX_CURVE = 200
"""Points of a training curve that are shown, at most."""

MAX_STATUS = 1 << 16
"""Bytes read of a job's status; ours have a hundred."""

ENDED = ("done", "failed", "stopped")
"""Phases in which no process runs."""

STOP_SECONDS = 10.0
"""Time in which a job's process begins, or ends [s]."""

LAUNCHER = """
import subprocess, sys
with open(sys.argv[1], "ab") as log:
    subprocess.Popen(sys.argv[2:], stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True)
"""
"""Starts a process and ends: the process is then nobody's child, and ends with nobody."""


class Jobs:
    """All trainings, in a folder nobody else can write to."""

    def __init__(self, bundles: Path, folder: Path | None = None):
        """`bundles` is where their emulators go on show; `folder` the jobs' own, in the user's cache if not given."""
        self._bundles = bundles
        self.folder = folder or _kept_folder()

    def start(self, plan: Plan, model: Path | None = None) -> str:
        """Begin a training, of the system that the TOML file `model` defines if there is one; return its id."""
        self._check_room()
        job_id = secrets.token_hex(ID_BYTES)
        folder = self.folder / job_id
        folder.mkdir(mode=0o700)
        if model is not None:
            for path in model.parent.iterdir():
                shutil.copy(path, folder / path.name)
            (folder / model.name).rename(folder / MODEL)
        write_plan(plan.model_copy(update={"began": time.time()}), folder)
        self._launch(folder)
        return job_id

    def resume(self, job_id: str) -> None:
        """Go on with a training that was stopped, or ended by itself."""
        folder = self._find(job_id)
        if is_running(folder):
            raise ArgumentError("job: it is running.")
        self._check_room()
        read_plan(folder)
        self._launch(folder)

    def stop(self, job_id: str) -> None:
        """End a training for now; what it did so far is kept."""
        folder = self._find(job_id)
        process = running_process(folder)
        deadline = time.monotonic() + STOP_SECONDS
        while process is None and is_starting(folder) and time.monotonic() < deadline:
            time.sleep(0.02)
            process = running_process(folder)
        if process is None:
            return
        # At any moment: whatever it writes is whole or absent.
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGTERM)
        while running_process(folder) == process and time.monotonic() < deadline:
            time.sleep(0.02)
        status = {**_status(folder), "phase": "stopped"}
        write_whole(folder / STATUS, json.dumps(status).encode())

    def forget(self, job_id: str) -> None:
        """Remove a training that does not run, and all it made but the emulator on show."""
        folder = self._find(job_id)
        if is_running(folder):
            raise ArgumentError("job: it is running. Stop it first.")
        shutil.rmtree(folder, ignore_errors=True)

    def list(self) -> list[dict[str, Any]]:
        """Return how far every training is, the latest first."""
        rows = []
        for folder in self.folder.iterdir():
            if JOB_ID.fullmatch(folder.name) and (folder / PLAN).is_file():
                with suppress(NeuroAnimatorError):
                    rows.append(describe_job(folder))
        return sorted(rows, key=lambda row: -row["began"])

    def _find(self, job_id: str) -> Path:
        folder = self.folder / job_id
        if not JOB_ID.fullmatch(job_id) or not folder.is_dir():
            raise ArgumentError("job: none has this id.")
        return folder

    def _check_room(self) -> None:
        running = [row for row in self.list() if row["is_running"]]
        if len(running) >= MAX_RUNNING:
            raise ResourceError(f"{MAX_RUNNING} trainings are running already. Stop one, or wait.")

    def _launch(self, folder: Path) -> None:
        (folder / STATUS).unlink(missing_ok=True)
        command = python_command("-m", WORKER, str(folder), str(self._bundles))
        log = folder / LOG
        log.touch()
        subprocess.run(python_command("-c", LAUNCHER, str(log), *command), check=True)


def describe_job(folder: Path) -> dict[str, Any]:
    """Return what a job is to do, how far it is, and its training curve as [update, loss, error] rows."""
    plan = read_plan(folder)
    row: dict[str, Any] = {
        "id": folder.name,
        "system": plan.system,
        "substeps": plan.substeps,
        "size": plan.size,
        "began": plan.began,
        "phase": "starting",
        "done": 0,
        "of": 0,
    }
    row |= _status(folder)
    row["is_running"] = is_running(folder)
    if not row["is_running"] and row["phase"] not in ENDED and not is_starting(folder):
        row["phase"] = "stopped"  # killed, or the machine was switched off
    row["curve"] = _curve(folder)
    return row


def is_starting(folder: Path) -> bool:
    """Return whether the job in `folder` was begun a moment ago, and has said nothing yet."""
    has_said = (folder / STATUS).is_file()
    return not has_said and time.time() - _launched(folder) < STOP_SECONDS


def is_running(folder: Path) -> bool:
    """Return whether a process works on the job in `folder`."""
    return running_process(folder) is not None


def running_process(folder: Path) -> int | None:
    """Return the process that works on the job in `folder`: it holds the folder's lock, and has written its number there."""
    try:
        with open(folder / ".lock", "rb") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                number = lock.read(20).decode(errors="replace").strip()
                return int(number) if number.isdecimal() else None
    except OSError:
        return None
    return None


def _status(folder: Path) -> dict[str, Any]:
    try:
        with open(folder / STATUS, "rb") as file:
            return json.loads(file.read(MAX_STATUS))
    except (OSError, ValueError):
        return {}


def _launched(folder: Path) -> float:
    """Return when the job's process was last started [s since 1970]."""
    with suppress(OSError):
        return (folder / LOG).stat().st_mtime
    return 0.0


def _curve(folder: Path) -> list[list[float]]:
    """Return a share of the lines of the training's log, the last one included."""
    path = folder / RUN / "metrics.jsonl"
    rows = []
    with suppress(OSError, ValueError, KeyError):
        for line in path.read_text().splitlines():
            report = json.loads(line)
            rows.append([report["update"], report["loss"], report["error"]])
    step = max(1, -(-len(rows) // MAX_CURVE))
    return rows[::-1][::step][::-1]


def _kept_folder() -> Path:
    for folder in private_folders("studio"):
        own = folder / "jobs"
        own.mkdir(mode=0o700, exist_ok=True)
        return own
    raise ResourceError(
        "No folder to train in that only you can write to. Set XDG_CACHE_HOME to one."
    )
