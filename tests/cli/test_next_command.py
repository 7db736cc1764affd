"""What is kept of a first command is enough for the next one: JAX traces nothing, and the same bytes are written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE

RUN = "from neuroanimator.cli.main import main; main()"

TOLD = f"import jax; jax.config.update('jax_log_compiles', True); {RUN}"
"""JAX tells on stderr what it traces and compiles."""

TRACED = "Finished tracing"
"""Beginning of the line on a function that was traced."""


def written(words: tuple[str, ...], folder: Path, cache: Path) -> tuple[dict[str, bytes], bool]:
    """Return (the files that a command line leaves in `folder`, by name, whether JAX traced anything)."""
    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "NEUROANIMATOR_BACKEND": "auto"}
    folder.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", TOLD, *words],
        capture_output=True,
        text=True,
        cwd=folder,
        env=environment,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    return files, TRACED in done.stderr


def check_next_time(words: tuple[str, ...], folder: Path) -> None:
    """Run a command line with nothing kept, then again."""
    cache = folder / "cache"
    first, has_traced = written(words, folder / "first", cache)
    assert first
    assert has_traced
    assert written(words, folder / "next", cache) == (first, False)


def test_the_next_motion_is_not_traced(tmp_path: Path):
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
def test_the_next_command_is_not_traced(words: tuple[str, ...], tmp_path: Path):
    check_next_time(words, tmp_path)
