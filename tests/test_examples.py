"""The course runs as printed, each lesson in an empty folder."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from waiting import PATIENCE

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


LONG = (
    "02_learn_your_own",
    "03_land_softly",
    "05_park",
    "06_swim_to_a_target",
    "07_turn_about",
    "08_swim_fast",
    "09_leap",
)
"""They ask of bodies what other lessons and tests do, too; tests/learn/evaluation/test_verdict.py makes data, trains, measures
and reports by the functions the second lesson does."""


OWN_PROCESS = ("12_record_episodes",)
"""Minari leaves a folder to be removed at the end of its process."""


def lessons() -> list[Any]:
    """Return every lesson; the long ones run in `make endurance`."""
    marks = dict.fromkeys(LONG, (pytest.mark.endurance,))
    return [pytest.param(path, id=path.stem, marks=marks.get(path.stem, ())) for path in EXAMPLES]


@pytest.mark.parametrize("path", lessons())
def test_the_example_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    if path.stem in OWN_PROCESS:
        result = subprocess.run(
            [sys.executable, str(path)], capture_output=True, text=True, timeout=PATIENCE
        )
        assert result.returncode == 0, result.stderr
    else:
        runpy.run_path(str(path), run_name="__main__")
    assert len(path.read_text().splitlines()) <= 80
    kinds = {made.suffix for made in tmp_path.rglob("*")}
    assert kinds & {".glb", ".html", ".hdf5"}
