"""The corpus: inputs that each took a new way through a parser, a folder a parser in one archive."""

from __future__ import annotations

import zipfile
from pathlib import Path

ARCHIVE = Path(__file__).with_name("corpus.zip")

EPOCH = (1980, 1, 1, 0, 0, 0)
"""Date of every file in the archive, so that the same inputs make the same bytes."""


def _everything() -> dict[str, bytes]:
    with zipfile.ZipFile(ARCHIVE) as archive:
        return {name: archive.read(name) for name in sorted(archive.namelist())}


PARSERS = sorted({name.partition("/")[0] for name in _everything()})
"""Parsers with a corpus, by name."""


def read_corpus(parser: str) -> dict[str, bytes]:
    """Return the inputs kept for `parser`, by name; none for a new one."""
    folder = f"{parser}/"
    kept = _everything().items()
    return {name.removeprefix(folder): content for name, content in kept if name.startswith(folder)}


def write_corpus(parser: str, inputs: dict[str, bytes]) -> None:
    """Replace the inputs kept for `parser`."""
    folder = f"{parser}/"
    kept = {name: content for name, content in _everything().items() if not name.startswith(folder)}
    kept |= {folder + name: content for name, content in inputs.items()}
    with zipfile.ZipFile(ARCHIVE, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(kept):
            archive.writestr(zipfile.ZipInfo(name, EPOCH), kept[name], zipfile.ZIP_DEFLATED)


def unpack_corpus(parser: str, folder: Path) -> None:
    """Write the inputs kept for `parser` into `folder`, one file each."""
    for name, content in read_corpus(parser).items():
        (folder / name).write_bytes(content)
