"""The user's files that this process may use: step functions and recordings, and models.

A definition that travels with a dataset or an emulator names its files by the sha256 of their bytes, and never holds
one. A step function is run, and recordings are opened, only if the user has allowed them here, so that a stranger's
emulator cannot run code. Only `loading.trust_files`, for a TOML file the user names, and
`scaffold.write_toml.write_definition`, for its source file, allow files.

A model runs no code and is compiled within limits, so it needs no consent, but must be found: by the TOML file the user
names, beside the emulator, or in its dataset. The two kinds are kept apart: a found model allows nobody to run one of
its files.

A worker of this process receives this knowledge with its task (`learn.data.shard_task`).
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import NamedTuple

from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import read_bounded
from neuroanimator.systems.model_files import ModelFiles

MAX_FILE = 512 * 2**20
"""Maximum size of a file [bytes]: recordings are read whole."""

_TRUSTED: dict[str, Path] = {}

_MODELS: list[tuple[str, ModelFiles]] = []


class TrustedFiles(NamedTuple):
    """The user's files that a process may use."""

    files: tuple[tuple[str, str], ...] = ()
    """(sha256, path) of the step functions it may run and the recordings it may open."""
    models: tuple[tuple[str, ModelFiles], ...] = ()
    """(system's name, files) of each model."""


NO_FILES = TrustedFiles()
"""The files of a process that may use none."""


def trusted_so_far() -> TrustedFiles:
    """Return the files this process may use, for the workers it starts."""
    files = tuple((digest, str(path.resolve())) for digest, path in _TRUSTED.items())
    return TrustedFiles(files, tuple(_MODELS))


def trust_as_told(parent: TrustedFiles) -> None:
    """Allow this process, a worker, the files in `trusted_so_far` of its `parent`."""
    for digest, path in parent.files:
        _TRUSTED.setdefault(digest, Path(path))
    for system, files in parent.models:
        know_model(system, files)


def know_model(system: str, files: ModelFiles) -> None:
    """Remember the model's files of a system, for emulators and datasets that name them."""
    if (system, files) not in _MODELS:
        _MODELS.append((system, files))


def known_models(system: str) -> list[ModelFiles]:
    """Return the known models of a system of this name, the latest first."""
    return [files for name, files in reversed(_MODELS) if name == system]


def trust_file(path: Path) -> str:
    """Allow this process to run or open the file at `path` with its current bytes; return their sha256."""
    digest = digest_of(path)
    _TRUSTED[digest] = path
    return digest


def trusted_path(digest: str) -> Path | None:
    """Return the path of a file with this sha256 when it was allowed; None if none was."""
    return _TRUSTED.get(digest)


def digest_of(path: Path) -> str:
    """Return the sha256 of a file's bytes, by which it is known from now on. Allows nothing."""
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
