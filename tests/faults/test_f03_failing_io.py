"""The n-th call to the disk fails, for every n: one line that names the file, the old file whole, and nothing left."""

from __future__ import annotations

import builtins
import errno
import io
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from processes import leftovers
from tally import Tally

from neuroanimator import DatasetConfig, NeuroAnimatorError, generate
from neuroanimator.errors import ResourceError
from neuroanimator.files.atomic import append_line, write_whole

MAX_CALLS = 200


class FailingDisk:
    """Real files, of which one call fails: a write leaves half of what it should have written."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, fails_at: int, code: int):
        self.calls, self.fails_at, self.code = 0, fails_at, code
        for name in ("fsync", "replace", "mkdir"):
            monkeypatch.setattr(os, name, self._failing(getattr(os, name)))
        opened = builtins.open
        monkeypatch.setattr(
            builtins, "open", lambda *inputs, **named: self._file(opened(*inputs, **named))
        )

    @property
    def has_failed(self) -> bool:
        return self.calls >= self.fails_at

    def count(self) -> None:
        self.calls += 1
        if self.calls == self.fails_at:
            raise OSError(self.code, os.strerror(self.code))

    def _failing(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*inputs: Any, **named: Any) -> Any:
            self.count()
            return call(*inputs, **named)

        return wrapped

    def _file(self, file: Any) -> Any:
        if not file.writable() or isinstance(file, io.TextIOBase):
            return file
        write = file.write

        class Short:
            def __enter__(latent):  # noqa: N805
                return latent

            def __exit__(latent, *error):  # noqa: N805
                file.close()

            def __getattr__(latent, name):  # noqa: N805
                return getattr(file, name)

            def write(latent, content):  # noqa: N805
                try:
                    self.count()
                except OSError:
                    write(content[: len(content) // 2])
                    file.flush()
                    raise
                return write(content)

        return Short()


def complaint(work: Callable[[], object]) -> str:
    """Return what a piece of work complains of; empty if it is done."""
    try:
        work()
    except NeuroAnimatorError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("code", [errno.EIO, errno.ENOSPC, errno.EDQUOT, errno.EROFS])
def test_f03_a_write_that_fails_leaves_the_old_file(code: int, tmp_path: Path, tally: Tally):
    path, old, new = tmp_path / "file.bin", b"old" * 1000, b"new" * 2000
    for fails_at in range(1, MAX_CALLS):
        write_whole(path, old)
        with pytest.MonkeyPatch.context() as monkeypatch:
            disk = FailingDisk(monkeypatch, fails_at, code)
            told = complaint(lambda: write_whole(path, new))
        if not disk.has_failed:
            break
        if told:
            assert "file.bin" in told
            assert ("6,000 bytes needed" in told) == (code in (errno.ENOSPC, errno.EDQUOT))
        # The last call waits for the name to reach the disk: the new file is there by then.
        tally.tried += 1
        tally.expect(path, new if path.read_bytes() == new else old)
        assert not leftovers(tmp_path)
    tally.expect(path, new)
    assert tally.tried > 3


def test_f03_a_generation_that_fails_anywhere_is_resumed(tmp_path: Path, tally: Tally):
    config = DatasetConfig(system="pendulum", count=24)
    generate(config, tmp_path / "whole")
    whole = {path.name: path.read_bytes() for path in (tmp_path / "whole").glob("*.*s*")}
    for fails_at in range(1, MAX_CALLS):
        folder = tmp_path / str(fails_at)
        with pytest.MonkeyPatch.context() as monkeypatch:
            disk = FailingDisk(monkeypatch, fails_at, errno.ENOSPC)
            assert str(folder) in (complaint(partial(generate, config, folder)) or str(folder))
        if not disk.has_failed:
            break
        tally.tried += 1
        generate(config, folder)
        for name, content in whole.items():
            tally.expect(folder / name, content)
        assert not leftovers(folder)
    assert tally.tried > 8


def test_what_is_no_file_is_never_replaced(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder"):
        with pytest.raises(ResourceError, match=f"{name}: it exists, and is not a file"):
            write_whole(tmp_path / name, b"x")
    with pytest.raises(ResourceError, match="pipe: it exists, and is not a file"):
        append_line(tmp_path / "pipe", "{}")
    with pytest.raises(ResourceError, match="metrics"):
        append_line(tmp_path / "nowhere" / "metrics.jsonl", "{}")
