"""A full disk: exit code 4, the file and the bytes it needs, and once there is room it goes on to the same bytes."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from conftest import Cli
from processes import GENERATE, command, leftovers
from tally import Tally

from neuroanimator import DatasetConfig, generate
from neuroanimator.errors import ResourceError
from neuroanimator.files.atomic import locked, write_together


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 256 kB: less than half of the dataset."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if (
        os.getuid() != 0
        or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "none", disk]).returncode
    ):
        pytest.skip("only root may mount a small disk; the limit on a file's size is tested")
    yield disk
    subprocess.run(["umount", disk], check=True)


def test_f04_a_full_disk_is_said_and_resumed_from(
    small_disk: Path, dataset: Path, tally: Tally, cli: Cli
):
    folder = small_disk / "data"
    full = cli(*GENERATE, folder)
    told = full.stderr
    assert full.returncode == 4, told
    assert f"Could not write {folder}/shard-0000" in told
    assert "bytes needed" in told
    assert len(told.splitlines()) == 1
    assert not leftovers(folder)
    subprocess.run(["mount", "-o", "remount,size=64m", small_disk], check=True)
    generate(DatasetConfig(system="pendulum", count=6000), folder)
    for path in dataset.glob("*.*s*"):
        tally.expect(folder / path.name, path.read_bytes())


def test_f04_a_lock_holds_on_a_full_disk(small_disk: Path, cli: Cli):
    (small_disk / "data").mkdir()
    (small_disk / "data" / ".lock").touch()
    with open(small_disk / "filled", "wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(b"x" * 4096)
    with locked(small_disk / "data"):
        pass
    full = cli(*GENERATE, small_disk / "data")
    assert full.returncode == 4
    assert "dataset.json: No space left on device (" in full.stderr


def test_f04_a_limit_on_files_is_said(tmp_path: Path):
    limited = subprocess.run(
        ["prlimit", "--fsize=50000", *command(*GENERATE, tmp_path / "data")],
        capture_output=True,
        text=True,
    )
    assert limited.returncode == 4
    assert "shard-00000.safetensors: File too large" in limited.stderr
    assert not leftovers(tmp_path)


def test_f06_a_second_process_is_refused_with_the_first_ones_number(tmp_path: Path, cli: Cli):
    folder = tmp_path / "data"
    with locked(folder):
        second = cli(*GENERATE, folder)
    assert second.returncode == 4
    assert f"{folder} is in use by process {os.getpid()}." in second.stderr


def test_f04_files_that_belong_together_are_all_new_or_all_old(small_disk: Path):
    """The vectors have room for themselves; the header that they belong to has not."""
    vectors = small_disk / "fish.vectors.json"
    header = small_disk / "fish.h"
    with pytest.raises(ResourceError, match=r"fish\.h: .*\(350,000 bytes needed\)"):
        write_together({vectors: b"v" * 50_000, header: b"h" * 300_000})
    assert not list(small_disk.iterdir())
    write_together({vectors: b"old", header: b"old"})
    with pytest.raises(ResourceError):
        write_together({vectors: b"v" * 50_000, header: b"h" * 300_000})
    assert {path.read_bytes() for path in small_disk.iterdir()} == {b"old"}
