"""`animate`: a motion from an emulator."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EXAMPLE = "neuroanimator animate pendulum --seconds 5 --seed 1 --out swing.glb --out swing.mp4"


def run(
    emulator: Annotated[str, typer.Argument(help="Emulator file, or name of a shipped one.")],
    out: Annotated[list[Path], typer.Option(help="File ending in .glb, .mp4 or .csv; may be given several times.")],
    seconds: Annotated[float, typer.Option(help="Length of a random motion [s].")] = 5.0,
    controls: Annotated[Path | None, typer.Option(help="CSV of controls, as 'control' writes; from rest.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of start and controls.")] = 0,
    rate: Annotated[float, typer.Option(help="Frames a second.")] = 30.0,
    interpolation: Annotated[str, typer.Option(help="hermite, or linear as in 1998.")] = "hermite",
) -> None:
    """Animate a random motion, or one found by 'control', without running the physics."""
    from neuroanimator.animation.clip import make_clip
    from neuroanimator.animation.motion import controlled_motion, random_motion
    from neuroanimator.export.by_suffix import emulator_for, export_clip
    from neuroanimator.export.table import read_table
    from neuroanimator.terminal import print_rows

    model = emulator_for(out, emulator)
    if controls:
        states = controlled_motion(model, read_table(controls, model.identity.control)[1])
    else:
        states = random_motion(model, seconds, seed)
    clip = make_clip(model, states, rate=rate, interpolation=interpolation)
    export_clip(clip, model, out)
    print_rows([("frames", len(clip.times)), ("seconds", f"{clip.times[-1]:.2f}"), *(("file", path) for path in out)])
