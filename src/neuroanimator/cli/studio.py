"""The verb `studio`: see, steer and compare emulators in the browser; the package neuroanimator-studio does it."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated

import typer

from neuroanimator.errors import ResourceError
from neuroanimator.terminal import phase

EXAMPLE = "neuroanimator studio"

GROUP = "neuroanimator"
"""Group of entry points by which other packages extend this one."""

HOW_TO_GET_STUDIO = "In NeuroAnimator's repository: make wheels, then: pip install dist/*.whl"
"""How to install the studio, which no package index has."""

ENTRY_POINT = "studio"
"""Name of the entry point that serves the page."""


def run(
    emulators: Annotated[
        list[str] | None,
        typer.Argument(help="Emulator files, or names of shipped ones, to show as well."),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 for any that is free.")] = 0,
    host: Annotated[
        str,
        typer.Option(
            help="Address to listen on; with the default, only this machine can reach it."
        ),
    ] = "127.0.0.1",
    no_open: Annotated[bool, typer.Option("--no-open", help="Do not open a browser.")] = False,
    export: Annotated[
        Path | None,
        typer.Option(help="Write the page as files for any web host into this folder instead."),
    ] = None,
) -> None:
    """Serve a page, for this machine alone, that shows every system and any emulator dropped on it; Ctrl-C ends it."""
    with phase("loading"):
        run_studio = installed_studio()
    run_studio(emulators or [], host=host, port=port, opens_browser=not no_open, export=export)


def installed_studio() -> Callable[..., None]:
    """Return the function that runs the studio; ResourceError if its package is not installed."""
    found = list(entry_points(group=GROUP, name=ENTRY_POINT))
    if not found:
        raise ResourceError(
            f"The studio is a package of its own, which is not installed. {HOW_TO_GET_STUDIO}."
        )
    return found[0].load()
