"""Somebody's own MuJoCo model, dropped on the page: looked at, and written down as a system that can be trained."""

from __future__ import annotations

import re
import secrets
import signal
import subprocess
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neuroanimator import ArgumentError, BadFileError
from neuroanimator.authoring import folder_until_exit, python_command, read_toml

KEPT = 8
"""Models that are kept until the server ends."""

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
"""A name a system may be given after its file."""

MAX_NAME = 40
"""Letters of such a name."""

KINDS = {"mujoco": ".xml", "robot": ".urdf"}
"""How files are called, by the outermost element: MJCF and URDF."""

ROOT_ELEMENT = re.compile(rb"<\s*([A-Za-z]+)[\s>]")
"""The first element of an XML text; comments and declarations begin otherwise."""

MAX_LOOKING = 120
"""Processor time after which looking at a model is given up [s]; of a busy machine's clock no more is known than that it runs."""

LIMITED = "from neuroanimator.authoring import limit_processor_time as limit; limit({})\n"
"""Beginning of a program that may take so many seconds of processor time."""

COMMAND_LINE = LIMITED.format(MAX_LOOKING) + "from neuroanimator.cli.main import main; main()"
"""A program that is the command line, within that limit."""

WARNING = "warning: "
"""How a line of `neuroanimator new` begins that is worth telling."""

FAULT = "neuroanimator: "
"""How its last line begins where something is wrong."""

HEAD = 1 << 16
"""Number of bytes searched for it."""


@dataclass(frozen=True)
class Model:
    """A dropped model."""

    toml: Path
    """The file that defines the system, alone with the model in its folder."""
    facts: dict[str, Any]
    """What the page is told of it."""


class Models:
    """Dropped models by ids nobody can guess."""

    def __init__(self) -> None:
        self._folder = folder_until_exit()
        self._models: OrderedDict[str, Model] = OrderedDict()

    def add(self, content: bytes, name: str) -> dict[str, Any]:
        """Return what there is to know of a model, its id included; BadFileError for one that cannot be learnt."""
        suffix = _kind_of(content)
        name = _system_name(name)
        model_id = secrets.token_hex(8)
        folder = self._folder / model_id
        folder.mkdir(mode=0o700)
        file = folder / f"{name}{suffix}"
        file.write_bytes(content)
        facts = {"model": model_id, **_looked_at(file)}
        toml = file.with_suffix(".toml")
        self._models[model_id] = Model(toml, facts)
        while len(self._models) > KEPT:
            self._models.popitem(last=False)
        return facts

    def find(self, model_id: str) -> Model:
        """Return the model of that id; ArgumentError if there is none."""
        if model_id not in self._models:
            raise ArgumentError("model: none has this id. Drop its file again.")
        return self._models[model_id]


def _system_name(stem: str) -> str:
    """Return a name for the system after its file's, of which whatever a name may not have becomes a line."""
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", stem).strip("_-")[:MAX_NAME]
    return name if NAME.fullmatch(name) else "model"


def _looked_at(file: Path) -> dict[str, Any]:
    """Return what `neuroanimator new` finds in a model, in a process of its own: a stranger's may crash it."""
    command = python_command("-c", COMMAND_LINE, "new", str(file))
    looked = subprocess.run(
        command, cwd=file.parent, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    if looked.returncode == -signal.SIGXCPU:
        raise BadFileError("Checking the model took too long. Make it simpler.")
    lines = looked.stderr.splitlines()
    if looked.returncode != 0:
        faults = [line.removeprefix(FAULT) for line in lines if line.startswith(FAULT)]
        raise BadFileError(faults[-1] if faults else "The model made the simulator crash.")
    values = read_toml(file.with_suffix(".toml"))
    return {
        "system": values["name"],
        "substeps": values["substeps"],
        "dt": values["substeps"] * values["physics"]["step"],
        "warnings": [line.removeprefix(WARNING) for line in lines if line.startswith(WARNING)],
    }


def _kind_of(content: bytes) -> str:
    """Return how a file with this content should be called; BadFileError for what is no model."""
    found = ROOT_ELEMENT.search(content[:HEAD])
    if found is not None:
        suffix = KINDS.get(found[1].decode().lower())
        if suffix is not None:
            return suffix
    raise BadFileError(
        "The file is neither an MJCF model nor a URDF one. Other kinds are for the command line: neuroanimator new."
    )
