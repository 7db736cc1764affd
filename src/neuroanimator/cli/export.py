"""The verb `export`: write an emulator or a policy for another program, or a stored clip in another format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from neuroanimator.cli.formats import FORMATS, emulator_for, export_clips
from neuroanimator.cli.shared_options import SIZE, Camera, Size
from neuroanimator.errors import ArgumentError
from neuroanimator.export.csv_file import read_clip
from neuroanimator.export.programs.formats import POLICY_ENDING, export_programs
from neuroanimator.film.options import read_film
from neuroanimator.terminal import Rows, phase, print_rows
from neuroanimator.text import print_line, quoted

MODELS = ("emulator", "policy")
"""Models that `--what` may ask for."""

EXAMPLE = "neuroanimator export fish-50 --out fish.onnx"


def run(
    source: Annotated[
        str,
        typer.Argument(
            help="Emulator or policy, a file or the name of a shipped one; or a CSV clip written by 'animate'."
        ),
    ],
    out: Annotated[
        list[Path],
        typer.Option(
            help="File ending in .h, .wasm or .onnx (the latter two need the extras wasm and onnx); "
            f"for a clip in one of {', '.join(FORMATS)}. May be repeated."
        ),
    ],
    policy: Annotated[
        bool,
        typer.Option(
            "--policy", help="If a name is both an emulator and a policy, export the policy."
        ),
    ] = False,
    what: Annotated[
        str | None,
        typer.Option(help="policy (as --policy), or emulator: of a policy's file, the one inside."),
    ] = None,
    emulator: Annotated[
        str | None, typer.Option(help="For a clip: file or name of the emulator it belongs to.")
    ] = None,
    size: Size = SIZE,
    camera: Camera = "follow",
) -> None:
    """Export an emulator or a policy as a program that needs no Python, checked against JAX; a clip as GLB or MP4."""
    if Path(source).suffix == ".csv":
        _export_clip(Path(source), emulator, out, size, camera)
    else:
        _export_programs(source, out, what or ("policy" if policy else None))


def _export_programs(reference: str, out: list[Path], what: str | None) -> None:
    if what not in (None, *MODELS):
        raise ArgumentError(f"--what: wanted one of {', '.join(MODELS)}, got {quoted(what)}.")
    with phase("exporting"):
        every = export_programs(
            reference, out, is_policy=what == "policy", is_emulator=what == "emulator"
        )
    for written in every:
        print_line(written.summary())
    if what is None and reference.endswith(POLICY_ENDING):
        print_line("This is the policy. For the emulator inside it: --what emulator")


def _export_clip(clip: Path, emulator: str | None, out: list[Path], size: str, camera: str) -> None:

    if emulator is None:
        raise ArgumentError(f"{clip}: a clip needs --emulator, the one it belongs to.")
    film = read_film(size, camera)
    with phase("loading"):
        model = emulator_for(out, emulator)
        motion = read_clip(clip, model)
    with phase("drawing"):
        export_clips([motion], model, out, film)
    rows: Rows = [("frames", len(motion.times))]
    rows += [("file", path) for path in out]
    print_rows(rows)
