"""Remake the bundles that ship, after an emulator that ships has changed: `python -m neuroanimator_studio.ship [NAME...]`.

With `--facts` only what they say is made anew, and programs stay as they are.
"""

from __future__ import annotations

import sys

from neuroanimator import Emulator
from neuroanimator.files.zoo import find_emulator
from neuroanimator.text import print_line
from neuroanimator_studio.bundle import (
    bundle_facts,
    make_bundle,
    policy_beside,
    write_facts,
)
from neuroanimator_studio.catalogue import (
    BUNDLE,
    PHYSICS_BUNDLES,
    SHIPPED_BUNDLES,
    shipped_folder,
)
from neuroanimator_studio.physics import physics_facts, write_physics_module


def ship(names: list[str]) -> None:
    """Make the bundles `names` anew."""
    for name in names:
        folder = shipped_folder() / name
        if name in PHYSICS_BUNDLES:
            folder.mkdir(parents=True, exist_ok=True)
            write_physics_module(name, folder)
            write_facts(physics_facts(name, folder), folder)
        else:
            make_bundle(name, folder)
        for path in sorted(folder.iterdir()):
            print_line(f"{path.relative_to(shipped_folder())}: {path.stat().st_size:,} bytes")


def ship_facts(names: list[str]) -> None:
    """Make anew what the bundles `names` say."""
    for name in names:
        path = shipped_folder() / name / BUNDLE
        if name in PHYSICS_BUNDLES:
            write_facts(physics_facts(name, path.parent), path.parent)
            continue
        source = find_emulator(name)
        emulator = Emulator.load(source)
        facts = bundle_facts(source, emulator, policy_beside(source, emulator), name)
        write_facts(facts, path.parent)


if __name__ == "__main__":
    words = sys.argv[1:]
    chosen = [word for word in words if not word.startswith("--")] or [
        *SHIPPED_BUNDLES,
        *PHYSICS_BUNDLES,
    ]
    if "--facts" in words:
        ship_facts(chosen)
    else:
        ship(chosen)
