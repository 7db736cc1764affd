"""`export`: a stored clip in another format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EXAMPLE = "neuroanimator export swing.csv --emulator pendulum --out swing.glb"


def run(
    clip: Annotated[Path, typer.Argument(help="CSV clip written by 'animate'.")],
    emulator: Annotated[str, typer.Option(help="Emulator file or name the clip belongs to.")],
    out: Annotated[list[Path], typer.Option(help="File ending in .glb, .mp4 or .csv; may be given several times.")],
) -> None:
    """Export a clip as GLB for Blender and the web, or as MP4 video."""
    from neuroanimator.emulator.emulator import Emulator
    from neuroanimator.export.by_suffix import check_bodies, check_format, export_clip
    from neuroanimator.export.table import read_clip
    from neuroanimator.shipped import find_emulator
    from neuroanimator.terminal import print_rows

    for path in out:
        check_format(path)
    model = Emulator.load(find_emulator(emulator))
    for path in out:
        check_bodies(model.identity.skeleton, path)
    motion = read_clip(clip, model)
    for path in out:
        export_clip(motion, model, path)
    print_rows([("frames", len(motion.times)), *(("file", path) for path in out)])
