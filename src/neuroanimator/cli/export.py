"""The verb `export`: write a stored clip in another format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from neuroanimator.cli.animate import CAMERA_HELP, SIZE, SIZE_HELP

EXAMPLE = "neuroanimator export swing.csv --emulator pendulum --out swing.glb"


def run(
    clip: Annotated[Path, typer.Argument(help="CSV clip written by 'animate'.")],
    emulator: Annotated[str, typer.Option(help="Emulator file or name the clip belongs to.")],
    out: Annotated[
        list[Path],
        typer.Option(help="File ending in .glb, .mp4 or .csv; may be given several times."),
    ],
    size: Annotated[str, typer.Option(help=SIZE_HELP)] = SIZE,
    camera: Annotated[str, typer.Option(help=CAMERA_HELP)] = "follow",
) -> None:
    """Export a clip as GLB for Blender and the web, or as MP4 video."""
    from neuroanimator.export.film.options import read_film
    from neuroanimator.terminal import phase, print_rows

    film = read_film(size, camera)
    with phase("loading"):
        from neuroanimator.export.csv_file import read_clip
        from neuroanimator.export.formats import emulator_for, export_clip

        model = emulator_for(out, emulator)
        motion = read_clip(clip, model)
    with phase("drawing"):
        export_clip(motion, model, out, film)
    rows: list[tuple[str, object]] = [("frames", len(motion.times))]
    rows += [("file", path) for path in out]
    print_rows(rows)
