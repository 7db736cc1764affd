"""The corpus: inputs that each took a new way through a parser, one archive a parser."""

from __future__ import annotations

import zipfile
from pathlib import Path

FOLDER = Path(__file__).parent / "archives"

PARSERS = sorted(path.stem for path in FOLDER.iterdir())
"""Parsers with a corpus, by name."""

EPOCH = (1980, 1, 1, 0, 0, 0)
"""Date of every file in an archive, so that the same inputs make the same bytes."""


def read_corpus(parser: str) -> dict[str, bytes]:
    """Return the inputs kept for `parser`, by name; none for a new one."""
    if not (FOLDER / f"{parser}.zip").exists():
        return {}
    with zipfile.ZipFile(FOLDER / f"{parser}.zip") as archive:
        return {name: archive.read(name) for name in sorted(archive.namelist())}


def write_corpus(parser: str, inputs: dict[str, bytes]) -> None:
    """Replace the inputs kept for `parser`."""
    with zipfile.ZipFile(FOLDER / f"{parser}.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(inputs):
            archive.writestr(zipfile.ZipInfo(name, EPOCH), inputs[name], zipfile.ZIP_DEFLATED)


def unpack_corpus(parser: str, folder: Path) -> None:
    """Write the inputs kept for `parser` into `folder`, one file each."""
    for name, content in read_corpus(parser).items():
        (folder / name).write_bytes(content)
