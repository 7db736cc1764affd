"""The page and its emulators as files that any web host serves; nothing of them is fetched from elsewhere."""

from __future__ import annotations

import json
from pathlib import Path

from neuroanimator import ArgumentError, ResourceError
from neuroanimator.authoring import write_whole
from neuroanimator_studio.catalogue import catalogue
from neuroanimator_studio.server import served_files
from neuroanimator_studio.studio import page_files

CATALOGUE = "catalogue.json"


def export_site(page_folder: Path, bundles: list[Path], folder: Path) -> list[Path]:
    """Write the page and `bundles` into `folder`, which is new, empty or an earlier site; return what was written.

    The catalogue, without which the page shows nothing, is written last.
    """
    _check_folder(folder)
    written = []
    for name, source in page_files(page_folder).items():
        written.append(_copied(source, folder / name.removeprefix("/")))
    for bundle in bundles:
        for name in served_files(bundle):
            written.append(_copied(bundle / name, folder / "bundles" / bundle.name / name))
    described = catalogue(bundles, has_server=False)
    write_whole(folder / CATALOGUE, json.dumps(described).encode("ascii"))
    return [*written, folder / CATALOGUE]


def _check_folder(folder: Path) -> None:
    """Refuse a folder with files in it that are none of a site's."""
    if not folder.exists() or (folder / CATALOGUE).is_file():
        return
    if not folder.is_dir() or any(folder.iterdir()):
        raise ArgumentError(
            f"export: '{folder.name}' exists and is not a site. Name a new or an empty folder."
        )


def _copied(source: Path, target: Path) -> Path:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResourceError(f"Could not write {target.parent}: {error.strerror}.") from error
    write_whole(target, source.read_bytes())
    return target
