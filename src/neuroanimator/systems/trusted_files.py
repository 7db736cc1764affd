"""Step functions and recordings this process may use: those the user allowed, by the sha256 of their bytes.

A definition that travels with a dataset or an emulator may name a file, never hold one to run or to
open: what was not allowed here stays closed, so that a stranger's emulator cannot make us run anything.
Nothing else in the package allows a file than `loading.trust_files`, for a TOML file the user names, and
`scaffold.write_toml.write_definition`, for the file it is asked to write one for.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from neuroanimator.errors import BadFileError
from neuroanimator.storage.files import read_bounded

MAX_FILE = 512 * 2**20
"""The largest file taken [bytes]: recordings are read whole."""

_TRUSTED: dict[str, Path] = {}


def trust_file(path: Path) -> str:
    """Allow this process to run or open the file at `path`, as its bytes are now; return their sha256."""
    digest = digest_of(path)
    _TRUSTED[digest] = path
    return digest


def digest_of(path: Path) -> str:
    """Return the sha256 of a file's bytes, its name from now on. Allows nothing."""
    return hashlib.sha256(read_bounded(path, MAX_FILE)).hexdigest()


def trusted_file(digest: str, refusal: str) -> bytes:
    """Return the bytes with this sha256 if they were allowed; BadFileError with `refusal` if not."""
    if digest not in _TRUSTED:
        raise BadFileError(refusal)
    content = read_bounded(_TRUSTED[digest], MAX_FILE)
    if hashlib.sha256(content).hexdigest() != digest:
        raise BadFileError(
            f"{_TRUSTED[digest]} changed while it was in use. Run the command again."
        )
    return content
