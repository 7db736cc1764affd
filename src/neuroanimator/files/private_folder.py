"""Folders that only this user can write to, so that their contents are this user's own."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from neuroanimator.files.unfinished import folder_until_exit

NAME = "neuroanimator"
"""Name of our folder in the user's cache."""

WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
"""Bits that a folder's mode must not have: writing by its group, or by others."""

ROOT = 0
"""User id of root, who may do everything anyway."""


def private_folders(purpose: str) -> Iterator[Path]:
    """Yield folders for `purpose` that only this user can write to, the best first.

    The first lies in the user's cache (`$XDG_CACHE_HOME`, or `.cache` in the home folder) and is reused by the
    next process. The second is temporary and removed with this process. Either may be missing: with a read-only home,
    a full disk, a folder that others could write to, or a link.
    """
    lasting = kept_folder(purpose)
    if lasting is not None:
        yield lasting
    temporary = _temporary_folder()
    if temporary is not None:
        yield temporary


def kept_folder(*purpose: str) -> Path | None:
    """Return the folder for `purpose`, outermost name first, in the user's cache, created if missing.

    None if others cannot be kept out, or it cannot be written to.
    """
    try:
        cache_home = _cache_home()
        cache_home.mkdir(parents=True, exist_ok=True)
        if not all(_is_safe_above(folder) for folder in (cache_home, *cache_home.parents)):
            return None
        folder = cache_home
        for part in (NAME, *purpose):
            folder = folder / part
            folder.mkdir(mode=0o700, exist_ok=True)
            if not is_private(folder):
                return None
    except (OSError, RuntimeError, ValueError):
        # It cannot be written to, there is no home, or the name holds a zero byte.
        return None
    if not os.access(folder, os.W_OK | os.X_OK):
        return None
    return folder


def _cache_home() -> Path:
    """Return the user's cache folder, without links; RuntimeError where there is no home."""
    asked = Path(os.environ.get("XDG_CACHE_HOME", ""))
    # The standard says to ignore a relative path.
    if asked.is_absolute():
        return asked.resolve()
    return (Path.home() / ".cache").resolve()


def is_private(folder: Path) -> bool:
    """Return whether `folder` is a real folder of this user, not a link, that others cannot write to."""
    status = folder.lstat()
    is_own_folder = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
    return is_own_folder and not status.st_mode & WRITABLE_BY_OTHERS


def _is_safe_above(folder: Path) -> bool:
    """Return whether only root and this user could replace a folder in `folder`."""
    status = folder.lstat()
    if status.st_uid not in (ROOT, os.getuid()):
        return False
    if status.st_mode & stat.S_ISVTX:
        return True
    # If every user has their own group, homes are often writable by it.
    is_own_group = status.st_gid == os.getgid()
    unwanted = stat.S_IWOTH if is_own_group else WRITABLE_BY_OTHERS
    return not status.st_mode & unwanted


@cache
def _temporary_folder() -> Path | None:
    """Return a folder that is removed when this process ends; None if no temporary folder can be written."""
    try:
        return folder_until_exit()
    except OSError:
        return None
