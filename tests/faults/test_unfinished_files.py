"""Only what NeuroAnimator itself left unfinished is removed, and only when nobody is at work on it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tally import Tally

from neuroanimator import DatasetConfig, NeuroAnimatorError, generate
from neuroanimator.files.atomic import write_whole
from neuroanimator.files.unfinished import (
    MAX_WRITE,
    UNFINISHED,
    remove_stale,
    temporary_folder,
    unfinished,
)

OWN = [
    "notes.tmp-1",
    "x.safetensors.tmp-12345",
    ".neuroanimator-tmp-notes",
    ".neuroanimator-tmp-0123abcd-1-zz",
    "a.tmp",
]

DIES = """
import os
from pathlib import Path
from neuroanimator.files.unfinished import unfinished
with unfinished(Path("a.bin")) as path:
    path.write_bytes(b"half")
    os._exit(9)
"""

DIES_AT_WORK = """
import os
from pathlib import Path
from neuroanimator.files.unfinished import remove_leftovers, temporary_folder
with temporary_folder(Path()) as killed, temporary_folder(Path()) as known:
    (killed / "half").mkdir()
    {before}
    os._exit(9)
"""


def test_a_users_own_files_stay_also_where_the_folder_is_refused(tmp_path: Path, tally: Tally):
    generate(DatasetConfig(system="pendulum", count=24), tmp_path)
    for name in OWN:
        (tmp_path / name).write_bytes(b"mine")
    (tmp_path / ".neuroanimator-tmp-0123abcd-1-0123abcd").symlink_to(tmp_path / OWN[0])
    generate(DatasetConfig(system="pendulum", count=24), tmp_path)
    with pytest.raises(NeuroAnimatorError, match="another dataset"):
        generate(DatasetConfig(system="pendulum", count=36), tmp_path)
    tally.tried = len(OWN)
    for name in OWN:
        tally.expect(tmp_path / name, b"mine")


def test_what_a_dead_process_left_goes_and_what_a_living_one_writes_stays(tmp_path: Path):
    assert subprocess.run([sys.executable, "-c", DIES], cwd=tmp_path).returncode == 9
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(UNFINISHED)
    with unfinished(tmp_path / "b.bin") as ours:
        ours.write_bytes(b"half")
        remove_stale(tmp_path)
        assert list(tmp_path.iterdir()) == [ours]
    assert not list(tmp_path.iterdir())


def test_a_temporary_folder_is_the_users_own_and_goes_with_the_work(tmp_path: Path):
    with temporary_folder(tmp_path) as folder:
        assert folder.stat().st_mode & 0o777 == 0o700
        (folder / "made").mkdir()
        (folder / "made" / "half").touch()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("before", "left"), [("remove_leftovers()", 0), ("", 2)])
def test_a_temporary_folder_goes_with_a_stop_and_after_a_kill_with_the_next(
    before: str, left: int, tmp_path: Path
):
    program = DIES_AT_WORK.format(before=before)
    assert subprocess.run([sys.executable, "-c", program], cwd=tmp_path).returncode == 9
    assert len(list(tmp_path.iterdir())) == left
    with temporary_folder(tmp_path) as folder:
        assert list(tmp_path.iterdir()) == [folder]


def test_what_another_machine_began_is_given_up_after_a_day(tmp_path: Path):
    path = tmp_path / f"{UNFINISHED}00000000-1-0123abcd"
    path.touch()
    remove_stale(tmp_path)
    assert path.exists()
    old = time.time() - 2 * MAX_WRITE
    os.utime(path, (old, old))
    remove_stale(tmp_path)
    assert not path.exists()


def test_a_name_may_be_as_long_as_the_disk_allows(tmp_path: Path):
    path = tmp_path / ("n" * 255)
    write_whole(path, b"x")
    assert path.read_bytes() == b"x"
