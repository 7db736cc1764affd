"""What there is to see: the bundles that ship, and those of emulators that were dropped on the page."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import neuroanimator

BUNDLE = "bundle.json"
"""The file of a bundle that says everything but programs."""

EMULATOR_WASM = "emulator.wasm"
"""What makes super steps."""

PHYSICS_WASM = "physics.wasm"
"""The true physics beside it, of mass-spring bodies."""

PROGRAMS = (EMULATOR_WASM, "policy.wasm", PHYSICS_WASM)
"""All that a bundle may have in it to show and steer a body; descents come on top."""

WITH_DESCENT = ("dolphin-50", "fish-50", "truck-50", "lander-50", "pendulum-50")
"""The emulators that ship as bundles with a goal to be reached in the page, in the order it shows them."""

SHIPPED_BUNDLES = (*WITH_DESCENT, "pendulum-passive-50")
"""All emulators that ship as bundles; what has no motors reaches no goal."""

PHYSICS_BUNDLES = ("cube",)
"""The systems without an emulator, of which the page runs the physics itself; they come after the others."""


def shipped_folder() -> Path:
    """Return where the shipped bundles lie."""
    return Path(__file__).parent / "bundles"


def shipped_bundles() -> list[Path]:
    """Return the folders of the bundles that ship."""
    return [shipped_folder() / name for name in (*SHIPPED_BUNDLES, *PHYSICS_BUNDLES)]


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
