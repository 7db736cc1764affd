"""Ctrl-C, SIGTERM and SIGHUP end every verb within seconds: one line, nothing half-written."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from processes import GENERATE, leftovers, start, stopped_after
from tally import Tally
from waiting import PATIENCE, wait_until

from neuroanimator import DatasetConfig, generate
from neuroanimator.cli.stop import SIGNALS
from neuroanimator.files.unfinished import is_running

LONGEST = 4.0
"""CPU time that an end may take [s]: half a second until a compiled call is given up, the rest for the machine."""

GOES_ON = "neuroanimator: Stopped. Run the command again: it resumes where it stopped."
WHOLE = "neuroanimator: Stopped. No file was left half-written."

VERBS: dict[str, tuple[list[object], str]] = {
    "generate": (["generate", "fish", "--count", "400000", "--out", "data"], GOES_ON),
    "train": (["train", "pendulum", "--out", "e.safetensors"], GOES_ON),
    "improve": (["improve", "pendulum-50", "--out", "e.safetensors"], GOES_ON),
    "demo": (["demo", "--out", "out"], GOES_ON),
    "control": (["control", "pendulum", "--out", "c.csv", "--starts", "8"], WHOLE),
    "animate": (
        ["animate", "fish", "--seconds", "300", "--out", "clip.glb", "--out", "clip.mp4"],
        WHOLE,
    ),
    "evaluate": (
        ["evaluate", "fish-50", "lander-50", "truck-50", "--report", "report.html"],
        WHOLE,
    ),
    "new": (["new", "Humanoid-v5"], WHOLE),
}


def stop_once(folder: Path, verb: str, seconds: float, number: int, tally: Tally) -> None:
    """Stop the verb after `seconds` and check how it ends; one that ended before counts as not tried."""
    arguments, line = VERBS[verb]
    process = start(folder, *arguments, TMPDIR=str(folder))
    code, errors, took = stopped_after(process, seconds, number)
    if code == 0:
        return
    tally.tried += 1
    told = [text for text in errors.splitlines() if text.startswith("neuroanimator: ")]
    assert code == 128 + number, errors
    assert told[-1:] == [line]
    assert len(told) == 1
    assert "Traceback" not in errors
    assert "Exception" not in errors
    assert took < LONGEST
    assert not leftovers(folder)


@pytest.mark.parametrize(
    ("verb", "seconds", "number"),
    [
        ("control", 0.0, signal.SIGINT),
        ("generate", 1.5, signal.SIGHUP),
        ("train", 0.5, signal.SIGTERM),
        ("new", 0.2, signal.SIGINT),
    ],
)
def test_f17_a_verb_ends_with_one_line(
    verb: str, seconds: float, number: int, tmp_path: Path, tally: Tally
):
    stop_once(tmp_path, verb, seconds, number, tally)


@pytest.mark.endurance
@pytest.mark.parametrize("verb", VERBS)
def test_f17_a_verb_ends_at_any_moment(verb: str, tmp_path: Path, tally: Tally):
    rng = random.Random(verb)
    for number in range(20):
        folder = tmp_path / str(number)
        folder.mkdir()
        stop_once(folder, verb, rng.uniform(0, 20), rng.choice(SIGNALS), tally)


IN_A_CALLBACK = """
import gc, os, signal, time
from neuroanimator.cli import main
def collected(phase, info):
    if phase == "start" and not done:
        done.append(1)
        os.kill(os.getpid(), signal.SIGINT)
done = []
gc.callbacks.append(collected)
def work():
    gc.collect()
    time.sleep(60)
main._run = work
main.main()
"""

IN_COMPILED_CODE = """
import hashlib, threading, os, signal
from neuroanimator.cli import main
def work():
    threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    hashlib.pbkdf2_hmac("sha512", b"a", b"b", 300_000_000)
main._run = work
main.main()
"""


@pytest.mark.parametrize("program", [IN_A_CALLBACK, IN_COMPILED_CODE])
def test_f17_what_swallows_ctrl_c_does_not_keep_it(program: str):
    command = ["env", "--default-signal=INT", sys.executable, "-c", program]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert (ended.returncode, ended.stderr.splitlines()) == (130, [WHOLE])


HALF_DONE = """
import time
from neuroanimator.files.unfinished import temporary_folder
def work(task):
    with temporary_folder() as folder:
        (folder / "half").touch()
        time.sleep(60)
class Task:
    label = "task"
"""

BY_WORKERS = """
import half_done
from neuroanimator.cli import main
from neuroanimator.executor.local import LocalExecutor
tasks = [half_done.Task(), half_done.Task()]
main._run = lambda: LocalExecutor(2).map(half_done.work, tasks)
main.main()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_f17_what_workers_have_temporarily_goes_too(number: int, tmp_path: Path):
    (tmp_path / "half_done.py").write_text(HALF_DONE)
    (tmp_path / "temporary").mkdir()
    surroundings = {
        **os.environ,
        "TMPDIR": str(tmp_path / "temporary"),
        "PYTHONPATH": str(tmp_path),
    }
    command = ["env", "--default-signal=INT,HUP", sys.executable, "-c", BY_WORKERS]
    process = subprocess.Popen(command, env=surroundings, stderr=subprocess.DEVNULL)
    while process.poll() is None and len(list(tmp_path.rglob("half"))) < 2:
        time.sleep(0.01)
    process.send_signal(number)
    assert process.wait(PATIENCE) == 128 + number
    assert not list((tmp_path / "temporary").iterdir())


IN_A_COMPILER = """
from neuroanimator.cli import main
from neuroanimator.codegen.compiler import compiled_library
main._run = lambda: compiled_library("int it(void) { return 0; }")
main.main()
"""


def test_f17_a_compiler_ends_too(tmp_path: Path):
    compiler, number = tmp_path / "cc", tmp_path / "number"
    compiler.write_text(
        f'#!/bin/sh\ncase "$1" in --version) exit 0;; esac\necho $$ > {number}\nexec sleep 30\n'
    )
    compiler.chmod(0o700)
    surroundings = {**os.environ, "CC": str(compiler), "XDG_CACHE_HOME": str(tmp_path)}
    command = ["env", "--default-signal=INT", sys.executable, "-c", IN_A_COMPILER]
    process = subprocess.Popen(command, env=surroundings, stderr=subprocess.DEVNULL)
    while not (number.exists() and number.read_text().strip()):
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE) == 130
    compiler_process = int(number.read_text())
    wait_until(lambda: not is_running(compiler_process))


def test_f17_what_was_told_to_ignore_ctrl_c_ignores_it(tmp_path: Path):
    program = "import os, signal; from neuroanimator.cli import main; main._run = lambda: os.kill(os.getpid(), 2)"
    command = ["env", "--ignore-signal=INT", sys.executable, "-c", f"{program}; main.main()"]
    assert subprocess.run(command, env=os.environ.copy()).returncode == 0


def test_f17_stopped_and_started_again_it_ends_with_the_same_bytes(
    dataset: Path, tmp_path: Path, tally: Tally
):
    arguments = (*GENERATE, tmp_path)
    for seconds in (0.2, 1.0):
        tally.tried += stopped_after(start(tmp_path, *arguments), seconds, signal.SIGINT)[0] == 130
    generate(DatasetConfig(system="pendulum", count=6000), tmp_path)
    for path in dataset.glob("*.*s*"):
        tally.expect(tmp_path / path.name, path.read_bytes())
