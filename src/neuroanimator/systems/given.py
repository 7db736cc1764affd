"""Files the user gave by path to this very process, by the sha256 of their bytes.

A definition that travels with a dataset or an emulator may name a file, never hold one to run or to
open: what is not given here stays closed, so that a stranger's emulator cannot make us run anything.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from neuroanimator.errors import BadFileError

LARGEST_FILE = 512 * 2**20
"""Largest file taken [bytes]: recordings are read whole."""

_GIVEN: dict[str, Path] = {}


def give_file(path: Path) -> str:
    """Allow this process to use the file at `path`; return its sha256, its name from now on."""
    digest = hashlib.sha256(_read(path)).hexdigest()
    _GIVEN[digest] = path
    return digest


def given_file(digest: str, refusal: str) -> bytes:
    """Return the bytes with this sha256 if they were given; BadFileError with `refusal` if not."""
    if digest not in _GIVEN:
        raise BadFileError(refusal)
    content = _read(_GIVEN[digest])
    if hashlib.sha256(content).hexdigest() != digest:
        raise BadFileError(f"{_GIVEN[digest]} changed while it was in use. Run the command again.")
    return content


def _read(path: Path) -> bytes:
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise BadFileError(f"{path}: wanted at most {LARGEST_FILE:,} bytes. Split it, or leave samples out.")
        return path.read_bytes()
    except OSError as error:
        raise BadFileError(f"Could not read {path}: {error.strerror}. Check the path.") from error
