"""Step functions and recordings this process may use: those the user allowed, by the sha256 of their bytes.

A definition that travels with a dataset or an emulator may name a file, never hold one to run or to
open: what was not allowed here stays closed, so that a stranger's emulator cannot make us run anything.
Nothing else in the package allows a file than `loading.trust_files`, for a TOML file the user names, and
`scaffold.write_toml.write_definition`, for the file it is asked to write one for. A worker of this process's own is
told what was allowed, with the task it is given (`data.shard_task`).
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


def trusted_so_far() -> tuple[tuple[str, str], ...]:
    """Return (sha256, path) of each file this process may use, for the workers it starts."""
    return tuple((digest, str(path.resolve())) for digest, path in _TRUSTED.items())


def trust_as_told(files: tuple[tuple[str, str], ...]) -> None:
    """Allow this process, a worker, what `trusted_so_far` said of the process that gives it work."""
    for digest, path in files:
        _TRUSTED.setdefault(digest, Path(path))


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
