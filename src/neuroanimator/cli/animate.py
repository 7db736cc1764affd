"""The verb `animate`: write a motion of an emulator as a film, a GLB or a CSV file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from jaxtyping import Float

from neuroanimator.animation.clip import Clip, make_clip
from neuroanimator.animation.motion import (
    controlled_drive,
    default_drive,
    named_start,
    random_drive,
)
from neuroanimator.animation.path_drive import path_drive
from neuroanimator.cli.formats import emulator_for, export_clip, export_school
from neuroanimator.cli.usage import refuse_given
from neuroanimator.control.policies.school import school_clips
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust_summary import TrustSummary, summary_of
from neuroanimator.errors import ArgumentError
from neuroanimator.export.csv_file import read_controls
from neuroanimator.export.programs.formats import POLICY_ENDING
from neuroanimator.film.options import CAMERAS, DEFAULT_SIZE, read_film
from neuroanimator.physics import tied_system
from neuroanimator.state.start import read_starts
from neuroanimator.terminal import phase, print_rows
from neuroanimator.text import print_line, quoted

if TYPE_CHECKING:
    from neuroanimator.learn.evaluation.hybrid_shares import HybridGain

EXAMPLE = "neuroanimator animate dolphin --out swim.glb --out swim.mp4 --size 1920x1080 --camera front --rate 60"

SIZE = "{}x{}".format(*DEFAULT_SIZE)
"""Default size of a film [pixels], as on the command line."""

SIZE_HELP = "Width x height of a film [pixels]."
"""The help of `--size`, here and in `export`."""

CAMERA_HELP = (
    "For films: " + "; ".join(f"{name} ({camera.about})" for name, camera in CAMERAS.items()) + "."
)
"""The help of `--camera`, here and in `export`."""

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
    "MOVER=FILE.glb:NODE; may be given several times."
)
"""The help of `--path`."""

PUSH_OUT_HELP = "Push a soft body's surface out of colliders, or draw it exactly as predicted."
"""The help of `--push-out`."""

PATH_SPEED_HELP = "With --path: its playback speed; 0.5 is half as fast."
"""The help of `--path-speed`."""

INSIDE_HELP = "For a policy file: move the body by the policy's own emulator, which 'train' makes, instead of the physics."
"""The help of `--in-emulator`."""

COMMAND_HELP = (
    "For a policy that walks on command: SECONDS,SPEED,TURN [s, m/s, rad/s to the left], such as 3,0.7,0.4; may be given several "
    "times, in order."
)
"""The help of `--command`."""

START_HELP = "Part of the initial state, such as root.position=3,-2,8; may be given several times."


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
            help="File ending in .glb, .usda, .usdc, .usdz, .mp4 or .csv; may be given several times."
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
    size: Annotated[str, typer.Option(help=SIZE_HELP)] = SIZE,
    camera: Annotated[str, typer.Option(help=CAMERA_HELP)] = "follow",
    interpolation: Annotated[str, typer.Option(help="hermite, or linear as in 1998.")] = "hermite",
    trust: Annotated[bool, typer.Option("--trust", help=TRUST_HELP)] = False,
    hybrid: Annotated[bool, typer.Option("--hybrid", help=HYBRID_HELP)] = False,
    push_out: Annotated[bool, typer.Option("--push-out/--no-push-out", help=PUSH_OUT_HELP)] = True,
    threshold: Annotated[float | None, typer.Option(help=THRESHOLD_HELP)] = None,
    system: Annotated[Path | None, typer.Option(help=SYSTEM_HELP)] = None,
) -> None:
    """Animate a system's showcase motion, one found by 'control', or a random one, without running the physics."""
    film = read_film(size, camera)
    if emulator.endswith(POLICY_ENDING) and school is None:
        refuse_given(
            {"controls": controls, "path": path, "start": start, "hybrid": hybrid, "trust": trust},
            "a policy determines its own start and motion. Leave it out.",
        )
        model, states = _moved_by_policy(
            Path(emulator), system, command, seconds, seed, is_inside=in_emulator
        )
        source = "emulator" if in_emulator else "physics"
        clip = make_clip(model, states, rate=rate, interpolation=interpolation, source=source)
        with phase("drawing"):
            export_clip(clip, model, out, film)
        return print_rows(_rows(clip, out))
    refuse_given(
        {"command": command, "in-emulator": in_emulator},
        "applies to policy files only. Leave it out.",
    )
    if not hybrid:
        refuse_given(
            {"threshold": threshold, "system": system},
            "applies to --hybrid only. Give --hybrid, too.",
        )
    _check_path(path, path_speed, {"controls": controls, "start": start, "seed": seed})
    with phase("loading"):
        model = emulator_for(out, emulator)
    if school is not None:
        others = {
            "controls": controls,
            "path": path,
            "start": start,
            "trust": trust,
            "hybrid": hybrid,
            "interpolation": interpolation != "hermite",
        }
        refuse_given(others, "a school is steered by its policy. Leave it out, or --school.")
        with phase("emulating"):
            clips = school_clips(model, school, seconds=seconds, seed=seed or 0, rate=rate)
        with phase("drawing"):
            export_school(clips, out, film)
        return print_rows(_rows(clips[0], out))
    with phase("emulating"):
        tied = tied_system(model.spec)
        start_state = None
        if start:
            start_state = named_start(model, read_starts(start), tied)
        if path:
            drive = path_drive(
                model,
                _paths(path),
                speed=1.0 if path_speed is None else path_speed,
                seconds=seconds,
            )
        elif controls:
            drive = controlled_drive(model, read_controls(controls, model), start_state)
        elif seconds is None and seed is None and start_state is None:
            drive = default_drive(model, tied)
        else:
            drive = random_drive(model, seconds, seed or 0, start_state, tied)
        gain = None
        if hybrid:
            from neuroanimator.cli.in_turns import motion_in_turns  # with it comes MuJoCo

            motion, gain = motion_in_turns(model, drive, threshold, system)
            states = motion.states
            scores = motion.scores
        else:
            states, scores = drive.trusted_motion(model)
    for remark in drive.remarks:
        print_line(f"neuroanimator: {remark}", to_stderr=True)
    clip = make_clip(
        model,
        states,
        rate=rate,
        interpolation=interpolation,
        source="hybrid" if hybrid else "emulator",
        trust=scores if trust else None,
    )
    with phase("drawing"):
        export_clip(clip, model, out, film, is_pushed_out=push_out)
    return print_rows(_rows(clip, out, summary_of(model, scores), gain))


def _rows(
    clip: Clip,
    out: list[Path],
    trust: TrustSummary | None = None,
    gain: HybridGain | None = None,
) -> list[tuple[str, object]]:
    """Return the rows that the verb prints."""
    rows: list[tuple[str, object]] = [
        ("frames", len(clip.times)),
        ("seconds", f"{clip.times[-1]:.2f}"),
    ]
    if trust is not None:
        rows.append(("trust", trust))
    if gain is not None:
        rows.append(("hybrid", gain))
    return [*rows, *(("file", path) for path in out)]


def _moved_by_policy(
    policy: Path,
    system: Path | None,
    command: list[str] | None,
    seconds: float | None,
    seed: int | None,
    *,
    is_inside: bool,
) -> tuple[Emulator, Float[np.ndarray, "K S"]]:
    """Return (the policy's emulator, states of a motion): on command, or of an episode as in learning."""
    with phase("loading"):
        from neuroanimator.cli.policy_returns import commanded_motion, policy_motion  # with MuJoCo

    if not command:
        return policy_motion(policy, system, seconds, seed or 0, is_inside=is_inside)
    refuse_given(
        {"seconds": seconds, "seed": seed},
        "commands already determine the motion. Leave one of them out.",
    )
    return commanded_motion(policy, system, command, is_inside=is_inside)


def _check_path(
    path: list[str] | None, path_speed: float | None, others: dict[str, object]
) -> None:
    """Refuse the `others` beside a path, and a speed without a path."""
    if path:
        refuse_given(
            others,
            "a motion along a path begins and moves as the path does. Leave it out, or --path.",
        )
    elif path_speed is not None:
        raise ArgumentError("path-speed: applies to --path only. Give --path, too.")


def _paths(texts: list[str]) -> dict[str, str]:
    """Return the source of each mover's path, by the mover's name."""
    paths: dict[str, str] = {}
    for text in texts:
        name, equals, source = text.partition("=")
        if not equals or not name or not source:
            raise ArgumentError(
                f"path: wanted MOVER=FILE such as torso=walk.csv, got {quoted(text)}."
            )
        if name in paths:
            raise ArgumentError(f"path: {quoted(name)} has two paths. Give one.")
        paths[name] = source
    return paths
