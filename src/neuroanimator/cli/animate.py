"""The verb `animate`: write a motion of an emulator as a film, a GLB or a CSV file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from neuroanimator.animation.clip import make_clip
from neuroanimator.cli.formats import FORMATS, emulator_for, export_clips
from neuroanimator.cli.motion_sources import MotionOptions, motion_of
from neuroanimator.cli.shared_options import SIZE, START_HELP, Camera, Size
from neuroanimator.emulator.trust_summary import summary_of
from neuroanimator.export.garment import wear as wear_garment
from neuroanimator.film.options import read_film
from neuroanimator.terminal import phase, print_rows
from neuroanimator.text import print_line

EXAMPLE = "neuroanimator animate dolphin --out swim.glb --out swim.mp4 --size 1920x1080 --camera front --rate 60"

TRUST_HELP = (
    "Show in films how far to trust the emulator: a curve, and a glow where it leaves its training."
)
"""The help of `--trust`."""

HYBRID_HELP = "Let the physics take over where the emulator is not trusted; prints the share of time it takes, and the error."
"""The help of `--hybrid`."""

THRESHOLD_HELP = (
    "With --hybrid: score from which the physics takes over (default 1); 0 for physics alone."
)
"""The help of `--threshold`."""

SYSTEM_HELP = (
    "With --hybrid, or for a policy: your TOML file, whose model or step function is then used."
)
"""The help of `--system`."""

PATH_HELP = (
    "For soft bodies: a mover and the path it follows, MOVER=FILE.csv (columns time, x, y, z), MOVER=FILE.csv:PART or "
    "MOVER=FILE.glb:NODE; or FILE.glb, whose nodes move the movers called alike. May be given several times."
)
"""The help of `--path`."""

PUSH_OUT_HELP = "Push a soft body's surface out of colliders, or draw it exactly as predicted."
"""The help of `--push-out`."""

PATH_SPEED_HELP = "With --path: its playback speed; 0.5 is half as fast."
"""The help of `--path-speed`."""

WEAR_HELP = (
    "Emulator file of a garment, or name of a shipped one, whose movers are called as the body's bones: it is worn. May be "
    "given several times."
)
"""The help of `--wear`."""

INSIDE_HELP = "For a policy file: move the body by the policy's own emulator, which 'train' makes, instead of the physics."
"""The help of `--in-emulator`."""

COMMAND_HELP = (
    "For a policy that walks on command: SECONDS,SPEED,TURN [s, m/s, rad/s to the left], such as 3,0.7,0.4; may be given several "
    "times, in order."
)
"""The help of `--command`."""


def run(
    emulator: Annotated[
        str,
        typer.Argument(
            help="Emulator file, or name of a shipped one; or a policy file made by 'policy', which moves the physics."
        ),
    ],
    out: Annotated[
        list[Path],
        typer.Option(
            help=f"File ending in one of {', '.join(FORMATS)}; may be given several times."
        ),
    ],
    seconds: Annotated[
        float | None,
        typer.Option(help="Length of a random motion [s]."),
    ] = None,
    controls: Annotated[
        Path | None,
        typer.Option(help="CSV of controls, as 'control' writes; from rest, or from --start."),
    ] = None,
    path: Annotated[list[str] | None, typer.Option(help=PATH_HELP)] = None,
    path_speed: Annotated[float | None, typer.Option(help=PATH_SPEED_HELP)] = None,
    start: Annotated[list[str] | None, typer.Option(help=START_HELP)] = None,
    command: Annotated[list[str] | None, typer.Option(help=COMMAND_HELP)] = None,
    in_emulator: Annotated[bool, typer.Option("--in-emulator", help=INSIDE_HELP)] = False,
    wear: Annotated[list[str] | None, typer.Option(help=WEAR_HELP)] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of a random motion.")] = None,
    school: Annotated[
        int | None,
        typer.Option(
            help="Number of bodies that swim together, steered by the shipped policy of dolphin or fish."
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(help="Frames per second, such as 60; default 30, fewer for slow systems."),
    ] = None,
    size: Size = SIZE,
    camera: Camera = "follow",
    interpolation: Annotated[str, typer.Option(help="hermite, or linear as in 1998.")] = "hermite",
    trust: Annotated[bool, typer.Option("--trust", help=TRUST_HELP)] = False,
    hybrid: Annotated[bool, typer.Option("--hybrid", help=HYBRID_HELP)] = False,
    push_out: Annotated[bool, typer.Option("--push-out/--no-push-out", help=PUSH_OUT_HELP)] = True,
    threshold: Annotated[float | None, typer.Option(help=THRESHOLD_HELP)] = None,
    system: Annotated[Path | None, typer.Option(help=SYSTEM_HELP)] = None,
) -> None:
    """Animate a system's showcase motion, one found by 'control', or a random one, without running the physics."""
    film = read_film(size, camera)
    garments = [emulator_for(out, name) for name in wear or ()]
    motion = motion_of(
        MotionOptions(
            emulator=emulator,
            out=out,
            seconds=seconds,
            seed=seed,
            controls=controls,
            path=path,
            path_speed=path_speed,
            start=start,
            command=command,
            in_emulator=in_emulator,
            school=school,
            trust=trust,
            hybrid=hybrid,
            threshold=threshold,
            system=system,
        )
    )
    clips = [
        make_clip(
            motion.emulator,
            states,
            rate=rate,
            interpolation=interpolation,
            source=motion.made_by,
            trust=motion.scores,
        )
        for states in motion.states
    ]
    rows = list(motion.rows)
    for garment in garments:
        with phase(f"dressing in {garment.system}"):
            worn = wear_garment(clips[0], garment)
        for remark in worn.remarks:
            print_line(f"neuroanimator: {remark}", to_stderr=True)
        rows.append((garment.system, summary_of(garment, worn.scores)))
        clips.append(worn.clip)
    with phase("drawing"):
        export_clips(clips, motion.emulator, out, film, is_pushed_out=push_out)
    shown = clips[0].times
    files = [("file", path) for path in out]
    print_rows([("frames", len(shown)), ("seconds", f"{shown[-1]:.2f}"), *rows, *files])
