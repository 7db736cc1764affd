"""The verbs of the command line, one file each beside this one: they read options, call the package and print."""

from __future__ import annotations

from typing import Annotated

import typer

from neuroanimator.cli import (
    animate,
    control,
    demo,
    doctor,
    evaluate,
    export,
    generate,
    improve,
    info,
    new,
    studio,
    train,
)
from neuroanimator.cli import list as list_
from neuroanimator.cli.usage import Verbs

app = typer.Typer(
    cls=Verbs,
    name="neuroanimator",
    help="Learn a physics model once, then animate and control it at a fraction of the cost.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
VERBS = {
    "demo": demo, "doctor": doctor, "list": list_, "new": new, "generate": generate, "train": train,
    "evaluate": evaluate, "improve": improve, "animate": animate, "control": control, "export": export, "studio": studio,
    "info": info,
}  # fmt: skip
"""Each verb is the `run` of its module; `--help` lists them in this order."""

for verb, module in VERBS.items():
    app.command(verb, epilog=f"Example: {module.EXAMPLE}")(module.run)


def print_version(is_wanted: bool) -> bool:
    """Print the installed version and end, if that is wanted; return False otherwise, the option's value."""
    if not is_wanted:
        return False
    from importlib.metadata import version

    print(f"neuroanimator {version('neuroanimator')}")
    raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=print_version, is_eager=True, help="Print the version and end."
        ),
    ] = False,
) -> None:
    """Learn a physics model once, then animate and control it at a fraction of the cost."""
    from neuroanimator.terminal import show_phases

    show_phases()
