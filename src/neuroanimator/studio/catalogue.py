"""What there is to see: the bundles that ship, and those of emulators that were dropped on the page."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import neuroanimator

BUNDLE = "bundle.json"
"""The file of a bundle that says everything but programs."""

SHIPPED_BUNDLES = ("dolphin-50", "fish-50", "truck-50", "lander-50", "pendulum-50")
"""The emulators that ship as bundles, in the order the page shows them."""


def shipped_folder() -> Path:
    """Return where the shipped bundles lie."""
    return Path(__file__).parent / "bundles"


def shipped_bundles() -> list[Path]:
    """Return the folders of the bundles that ship."""
    return [shipped_folder() / name for name in SHIPPED_BUNDLES]


def catalogue(folders: Iterable[Path], *, has_server: bool) -> dict[str, Any]:
    """Return `catalogue.json` of the bundles in `folders`, each of whose names is the bundle's id."""
    entries = [_entry(folder) for folder in folders]
    return {
        "version": neuroanimator.__version__,
        "has_server": has_server,
        "entries": entries,
    }


def _entry(folder: Path) -> dict[str, Any]:
    facts = json.loads((folder / BUNDLE).read_text(encoding="ascii"))
    return {
        "id": folder.name,
        "system": facts["system"],
        "title": facts["title"],
        "about": facts["about"],
        "bundle": f"bundles/{folder.name}/",
    }
