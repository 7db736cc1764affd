"""The verb `new`: bring your own model, step function or recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EXAMPLE = "neuroanimator new my_robot.xml"


def run(
    model: Annotated[
        str,
        typer.Argument(
            help="MJCF or URDF file, a Gymnasium environment such as Swimmer-v5, a Python file with a function "
            "step(state, control, dt), or recordings in CSV or NPZ."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="TOML file to write; beside the model if not given.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the TOML file.")] = False,
) -> None:
    """Check a model and write how an emulator should see it: a TOML file to read, edit and generate from."""
    from neuroanimator.terminal import phase, print_rows

    with phase("loading"):
        from neuroanimator.scaffold.write_toml import write_definition
    with phase("checking the model"):
        path, proposal = write_definition(model, out, force=force)
    definition = proposal.definition
    name = definition.name
    dt = definition.substeps * definition.physics.step
    following = f"edit {path}, then: neuroanimator train {path} --out {name}.emulator.safetensors"
    print_rows(
        [
            ("system", name),
            ("super step", f"{definition.substeps} physics steps, {dt:g} s"),
            ("written", path),
            ("next", following),
        ]
    )
