"""Write the extension for Blender, with the creatures that ship: dist/neuroanimator-blender.zip.

    python blender/build.py

Install it in Blender 4.2 or newer: Edit > Preferences > Get Extensions > Install from Disk.
"""

from __future__ import annotations

import tempfile
import zipfile
from pathlib import Path

from npz_file import write_npz

import neuroanimator as na
from neuroanimator.terminal import progress_bar

HERE = Path(__file__).parent
ZIP = HERE.parent / "dist" / "neuroanimator-blender.zip"
CREATURES = ("dolphin", "fish", "lander", "pendulum", "truck")
POLICIES = ("dolphin", "fish")
SUBSTEPS = 50
"""Of the emulators that go with the extension: those which policies steer."""

LICENCE = "Apache-2.0"

BEGINNING = (1980, 1, 1, 0, 0, 0)
"""The date of every file: the same extension is the same bytes."""


def build(path: Path, creatures: tuple[str, ...] = CREATURES) -> None:
    """Write the extension with these creatures to `path`."""
    contents = {file.name: file.read_bytes() for file in (HERE / "extension").glob("*.*")}
    with tempfile.TemporaryDirectory() as folder, progress_bar("exporting", len(creatures)) as bar:
        for number, name in enumerate(creatures):
            file = Path(folder) / f"{name}.npz"
            write_npz(na.load_emulator(f"{name}-{SUBSTEPS}"), file, LICENCE)
            contents[f"emulators/{file.name}"] = file.read_bytes()
            if name in POLICIES:
                policy = Path(folder) / f"{name}.policy.npz"
                write_npz(na.load_policy(name), policy, LICENCE)
                contents[f"emulators/{policy.name}"] = policy.read_bytes()
            bar.advance_to(number + 1)
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted(contents.items()):
            archive.writestr(zipfile.ZipInfo(name, BEGINNING), content)


if __name__ == "__main__":
    build(ZIP)
    print(
        f"{ZIP}: {ZIP.stat().st_size / 1e6:.1f} MB. In Blender: Preferences > Get Extensions > Install from Disk."
    )
