"""F15: in a locale that knows ASCII alone everything is read, and what it cannot show is written out."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE

ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
LATIN = {
    "PYTHONIOENCODING": "latin-1",
    "LC_ALL": "C",
    "PYTHONUTF8": "0",
    "PYTHONCOERCECLOCALE": "0",
}

DOOR = """name = "door"
kind = "python"
file = "door.py"
physics = { step = 0.01, truth_step = 0.01, fine_step = 0.001 }
state = [{ name = "angle", unit = "rad" }]
control = [{ name = "torque", unit = "N·m", low = [-1.0], high = [1.0] }]
"""

READ_BACK = """
import numpy as np
from pathlib import Path
from neuroanimator import load_system
from neuroanimator.export.csv_file import read_table, write_table
system = load_system("door.toml")
write_table(Path("table.csv"), np.array([0.0]), np.ones((1, 1)), system.control)
assert read_table(Path("table.csv"), system.control)[1] == 1
assert system.control.slices[0].unit == "N\\xb7m"
"""


def run(
    code: str, folder: Path, locale: dict[str, str], *arguments: str
) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(
        command, cwd=folder, env={**os.environ, **locale}, capture_output=True, timeout=PATIENCE
    )


@pytest.mark.parametrize(
    ("locale", "shown"),
    [
        (ASCII, rb"torque [N\xb7m]"),
        pytest.param(LATIN, b"torque [N\xb7m]", marks=pytest.mark.endurance),
    ],
)
def test_info_works_whatever_the_locale(locale: dict[str, str], shown: bytes, tmp_path: Path):
    result = run(
        "from neuroanimator.cli.main import main; main()", tmp_path, locale, "info", "pendulum-50"
    )
    assert result.returncode == 0, result.stderr
    assert shown in result.stdout


def test_units_beyond_ascii_are_read_and_written_whatever_the_locale(tmp_path: Path):
    (tmp_path / "door.toml").write_text(DOOR, encoding="utf-8")
    (tmp_path / "door.py").write_text("def step(state, control, dt): return state\n")
    result = run(READ_BACK, tmp_path, ASCII)
    assert result.returncode == 0, result.stderr
