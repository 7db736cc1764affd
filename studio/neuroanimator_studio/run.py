"""Run the studio: find the page, make what is missing, serve until somebody stops it."""

from __future__ import annotations

import asyncio
import os
import sys
import threading
import webbrowser
from collections.abc import Callable
from pathlib import Path

from neuroanimator import ResourceError
from neuroanimator.authoring import (
    find_emulator,
    folder_until_exit,
    hide_progress,
    phase,
    print_line,
)
from neuroanimator_studio.guard import Gate
from neuroanimator_studio.library import Library
from neuroanimator_studio.limits import USUAL, Limits
from neuroanimator_studio.server import INDEX, listen, make_server
from neuroanimator_studio.static_site import export_site
from neuroanimator_studio.studio import Studio

ENTRY_FILE = """<!doctype html>
<meta charset="utf-8">
<meta http-equiv="refresh" content="0; url={url}">
<title>NeuroAnimator Studio</title>
<a href="{url}">To the studio</a>
"""
"""The file that leads a browser to the page."""

Say = Callable[[str], None]


def page_folder() -> Path:
    """Return where the built page lies; ResourceError where it was never built."""
    folder = Path(__file__).parent / "page"
    if not (folder / INDEX.removeprefix("/")).is_file():
        raise ResourceError(
            "The studio's page is not built here. In a checkout run 'make page', which needs Node or the network; "
            "a wheel has it."
        )
    return folder


def library_with(emulators: list[str]) -> Library:
    """Return the library with the bundles of these emulator files, or names, made."""
    library = Library()
    for reference in emulators:
        with phase(f"preparing {Path(reference).name}"):
            library.add(find_emulator(reference))
    return library


def run_studio(
    emulators: list[str], *, host: str, port: int, opens_browser: bool, export: Path | None
) -> None:
    """Serve the page with these emulator files, or names, besides those that ship; or write it to the folder `export`."""
    if export is None:
        serve_studio(emulators, host, port, opens_browser=opens_browser, say=print_line)
        return
    page = page_folder()
    files = export_site(page, library_with(emulators).bundles(), export)
    size = sum(path.stat().st_size for path in files)
    print_line(
        f"{export}: {len(files)} files, {size / 1e6:.1f} MB. Put the folder on any web host."
    )


def serve_studio(
    emulators: list[str],
    host: str,
    port: int,
    *,
    opens_browser: bool,
    say: Say,
    page: Path | None = None,
    limits: Limits = USUAL,
) -> None:
    """Serve the page until the process is stopped; `say` is told the address, and whatever is to be known."""
    page = page or page_folder()
    listener = listen(host, port)
    gate = Gate(host, listener.getsockname()[1])
    studio = Studio(gate, page, library_with(emulators), limits)
    if not gate.is_loopback:
        say(
            f"Anyone on the network of {host} who knows the token below can use this machine's studio."
        )
    say(gate.url)
    sys.stdout.flush()
    hide_progress()
    if opens_browser and has_display():
        entry = write_entry(gate)
        # A browser may take its time, and some never come back.
        threading.Thread(target=webbrowser.open, args=(entry.as_uri(),), daemon=True).start()
    try:
        asyncio.run(make_server(studio).serve(sockets=[listener]))
    finally:
        studio.close()


def write_entry(gate: Gate) -> Path:
    """Return a file that leads a browser to the page, until this process ends.

    Only this user can read it; the command line of a browser, where the address would be, can be read by all users.
    """
    entry = folder_until_exit() / "studio.html"
    entry.touch(mode=0o600)
    entry.write_text(ENTRY_FILE.format(url=gate.url))
    return entry


def has_display() -> bool:
    """Return whether a browser can be seen here; one for terminals would take this terminal over."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
