"""No home, a home that cannot be written to, locales without UTF-8, names with spaces and umlauts: it works."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from processes import MAIN
from waiting import PATIENCE

ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
NO_HOME = {"HOME": None, "XDG_CACHE_HOME": None}
SHUT = {"HOME": "/proc/nothing", "XDG_CACHE_HOME": "/proc/nothing"}


def run_in(
    surroundings: dict[str, str | None], folder: Path, *arguments: str
) -> subprocess.CompletedProcess[bytes]:
    environment = {**os.environ, **surroundings}
    present = {key: value for key, value in environment.items() if value is not None}
    program = [sys.executable, "-c", MAIN, *arguments]
    return subprocess.run(program, cwd=folder, env=present, capture_output=True, timeout=PATIENCE)


def test_f15_files_are_utf_8_whatever_the_locale(tmp_path: Path):
    folder = tmp_path / "ein Ordner für Gelände"
    folder.mkdir()
    controls = folder / "c.csv"
    controls.write_text(
        "time s,torque[0] N·m,torque[1] N·m,torque[2] N·m\n0,0,0,0\n0.05,0,1,0\n", encoding="utf-8"
    )
    made = run_in(
        {**ASCII, **NO_HOME},
        folder,
        "animate",
        "pendulum",
        "--controls",
        "c.csv",
        "--out",
        "größe.csv",
    )
    assert made.returncode == 0, made.stderr
    assert "rad/s" in (folder / "größe.csv").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "surroundings",
    [
        pytest.param(NO_HOME, id="no home", marks=pytest.mark.endurance),  # above, too
        pytest.param(SHUT, id="shut home"),
    ],
)
def test_f15_a_home_is_not_needed(surroundings: dict[str, str | None], tmp_path: Path):
    made = run_in(surroundings, tmp_path, "generate", "fish", "--count", "12", "--out", "data")
    assert made.returncode == 0, made.stderr
    assert not [path for path in tmp_path.iterdir() if path.name != "data"]


def test_f15_a_mistake_in_a_foreign_script_is_one_line(tmp_path: Path):
    wrong = run_in(ASCII, tmp_path, "info", "größe-日本")
    assert wrong.returncode == 3
    told = [line for line in wrong.stderr.splitlines() if line.startswith(b"neuroanimator: ")]
    assert len(told) == 1
    assert b"Traceback" not in wrong.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full here")
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("verb", ["list", "--help"])
def test_f15_results_that_cannot_be_written_are_one_line_and_exit_code_4(
    verb: str, unbuffered: str
):
    """What could not be written is not tried again at the end, which Python would say at length."""
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-c", MAIN, verb],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
            timeout=PATIENCE,
        )
    assert (done.returncode, done.stderr) == (4, "neuroanimator: No space left on device\n")


RESULT_AND_ERROR = """
import neuroanimator.cli.verbs
from neuroanimator.cli.main import main

def app():
    print("a result")
    raise OSError(5, "a disk fails", "some.file")

neuroanimator.cli.verbs.app = app
main()
"""


def test_f15_an_error_elsewhere_leaves_the_results_that_were_printed():
    program = [sys.executable, "-c", RESULT_AND_ERROR]
    buffered = {**os.environ, "PYTHONUNBUFFERED": ""}
    done = subprocess.run(program, capture_output=True, text=True, env=buffered, timeout=PATIENCE)
    assert (done.returncode, done.stdout) == (4, "a result\n")
    assert done.stderr == "neuroanimator: a disk fails: some.file\n"
