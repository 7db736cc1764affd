"""The verb `new`: bring your own model, step function or recordings."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from neuroanimator.cli.shared_options import Resample
from neuroanimator.definitions.model import Definition
from neuroanimator.learn.data.config import SOFT_COUNT, USUAL_COUNT
from neuroanimator.scaffold.teacher import affordable_count
from neuroanimator.scaffold.write_toml import checked_base, write_definition
from neuroanimator.terminal import Rows, phase, print_rows
from neuroanimator.text import print_line

EXAMPLE = "neuroanimator new my_robot.xml"


def run(
    model: Annotated[
        str,
        typer.Argument(
            help="MJCF or URDF file, a Gymnasium environment such as Swimmer-v5, a Python file with a function "
            "step(state, control, dt), recordings in CSV or NPZ, or the mesh of a cloth in OBJ or of a solid in Gmsh's MSH."
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
    unit: Annotated[str, typer.Option(help="Unit of a mesh: mm, cm, m (default) or in.")] = "",
    up: Annotated[str, typer.Option(help="Axis of a mesh that points up: y or z (default).")] = "",
    keep: Annotated[
        str, typer.Option(help="Pieces of a mesh: all (default), or only the largest.")
    ] = "",
    character: Annotated[
        Path | None,
        typer.Option(
            help="For a cloth: GLB file of a character, whose bones hold and strike it, and move as in its first animation."
        ),
    ] = None,
    resample: Resample = False,
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
            unit=unit,
            up=up,
            keep=keep,
            character=character,
            resample=resample,
            velocities=velocities,
        )
    definition = proposal.definition
    dt = definition.substeps * definition.physics.step
    made = quote(f"{path.stem}.emulator.safetensors")
    usual = USUAL_COUNT if isinstance(definition, Definition) else SOFT_COUNT
    count = affordable_count(usual, proposal.data_seconds)
    data = quote(str(path))
    following = f"edit {path}, then: "
    if count < usual:
        folder = quote(f"{path.stem}.data")
        following += f"neuroanimator generate {data} --count {count} --out {folder}, and: "
        data = folder
    following += f"neuroanimator train {data} --out {made}"
    for warning in proposal.warnings:
        print_line(f"warning: {warning}", to_stderr=True)
    rows: Rows = [
        ("system", definition.name),
        ("super step", f"{definition.substeps} physics steps, {dt:g} s"),
    ]
    rows += [*proposal.told, ("written", path), ("next", following)]
    print_rows(rows)
