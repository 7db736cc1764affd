"""One HTML file that shows one motion: the page, the emulator and the motion in it, to be opened anywhere without a server."""

from __future__ import annotations

import base64
import json
import re
from importlib import resources
from pathlib import Path
from typing import Any

from neuroanimator import ResourceError
from neuroanimator_studio.catalogue import BUNDLE, PROGRAMS, catalogue

INDEX = "/index.html"

LICENCES = "/licences.txt"
"""The licences of what is built into the page."""

SCRIPT = re.compile(r'<script type="module"[^>]* src="\.(?P<name>/[^"]+)"></script>')
"""Where the built page names its program."""

STYLE = re.compile(r'<link rel="stylesheet"[^>]* href="\.(?P<name>/[^"]+)">')
"""Where it names its style."""

ICON = re.compile(r'<link rel="icon"[^>]*>')

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:; "
    "connect-src data: blob:; base-uri 'none'; form-action 'none'"
)
"""The file asks nobody for anything."""


def single_page(page_files: dict[str, Path], bundle: Path, drive: dict[str, Any]) -> bytes:
    """Return the page as one file that shows the emulator of `bundle` with the motion `drive`: its start and controls.

    Descents are left out: they would double its size.
    """
    facts = json.loads((bundle / BUNDLE).read_text(encoding="ascii"))
    facts |= {"default_motion": drive, "descents": []}
    listed = catalogue([bundle], has_server=False)
    folder = f"bundles/{bundle.name}"
    files = {
        "catalogue.json": json.dumps(listed).encode(),
        f"{folder}/{BUNDLE}": json.dumps(facts, allow_nan=False).encode(),
    }
    for name in PROGRAMS:
        if (bundle / name).is_file():
            files[f"{folder}/{name}"] = (bundle / name).read_bytes()
    return _filled(page_files, files).encode()


def _filled(page_files: dict[str, Path], files: dict[str, bytes]) -> str:
    """Return the page's HTML with its program, its style and `files` in it."""
    text = page_files[INDEX].read_text(encoding="utf-8")
    script = SCRIPT.search(text)
    style = STYLE.search(text)
    if script is None or style is None:
        raise ResourceError("The studio's page was built for another version. Run: make page")
    program = page_files[script["name"]].read_text(encoding="utf-8")
    rules = page_files[style["name"]].read_text(encoding="utf-8")
    prelude = (resources.files("neuroanimator_studio") / "prelude.js").read_text(encoding="utf-8")
    encoded = {name: base64.b64encode(content).decode("ascii") for name, content in files.items()}
    head = "\n".join(
        (
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}" />',
            f"<style>{rules}</style>",
            f'<script type="application/json" id="files">{json.dumps(encoded)}</script>',
            f"<script>{prelude}</script>",
            f'<script type="module">{_within_script(program)}</script>',
        )
    )
    licences = page_files.get(LICENCES)
    if licences is not None:
        head = f"<!--\n{licences.read_text(encoding='utf-8').replace('--', '- -')}-->\n{head}"
    text = ICON.sub("", text).replace(style[0], "")
    return text.replace(script[0], head)


def _within_script(program: str) -> str:
    """Return JavaScript that may stand in HTML: nothing in its texts ends the script."""
    return program.replace("</script", "<\\/script").replace("<!--", "<\\!--")
