"""A folder that a command's output needs is made, and said to be new; a library says nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroanimator import terminal
from neuroanimator.files.atomic import write_whole


@pytest.mark.parametrize("is_command", [True, False])
def test_a_command_tells_of_a_folder_it_made_and_only_once(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    is_command: bool,
):
    monkeypatch.setattr(terminal._screen, "shows_phases", is_command)
    for name in ("a.csv", "b.csv"):
        write_whole(tmp_path / "new" / "er" / name, b"")
    told = capsys.readouterr().err.splitlines()
    folder = tmp_path / "new" / "er"
    assert told == [f"neuroanimator: The folder {folder} was not there: it was made."] * is_command
