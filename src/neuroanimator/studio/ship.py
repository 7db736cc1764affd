"""Remake the bundles that ship: `python -m neuroanimator.studio.ship [NAME...]`, after an emulator that ships has changed."""

from __future__ import annotations

import sys

from neuroanimator.studio.bundle import make_bundle
from neuroanimator.studio.catalogue import SHIPPED_BUNDLES, shipped_folder
from neuroanimator.text import print_line


def ship(names: list[str]) -> None:
    """Make the bundles `names` anew."""
    for name in names:
        folder = make_bundle(name, shipped_folder() / name)
        for path in sorted(folder.iterdir()):
            print_line(f"{path.relative_to(shipped_folder())}: {path.stat().st_size:,} bytes")


if __name__ == "__main__":
    ship(sys.argv[1:] or list(SHIPPED_BUNDLES))
