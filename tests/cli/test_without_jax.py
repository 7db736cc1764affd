"""What is kept of a first command is enough for the next one: it needs no JAX, and writes the same bytes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

RUN = "from neuroanimator.cli.main import main; main()"

WITHOUT_JAX = f"import sys; sys.modules['jax'] = None; {RUN}"
"""Whoever imports JAX fails."""

PATIENCE = 300
"""[s]"""


def written(program: str, words: tuple[str, ...], folder: Path, cache: Path) -> dict[str, bytes]:
    """Return the files that a command line leaves in `folder`, by name."""
    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "NEUROANIMATOR_BACKEND": "auto"}
    folder.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", program, *words],
        capture_output=True,
        text=True,
        cwd=folder,
        env=environment,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def check_next_time(words: tuple[str, ...], folder: Path) -> None:
    """Run a command line with nothing kept, then again where JAX cannot be imported."""
    cache = folder / "cache"
    first = written(RUN, words, folder / "first", cache)
    assert first
    assert written(WITHOUT_JAX, words, folder / "next", cache) == first


def test_the_next_motion_needs_no_jax(tmp_path: Path):
    check_next_time(("animate", "pendulum", "--out", "swing.glb"), tmp_path)


@pytest.mark.endurance
@pytest.mark.parametrize(
    "words",
    [
        ("animate", "fish", "--out", "fish.glb", "--out", "fish.csv"),
        ("control", "lander", "--goal", "pad", "--out", "landing.csv", "--glb", "landing.glb"),
    ],
    ids=" ".join,
)
def test_the_next_command_needs_no_jax(words: tuple[str, ...], tmp_path: Path):
    check_next_time(words, tmp_path)
