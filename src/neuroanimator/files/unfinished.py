"""Temporary files, removed by this process or, if it was killed, by the next."""

from __future__ import annotations

import atexit
import errno
import hashlib
import os
import platform
import re
import secrets
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

UNFINISHED = ".neuroanimator-tmp-"
"""Prefix of the name of a file while it is written, and of a temporary folder: hidden, and unique."""

UNFINISHED_NAME = re.compile(
    re.escape(UNFINISHED) + r"([0-9a-f]{8})-([0-9]{1,10})-[0-9a-f]{8}(?:\.[a-z0-9]{1,5})?"
)
"""The whole name: the machine, the process, a random number. Nobody else's looks like it."""

MAX_WRITE = 24 * 3600
"""Time after which what a process on another machine began is given up [s]."""


@contextmanager
def unfinished(path: Path, suffix: str = "") -> Iterator[Path]:
    """Yield a name beside `path` to write to; a file that still has it afterwards is removed.

    OSError if `path` cannot become a file: a folder, a pipe or a device is there, or its folder cannot be made.
    """
    folder = path.parent
    folder.mkdir(parents=True, exist_ok=True)
    refuse_other_than_file(path)
    temporary = _new_name(folder, suffix)
    try:
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
        _leftovers.pop(temporary, None)


@contextmanager
def temporary_folder(parent: Path | None = None) -> Iterator[Path]:
    """Yield a new folder in `parent`, or where the system keeps what is temporary; only this user can look into it.

    It goes with all in it when the block ends, and also when the process is stopped in the middle of it; after a kill
    the next process that makes one in `parent` removes it. OSError if it cannot be made.
    """
    folder = folder_until_exit(parent)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _leftovers.pop(folder, None)


def folder_until_exit(parent: Path | None = None) -> Path:
    """Return a new folder as `temporary_folder` yields it, which goes when this process ends."""
    folder = _new_name(parent or Path(tempfile.gettempdir()))
    folder.mkdir(mode=0o700)
    return folder


def refuse_other_than_file(path: Path) -> None:
    """Raise OSError if `path` is there and cannot be written to as a file: a folder, a pipe without a reader."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is there, and is no file")


def finish(temporary: Path, path: Path) -> None:
    """Give a file that is wholly on the disk its name."""
    os.replace(temporary, path)
    sync_folder(path.parent)


def replace_whole(path: Path, content: bytes) -> None:
    """Write `content` so that a reader, or a kill at any moment, finds the old file or the new one.

    Raises OSError as it comes.
    """
    with unfinished(path) as temporary:
        with open(temporary, "xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        finish(temporary, path)


def sync_folder(folder: Path) -> None:
    """Return when the names in `folder` are on the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


_leftovers: dict[Path, int] = {}
"""Files to be removed, and the process that began each: a forked one inherits this table, not the duty."""


def _new_name(folder: Path, suffix: str = "") -> Path:
    """Return a name in `folder` for what must not be left behind; what dead processes left there is removed first."""
    _remove_stale_once(folder)
    # As short whatever it will be called: a name has 255 bytes at most.
    path = folder / f"{UNFINISHED}{_machine()}-{os.getpid()}-{secrets.token_hex(4)}{suffix}"
    _leftovers[path] = os.getpid()
    return path


def remove_at_exit(path: Path) -> None:
    """Remove a file, or a folder and all in it, when this process ends."""
    _leftovers[path] = os.getpid()


@atexit.register
def remove_leftovers() -> None:
    """Remove what this process began and did not finish: called before an end that unwinds nothing, too."""
    for path, process in list(_leftovers.items()):
        if process != os.getpid():
            continue
        _remove(path)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@cache
def _machine() -> str:
    """Return eight hex digits for the machine whose process ids ours are; containers count as machines."""
    processes = Path("/proc/self/ns/pid")
    space = 0
    if processes.exists():
        space = processes.stat().st_ino
    return hashlib.sha256(f"{platform.node()} {space}".encode()).hexdigest()[:8]


def remove_stale(folder: Path) -> None:
    """Remove the unfinished files and the temporary folders that killed processes left in `folder`, and nothing else.

    They are known by their name, which holds the machine and the process; those of living ones are left alone.
    """
    for entry in os.scandir(folder):
        named = UNFINISHED_NAME.fullmatch(entry.name)
        if named and not entry.is_symlink():
            with suppress(OSError):  # gone meanwhile, or not ours to remove
                _remove_if_abandoned(entry, *named.groups())


_swept: set[Path] = set()
"""Folders this process has looked through for what others left behind."""


def _remove_stale_once(folder: Path) -> None:
    if folder not in _swept:
        _swept.add(folder)
        with suppress(OSError):  # a folder may be written to, and not be listed
            remove_stale(folder)


def _remove_if_abandoned(entry: os.DirEntry[str], machine: str, process: str) -> None:
    if machine == _machine():
        is_abandoned = not is_running(int(process))
    else:
        is_abandoned = time.time() - entry.stat(follow_symlinks=False).st_mtime > MAX_WRITE
    if is_abandoned:
        _remove(Path(entry))


def is_running(process: int) -> bool:
    """Return whether a process of this machine has that id."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True
