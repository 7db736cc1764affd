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
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path

from neuroanimator.terminal import tell
from neuroanimator.text import printable

UNFINISHED = ".neuroanimator-tmp-"
"""Prefix of the name of a file while it is written, and of a temporary folder: hidden, and unique."""

UNFINISHED_NAME = re.compile(
    re.escape(UNFINISHED) + r"([0-9a-f]{8})-([0-9]{1,10})-[0-9a-f]{8}(?:\.[a-z0-9]{1,5})?"
)
"""Pattern of the whole name: the machine, the process, a random number. No other file looks like it."""

MAX_WRITE = 24 * 3600
"""Time after which files that a process on another machine began are considered abandoned [s]."""


@contextmanager
def unfinished(path: Path, suffix: str = "") -> Iterator[Path]:
    """Yield a name beside `path` to write to; a file that still has this name afterwards is removed.

    OSError if `path` cannot become a file: it is a folder, a pipe or a device, or its folder cannot be created.
    """
    folder = path.parent
    if not folder.exists():
        folder.mkdir(parents=True, exist_ok=True)
        tell(f"The folder {printable(str(folder))} was not there: it was made.")
    refuse_other_than_file(path)
    temporary = _new_name(folder, suffix)
    try:
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
        _leftovers.pop(temporary, None)


@contextmanager
def temporary_folder(parent: Path | None = None) -> Iterator[Path]:
    """Yield a new folder in `parent`, or in the system's temporary folder, that only this user can read.

    It is removed with its contents when the block ends, also when the process is stopped within it; after a kill, the
    next process that makes one in `parent` removes it. OSError if it cannot be created.
    """
    folder = folder_until_exit(parent)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _leftovers.pop(folder, None)


def folder_until_exit(parent: Path | None = None) -> Path:
    """Return a new folder that only this user can read, as `temporary_folder` does; it goes when this process ends."""
    folder = _new_name(parent or Path(tempfile.gettempdir()))
    folder.mkdir(mode=0o700)
    return folder


def refuse_other_than_file(path: Path) -> None:
    """Raise OSError if `path` exists and cannot be written to as a file: a folder, or a pipe without a reader."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it exists, and is not a file")


def finish(temporary: Path, path: Path) -> None:
    """Rename a finished file, once it is on the disk."""
    os.replace(temporary, path)
    sync_folder(path.parent)


def replace_together(files: Mapping[Path, bytes]) -> None:
    """Write files that belong together, the last one last: none gets its name before all are on the disk.

    Raises OSError; then all are as they were.
    """
    with ExitStack() as stack:
        written = {path: stack.enter_context(unfinished(path)) for path in files}
        for path, temporary in written.items():
            with open(temporary, "xb") as file:
                file.write(files[path])
                file.flush()
                os.fsync(file.fileno())
        for path, temporary in written.items():
            finish(temporary, path)


def sync_folder(folder: Path) -> None:
    """Flush the names in `folder` to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


_leftovers: dict[Path, int] = {}
"""Files to remove, and the process that began each: a forked process inherits this table, not the duty."""


def _new_name(folder: Path, suffix: str = "") -> Path:
    """Return a name in `folder` for a temporary file; leftovers of dead processes are removed first."""
    _remove_stale_once(folder)
    # Short whatever the final name is: a name has at most 255 bytes.
    path = folder / f"{UNFINISHED}{_machine()}-{os.getpid()}-{secrets.token_hex(4)}{suffix}"
    _leftovers[path] = os.getpid()
    return path


@atexit.register
def remove_leftovers() -> None:
    """Remove this process's unfinished files: also called before an exit without unwinding."""
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
    """Return eight hex digits for the machine of our process ids; containers count as machines."""
    processes = Path("/proc/self/ns/pid")
    space = 0
    if processes.exists():
        space = processes.stat().st_ino
    return hashlib.sha256(f"{platform.node()} {space}".encode()).hexdigest()[:8]


def remove_stale(folder: Path) -> None:
    """Remove only the unfinished files and temporary folders that killed processes left in `folder`.

    Their names hold the machine and the process; those of running processes are left alone.
    """
    for entry in os.scandir(folder):
        named = UNFINISHED_NAME.fullmatch(entry.name)
        if named and not entry.is_symlink():
            with suppress(OSError):  # already gone, or not ours to remove
                _remove_if_abandoned(entry, *named.groups())


_swept: set[Path] = set()
"""Folders that this process has searched for leftovers."""


def _remove_stale_once(folder: Path) -> None:
    if folder not in _swept:
        _swept.add(folder)
        with suppress(OSError):  # a folder may be writable, but not listable
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
