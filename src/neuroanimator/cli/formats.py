"""Write a clip in the formats its file names ask for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from neuroanimator.animation.clip import Clip
from neuroanimator.animation.gauges import drawable
from neuroanimator.animation.push_out import push_out
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.export.csv_file import write_clip
from neuroanimator.export.gltf.scene import write_glb
from neuroanimator.export.usd.scene import write_usd
from neuroanimator.files.zoo import find_emulator
from neuroanimator.film.options import Film

FORMATS = (".csv", ".glb", ".mp4", ".usda", ".usdc", ".usdz")
"""Suffixes of the files that can be written."""


def emulator_for(outs: list[Path], name: str) -> Emulator:
    """Return the emulator called `name`; refuse file names no clip can be exported to, before any work is done."""
    _check_formats(outs)
    return Emulator.load(find_emulator(name))


def export_clips(
    clips: Sequence[Clip],
    emulator: Emulator,
    outs: list[Path],
    film: Film,
    *,
    is_pushed_out: bool = True,
) -> None:
    """Write `clips` together to each path as .csv, .glb, USD or .mp4 (a `film`); nothing is written if one is refused.

    A system without bodies is drawn as gauges: see `drawable`. The surface of a soft body is drawn outside its
    colliders if it `is_pushed_out`: see `push_out`. A table holds only one body.
    """
    _check_formats(outs)
    tables = [path for path in outs if path.suffix == ".csv"]
    if tables and len(clips) > 1:
        raise ArgumentError(
            f"out: '{tables[0].name}': a .csv holds one body, and here are more. Choose another format."
        )
    drawn = [drawable(clip, emulator) for clip in clips]
    if is_pushed_out and len(tables) < len(outs):
        drawn = [push_out(clip, emulator) for clip in drawn]
    for path in outs:
        if path in tables:
            write_clip(clips[0], path, emulator.state)
        else:
            _draw(drawn, path, film)


def _draw(clips: Sequence[Clip], path: Path, film: Film) -> None:
    if path.suffix == ".glb":
        write_glb(clips, path)
    elif path.suffix == ".mp4":
        from neuroanimator.film.video import write_video  # with it comes MuJoCo, which draws

        write_video(clips, path, size=film.size, camera=film.camera)
    else:
        write_usd(clips, path)


def _check_formats(outs: list[Path]) -> None:
    for path in outs:
        if path.suffix not in FORMATS:
            raise ArgumentError(f"out: '{path.name}' ends in none of {', '.join(FORMATS)}.")
