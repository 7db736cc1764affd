"""The verb `animate`: write a motion of an emulator as a film, a GLB or a CSV file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from neuroanimator.export.film.options import CAMERAS, DEFAULT_SIZE

if TYPE_CHECKING:
    from neuroanimator.animation.clip import Clip
    from neuroanimator.emulator.trust_summary import TrustSummary

EXAMPLE = "neuroanimator animate dolphin --out swim.glb --out swim.mp4 --size 1920x1080 --camera front --rate 60"

SIZE = "{}x{}".format(*DEFAULT_SIZE)
"""A film has this size [pixels], written as on the command line, if nothing else is said."""

SIZE_HELP = "Width x height of a film [pixels]."
"""The help of `--size`, here and in `export`."""

CAMERA_HELP = "Of a film: " + "; ".join(f"{name} ({does})" for name, does in CAMERAS.items()) + "."
"""The help of `--camera`, here and in `export`."""

TRUST_HELP = "Show in films how far to believe the emulator: a curve, and a glow where it leaves its training."
"""The help of `--trust`."""

START_HELP = (
    "Part of the state to start with, such as root.position=3,-2,8; may be given several times."
)


def run(
    emulator: Annotated[str, typer.Argument(help="Emulator file, or name of a shipped one.")],
    out: Annotated[
        list[Path],
        typer.Option(
            help="File ending in .glb, .usda, .usdc, .usdz, .mp4 or .csv; may be given several times."
        ),
    ],
    seconds: Annotated[
        float | None,
        typer.Option(help="Length of a random motion [s]."),
    ] = None,
    controls: Annotated[
        Path | None,
        typer.Option(help="CSV of controls, as 'control' writes; from rest, or --start."),
    ] = None,
    start: Annotated[list[str] | None, typer.Option(help=START_HELP)] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of a random motion.")] = None,
    school: Annotated[
        int | None,
        typer.Option(help="So many swim together, by the policy that ships of dolphin or fish."),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(help="Frames a second, such as 60; 30 if not given, fewer of a slow system."),
    ] = None,
    size: Annotated[str, typer.Option(help=SIZE_HELP)] = SIZE,
    camera: Annotated[str, typer.Option(help=CAMERA_HELP)] = "follow",
    interpolation: Annotated[str, typer.Option(help="hermite, or linear as in 1998.")] = "hermite",
    trust: Annotated[bool, typer.Option("--trust", help=TRUST_HELP)] = False,
) -> None:
    """Animate the motion a system is best seen by, one found by 'control', or a random one, without running the physics."""

    from neuroanimator.export.film.options import read_film
    from neuroanimator.terminal import phase, print_rows

    film = read_film(size, camera)
    with phase("loading"):
        from neuroanimator.animation.clip import make_clip
        from neuroanimator.animation.motion import (
            controlled_drive,
            default_drive,
            named_start,
            random_drive,
        )
        from neuroanimator.emulator.trust_summary import scores_along, summary_of
        from neuroanimator.export.csv_file import read_table
        from neuroanimator.export.formats import emulator_for, export_clip, export_school
        from neuroanimator.state.start import read_starts

        model = emulator_for(out, emulator)
    if school is not None:
        _refuse_in_a_school(controls, start, interpolation, trust)
        with phase("emulating"):
            from neuroanimator.control.policies.school import school_clips

            clips = school_clips(model, school, seconds=seconds, seed=seed or 0, rate=rate)
        with phase("drawing"):
            export_school(clips, out, film)
        return print_rows(_rows(clips[0], out))
    with phase("emulating"):
        start_state = None
        if start:
            start_state = named_start(model, read_starts(start))
        if controls:
            _, control_rows = read_table(controls, model.control)
            drive = controlled_drive(model, control_rows, start_state)
        elif seconds is None and seed is None and start_state is None:
            drive = default_drive(model)
        else:
            drive = random_drive(model, seconds, seed or 0, start_state)
        states = drive.motion(model)
        scores = scores_along(model, states, drive.controls)
    clip = make_clip(
        model,
        states,
        rate=rate,
        interpolation=interpolation,
        source="emulator",
        trust=scores if trust else None,
    )
    with phase("drawing"):
        export_clip(clip, model, out, film)
    return print_rows(_rows(clip, out, summary_of(model, scores)))


def _rows(
    clip: Clip, out: list[Path], trust: TrustSummary | None = None
) -> list[tuple[str, object]]:
    """Return what the verb prints."""
    rows: list[tuple[str, object]] = [
        ("frames", len(clip.times)),
        ("seconds", f"{clip.times[-1]:.2f}"),
    ]
    if trust is not None:
        rows.append(("trust", trust))
    return [*rows, *(("file", path) for path in out)]


def _refuse_in_a_school(
    controls: Path | None, start: list[str] | None, interpolation: str, trust: bool
) -> None:
    """Refuse the options that a school has no use for."""
    from neuroanimator.errors import ArgumentError

    given = {
        "controls": controls,
        "start": start,
        "interpolation": interpolation != "hermite",
        "trust": trust,
    }
    for name, value in given.items():
        if value:
            raise ArgumentError(
                f"{name}: a school swims as its policy says. Leave it out, or --school."
            )
