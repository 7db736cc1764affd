"""The verbs of the command line, one file each beside this one: they read options, call the package and print.

A verb's file is imported when the verb is asked for.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import version as version_of
from types import ModuleType
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from neuroanimator.cli.usage import usage_in_one_line
from neuroanimator.terminal import phase, show_phases

VERBS = {
    "demo": "Learn a pendulum, measure it, swing it up, draw it.",
    "doctor": "Check this machine and say what is missing.",
    "list": "List the systems, emulators and policies.",
    "new": "Bring your own model, function or recordings.",
    "generate": "Simulate random motions and store transitions.",
    "train": "Train an emulator, or a fleet of them.",
    "evaluate": "Measure emulators against fine physics.",
    "improve": "Learn where an emulator is weak.",
    "animate": "Animate a motion without running the physics.",
    "control": "Find a controller, replay it on the physics.",
    "policy": "Learn a policy that walks, on the physics.",
    "identify": "Find a body's parameters from recordings.",
    "export": "Export emulators as programs, clips as films.",
    "studio": "Serve the page that shows every system.",
    "info": "Check a file or a dataset and show what it is.",
}
"""Line of each verb in `--help`, in this order; a verb is the `run` of the module of its name."""

SETTINGS: Any = {
    "add_completion": False,
    "pretty_exceptions_enable": False,
    "rich_markup_mode": None,
}
"""Settings of typer for the group and for every verb."""


class VerbCommands(Mapping[str, Any]):
    """The verbs' commands by name, each made from its module when it is first looked up."""

    def __getitem__(self, verb: str) -> Any:
        if verb not in VERBS:
            raise KeyError(verb)
        with phase("loading"):
            module = module_of(verb)
        single = typer.Typer(**SETTINGS)
        single.command(verb, epilog=f"Example: {module.EXAMPLE}")(module.run)
        return typer.main.get_command(single)

    def __iter__(self) -> Iterator[str]:
        return iter(VERBS)

    def __len__(self) -> int:
        return len(VERBS)


@cache
def module_of(verb: str) -> ModuleType:
    """Return the module of a verb.

    Modules stay imported, so the garbage collector need not scan them: that took a quarter of a command's start.
    """
    gc.disable()
    try:
        return import_module(f"neuroanimator.cli.{verb}")
    finally:
        gc.freeze()
        gc.enable()


class Verbs(TyperGroup):
    """The verbs; a wrong command line is reported in one line instead of four, like every other mistake."""

    def __init__(self, **options: Any):
        super().__init__(**options)
        self.commands = VerbCommands()

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the line of each verb, without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl(list(VERBS.items()))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Return the rest of `args` after our own options."""
        with usage_in_one_line():
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the verb."""
        show_phases()
        with usage_in_one_line():
            return super().invoke(ctx)


app = typer.Typer(
    cls=Verbs,
    name="neuroanimator",
    help="Learn a physics model once, then animate and control it at a fraction of the cost.",
    no_args_is_help=True,
    **SETTINGS,
)


def print_version(is_wanted: bool) -> bool:
    """Print the installed version and exit, if wanted; otherwise return False, the option's value."""
    if not is_wanted:
        return False
    print(f"neuroanimator {version_of('neuroanimator')}")
    raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Learn a physics model once, then animate and control it at a fraction of the cost."""
