"""What there is to see: the bundles that ship, and those of emulators that were dropped on the page."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import neuroanimator
from neuroanimator.authoring import SHIPPED_SYSTEMS, WITHOUT_EMULATOR, emulator_name

BUNDLE = "bundle.json"
"""The file of a bundle that says everything but programs."""

EMULATOR_WASM = "emulator.wasm"
"""What makes super steps."""

PHYSICS_WASM = "physics.wasm"
"""The true physics beside it, of mass-spring bodies."""

PROGRAMS = (EMULATOR_WASM, "policy.wasm", PHYSICS_WASM)
"""All that a bundle may have in it to show and steer a body; descents come on top."""

SHIPPED_BUNDLES = tuple(
    emulator_name(name, system.substeps[0])
    for name, system in SHIPPED_SYSTEMS.items()
    if system.substeps
)
"""The emulators that ship as bundles, in the order in which the page shows them."""

PHYSICS_BUNDLES = WITHOUT_EMULATOR
"""The systems without an emulator, of which the page runs the physics itself; they come after the others."""


class Example(NamedTuple):
    """A file among the examples that ships as a bundle."""

    file: str
    """Its path in a checkout."""
    about: str
    scenery: str
    falls: str
    """Its path to recorded falls of the body, each until it stands again."""


EXAMPLE_BUNDLES = {
    "human": Example(
        "examples/human/human.policy.safetensors",
        "A human who stands, walks and runs on command, as in recorded motions; arrow keys steer him",
        "meadow",
        "examples/human/falls.safetensors",
    )
}
"""Bundles of what was learnt in the examples, by id; they come last, each with its file: no emulator of the package is theirs."""

EMULATOR = "emulator.safetensors"
"""File of the emulator or policy that a bundle was made of, in it."""


def shipped_folder() -> Path:
    """Return where the shipped bundles lie."""
    return Path(__file__).parent / "bundles"


def shipped_bundles() -> list[Path]:
    """Return the folders of the bundles that ship."""
    names = (*SHIPPED_BUNDLES, *PHYSICS_BUNDLES, *EXAMPLE_BUNDLES)
    return [shipped_folder() / name for name in names]


def catalogue(folders: Iterable[Path], *, has_server: bool) -> dict[str, Any]:
    """Return `catalogue.json` of the bundles in `folders`, each of whose names is the bundle's id."""
    entries = [_entry(folder) for folder in folders]
    return {
        "version": neuroanimator.__version__,
        "has_server": has_server,
        "systems": list(SHIPPED_SYSTEMS),
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
