"""Python files in the present folder, as a stranger's archive may hold them, never run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from tally import Tally

NAMES = ("subprocess", "numpy", "json", "queue")
"""Modules that every process of ours imports."""

BUNDLE = """
from pathlib import Path
from neuroanimator_studio.library import Library
from neuroanimator.files.zoo import find_emulator
library = Library(Path.cwd())
library.add(find_emulator("pendulum"), print)
"""
"""The studio's bundle worker, without the server."""

MAIN = "from neuroanimator.cli.main import main; main()"

DRAWING = "from neuroanimator.film.graphics import graphics_backend as draw; draw()"
"""The process that draws films, without a film."""

COMMANDS = {
    "a film": (DRAWING,),
    "workers": (MAIN, "generate", "pendulum", "--count", "300", "--workers", "2", "--out", "d"),
    "a model of a stranger": (MAIN, "new", "m.xml"),
    "a bundle": (BUNDLE,),
}

MODEL = """
<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>
<actuator><motor joint="j" ctrlrange="-1 1" ctrllimited="true"/></actuator></mujoco>
"""


@pytest.mark.parametrize("what", COMMANDS)
def test_no_python_file_of_the_present_folder_runs(tmp_path: Path, what: str, tally: Tally):
    for name in NAMES:
        (tmp_path / f"{name}.py").write_text("open('it-ran', 'w')\nraise SystemExit(9)\n")
    (tmp_path / "m.xml").write_text(MODEL)
    # With -P: as the installed program, whose own folder is not the present one.
    done = subprocess.run(
        [sys.executable, "-P", "-c", *COMMANDS[what]], cwd=tmp_path, capture_output=True, text=True
    )
    assert not (tmp_path / "it-ran").exists()
    assert done.returncode == 0, done.stderr
    tally.tried = len(NAMES)
