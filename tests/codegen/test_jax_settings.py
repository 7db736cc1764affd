"""What JAX compiled is kept for the next run, wherever that can be done safely, and never in anybody's way."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax
import pytest

from neuroanimator.codegen import jax_settings
from neuroanimator.codegen.jax_settings import OFF, keep_programs

STEP = """
import logging, sys
import jax
jax.config.update("jax_log_compiles", True)
import numpy as np
import neuroanimator as na
emulator = na.Emulator.load("pendulum-50")
print([round(float(number), 5) for number in emulator.step(np.ones(6), np.ones(3))])
print(jax.config.jax_compilation_cache_dir)
"""


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    unwanted = ("JAX_COMPILATION_CACHE_DIR", "NEUROANIMATOR_CACHE", "XDG_CACHE_HOME")
    given = {key: value for key, value in os.environ.items() if key not in unwanted}
    given |= environment
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, env=given
    )


@contextmanager
def jax_without_folder() -> Iterator[None]:
    """Let JAX forget, for a while, in which folder this process keeps its programs."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    try:
        yield
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


def programs(home: Path) -> list[Path]:
    return sorted(home.rglob("*-cache"))


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A home in which a first process kept what it compiled, and what that process said."""
    home = tmp_path_factory.mktemp("first")
    done = run(STEP, XDG_CACHE_HOME=str(home))
    assert done.returncode == 0, done.stderr
    return home, done.stdout


def test_a_second_process_reads_what_the_first_compiled(first: tuple[Path, str]):
    home, said = first
    kept = {path: path.stat().st_mtime_ns for path in programs(home)}
    assert kept
    second = run(STEP, XDG_CACHE_HOME=str(home))
    assert second.stdout == said
    assert {path: path.stat().st_mtime_ns for path in programs(home)} == kept


def test_the_folder_of_programs_is_the_users_alone(first: tuple[Path, str]):
    home, _ = first
    folders = {path.parent for path in programs(home)}
    assert folders
    for folder in folders:
        for part in (folder, folder.parent, folder.parent.parent):
            assert part.stat().st_mode & 0o077 == 0


def test_a_folder_of_the_users_choice_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    chosen, home = tmp_path / "chosen", tmp_path / "home"
    found = run(STEP, XDG_CACHE_HOME=str(home), JAX_COMPILATION_CACHE_DIR=str(chosen))
    assert found.stdout.splitlines()[-1] == str(chosen)
    monkeypatch.setenv("XDG_CACHE_HOME", str(home))
    with jax_without_folder():
        jax.config.update("jax_compilation_cache_dir", str(chosen))
        assert keep_programs.__wrapped__() is None
        assert jax.config.jax_compilation_cache_dir == str(chosen)
    assert not home.exists()


@pytest.mark.parametrize("off", OFF)
def test_it_can_be_switched_off(off: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("NEUROANIMATOR_CACHE", off)
    with jax_without_folder():
        assert keep_programs.__wrapped__() is None
        assert jax.config.jax_compilation_cache_dir is None
    assert not list(tmp_path.iterdir())


def test_a_damaged_program_is_compiled_again_without_a_word(
    first: tuple[Path, str], tmp_path: Path
):
    home, said = first
    shutil.copytree(home, tmp_path, dirs_exist_ok=True)
    for path in programs(tmp_path):
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    again = run(STEP, XDG_CACHE_HOME=str(tmp_path))
    assert again.returncode == 0, again.stderr
    assert again.stdout.splitlines()[0] == said.splitlines()[0]
    assert "Error reading" not in again.stderr


@pytest.mark.parametrize("kind", ["missing", "file", "link", "open to all", "no home"])
def test_a_folder_that_is_not_safe_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
):
    home = str(tmp_path / "cache")
    if kind == "missing":
        home = "/proc/nowhere"
    elif kind == "file":
        (tmp_path / "cache").write_text("")
    elif kind == "link":
        (tmp_path / "elsewhere").mkdir()
        (tmp_path / "cache").mkdir()
        (tmp_path / "cache" / "neuroanimator").symlink_to(tmp_path / "elsewhere")
    elif kind == "open to all":
        (tmp_path / "cache" / "neuroanimator").mkdir(parents=True)
        (tmp_path / "cache" / "neuroanimator").chmod(0o777)
    monkeypatch.setenv("HOME", "/proc/nowhere")
    monkeypatch.setenv("XDG_CACHE_HOME", home)
    if kind == "no home":
        monkeypatch.delenv("XDG_CACHE_HOME")
    with jax_without_folder():
        assert keep_programs.__wrapped__() is None
        assert jax.config.jax_compilation_cache_dir is None
    assert not programs(tmp_path)


def test_too_many_programs_lose_the_half_that_was_unused_for_longest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(jax_settings, "MAX_PROGRAMS", 10)
    for number in range(12):
        path = tmp_path / f"{number:02}-cache"
        path.write_text("")
        os.utime(path, (number, number))
    os.utime(tmp_path / "00-cache", (20, 0))  # written first, and read last
    jax_settings._remove_unused_half(tmp_path)
    assert [path.name for path in sorted(tmp_path.iterdir())] == [
        f"{number:02}-cache" for number in (0, *range(7, 12))
    ]
