"""What a process began and has not finished: known by name, and removed by this process or the next one."""

from __future__ import annotations

import atexit
import errno
import hashlib
import os
import platform
import re
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

UNFINISHED = ".neuroanimator-tmp-"
"""How the name of a file begins while it is written: hidden, and nobody else's."""

UNFINISHED_NAME = re.compile(
    re.escape(UNFINISHED) + r"([0-9a-f]{8})-([0-9]{1,10})-[0-9a-f]{8}(?:\.[a-z0-9]{1,5})?"
)
"""The name of a file while it is written: the machine, the process, a random number. Nobody else's looks like it."""

MAX_WRITE = 24 * 3600
"""Time after which a file that a process on another machine began is given up [s]."""


@contextmanager
def unfinished(path: Path, suffix: str = "") -> Iterator[Path]:
    """Yield a name beside `path` to write to; whatever still has it afterwards is removed.

    OSError if `path` cannot become a file: another kind of thing is there, or its folder cannot be made.
    """
    folder = path.parent
    folder.mkdir(parents=True, exist_ok=True)
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is there, and is no file")
    _remove_stale_once(folder)
    # As short whatever `path` is called: a name has 255 bytes at most.
    temporary = folder / f"{UNFINISHED}{_machine()}-{os.getpid()}-{secrets.token_hex(4)}{suffix}"
    _leftovers[temporary] = os.getpid()
    try:
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
        _leftovers.pop(temporary, None)


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
"""What must not be left behind, and the process that began it: a forked one inherits this table, not the duty."""


def remove_at_exit(path: Path) -> None:
    """Remove a file, or a folder and all in it, when this process ends."""
    _leftovers[path] = os.getpid()
    atexit.register(remove_leftovers)


def remove_leftovers() -> None:
    """Remove what this process began and did not finish: called before an end that unwinds nothing."""
    for path, process in list(_leftovers.items()):
        if process != os.getpid():
            continue
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
    """Remove the unfinished files that killed processes left in `folder`, and nothing else.

    They are known by their name, which holds the machine and the process; those of living ones are left alone.
    """
    for entry in os.scandir(folder):
        named = UNFINISHED_NAME.fullmatch(entry.name)
        if named and entry.is_file(follow_symlinks=False):
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
        os.unlink(entry)


def is_running(process: int) -> bool:
    """Return whether a process of this machine has that id."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True
