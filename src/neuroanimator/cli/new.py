"""The verb `new`: bring your own model, step function or recordings."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from neuroanimator.scaffold.write_toml import checked_base, write_definition
from neuroanimator.terminal import phase, print_rows
from neuroanimator.text import print_line

EXAMPLE = "neuroanimator new my_robot.xml"


def run(
    model: Annotated[
        str,
        typer.Argument(
            help="MJCF or URDF file, a Gymnasium environment such as Swimmer-v5, a Python file with a function "
            "step(state, control, dt), recordings in CSV or NPZ, or the mesh of a cloth in OBJ."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="TOML file to write; beside the model if not given.")
    ] = None,
    name: Annotated[
        str, typer.Option(help="Name of the system; that of its file if not given.")
    ] = "",
    keyframe: Annotated[
        str,
        typer.Option(
            help="Keyframe of the model that is its state of rest; default 'home' or the first."
        ),
    ] = "",
    base: Annotated[
        str, typer.Option(help="For a URDF: 'fixed' to the world, or 'free' to move over a floor.")
    ] = "fixed",
    passive: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT",
            help="Joint of a URDF that gets no motor despite its effort limit; may be given several times.",
        ),
    ] = None,
    tree: Annotated[
        Path | None,
        typer.Option(
            help="Folder that may hold the model's includes and meshes; the model's own if not given."
        ),
    ] = None,
    resample: Annotated[
        bool,
        typer.Option(
            "--resample", help="Interpolate recordings whose samples are not evenly spaced."
        ),
    ] = False,
    velocities: Annotated[
        bool,
        typer.Option("--velocities", help="Estimate velocities that recordings do not hold."),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the TOML file.")] = False,
) -> None:
    """Check a model and write its definition for emulators: a TOML file to read, edit and generate from."""
    with phase("checking the model"):
        path, proposal = write_definition(
            model,
            out,
            force=force,
            keyframe=keyframe,
            base=checked_base(base),
            passive=tuple(passive or ()),
            name=name,
            tree=tree,
            resample=resample,
            velocities=velocities,
        )
    definition = proposal.definition
    dt = definition.substeps * definition.physics.step
    made = quote(f"{path.stem}.emulator.safetensors")
    following = f"edit {path}, then: neuroanimator train {quote(str(path))} --out {made}"
    for warning in proposal.warnings:
        print_line(f"warning: {warning}", to_stderr=True)
    rows: list[tuple[str, object]] = [
        ("system", definition.name),
        ("super step", f"{definition.substeps} physics steps, {dt:g} s"),
    ]
    rows += [*proposal.told, ("written", path), ("next", following)]
    print_rows(rows)
