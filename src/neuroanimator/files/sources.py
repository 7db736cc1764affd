"""Files that are only made into what a command wants: models, step functions, recordings, meshes and definitions."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

from neuroanimator.errors import BadFileError

SOURCES = (".xml", ".urdf", ".py", ".csv", ".npz", ".obj", ".msh")
"""Suffixes of the files that `neuroanimator new` reads."""


def refuse_source(name: str, wanted: str) -> None:
    """Raise BadFileError if `name` is a file from which what is `wanted` is still to be made, with the next command."""
    path = Path(name)
    toml = path.with_suffix(".toml")
    if not path.is_file() or path.suffix.lower() not in (".toml", *SOURCES):
        return
    command = f"neuroanimator new {quote(name)}"
    if toml.is_file():
        made = quote(f"{path.stem}.emulator.safetensors")
        command = f"neuroanimator train {quote(str(toml))} --out {made}"
    raise BadFileError(f"{name} is no {wanted}; first: {command}")
