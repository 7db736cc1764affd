"""Folders that only this user can write to: what is found there again was put there by this user."""

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
"""Bits a folder's mode must not have: writing by its group, or by others."""

ROOT = 0
"""The user id of the system's own user, who may do everything anyway."""


def private_folders(purpose: str) -> Iterator[Path]:
    """Yield folders for `purpose` that only this user can write to, the best first.

    The first lies in the user's cache (`$XDG_CACHE_HOME`, or `.cache` in the home folder) and is found again by the
    next process. The second is temporary and goes with this process. Either may be missing: a home that cannot be
    written to, a disk that is full, a folder that somebody else could write to, or a link.
    """
    lasting = kept_folder(purpose)
    if lasting is not None:
        yield lasting
    temporary = _temporary_folder()
    if temporary is not None:
        yield temporary


def kept_folder(*purpose: str) -> Path | None:
    """Return the folder for `purpose`, outermost name first, in the user's cache, made if need be.

    None where others cannot be kept out of it, or it cannot be written to.
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
        # It cannot be written to; there is no home; a zero byte is in the name.
        return None
    if not os.access(folder, os.W_OK | os.X_OK):
        return None
    return folder


def _cache_home() -> Path:
    """Return the user's cache folder, without links; RuntimeError where there is no home."""
    asked = Path(os.environ.get("XDG_CACHE_HOME", ""))
    # The standard says that a relative path is to be ignored.
    if asked.is_absolute():
        return asked.resolve()
    return (Path.home() / ".cache").resolve()


def is_private(folder: Path) -> bool:
    """Return whether `folder` is a real folder of this user's, no link, that others cannot write to."""
    status = folder.lstat()
    is_own_folder = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
    return is_own_folder and not status.st_mode & WRITABLE_BY_OTHERS


def _is_safe_above(folder: Path) -> bool:
    """Return whether only root and this user could put another folder in the place of one in `folder`."""
    status = folder.lstat()
    if status.st_uid not in (ROOT, os.getuid()):
        return False
    if status.st_mode & stat.S_ISVTX:
        return True
    # Where every user has a group of their own, homes are often writable by that group.
    is_own_group = status.st_gid == os.getgid()
    unwanted = stat.S_IWOTH if is_own_group else WRITABLE_BY_OTHERS
    return not status.st_mode & unwanted


@cache
def _temporary_folder() -> Path | None:
    """Return a folder that is removed when this process ends; None where nothing temporary can be written."""
    try:
        return folder_until_exit()
    except OSError:
        return None
