"""The verb `studio`: see, steer and compare emulators in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EXAMPLE = "neuroanimator studio"


def run(
    emulators: Annotated[
        list[str] | None,
        typer.Argument(help="Emulator files, or names of shipped ones, to be shown too."),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 for any that is free.")] = 0,
    host: Annotated[
        str, typer.Option(help="Address to listen on; other machines reach any but this one's own.")
    ] = "127.0.0.1",
    no_open: Annotated[bool, typer.Option("--no-open", help="Do not open a browser.")] = False,
    export: Annotated[
        Path | None,
        typer.Option(help="Write the page as files for any web host into this folder instead."),
    ] = None,
) -> None:
    """Serve a page, for this machine alone, that shows every system and any emulator dropped on it; Ctrl-C ends it."""
    from neuroanimator.terminal import phase
    from neuroanimator.text import print_line

    with phase("loading"):
        from neuroanimator.studio.run import library_with, page_folder, serve_studio
        from neuroanimator.studio.static_site import export_site

    if export is None:
        serve_studio(emulators or [], host, port, opens_browser=not no_open, say=print_line)
        return
    page = page_folder()
    files = export_site(page, library_with(emulators or []).bundles(), export)
    size = sum(path.stat().st_size for path in files)
    print_line(
        f"{export}: {len(files)} files, {size / 1e6:.1f} MB. Put the folder on any web host."
    )
