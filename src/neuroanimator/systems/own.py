"""Systems from definitions: the packaged ones, and anybody's own by their TOML file.

What makes up a user's system travels as one JSON text with its datasets and emulators, so that
they can be measured, refined and replayed. A model travels whole. A step function and recordings
travel by name and sha256 only: they are used where their TOML file is given, see `given.py`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files import canonical_json
from neuroanimator.systems.body_definition import BodyDefinition
from neuroanimator.systems.definition import (
    Definition,
    PythonDefinition,
    RecordedDefinition,
    check_definition,
    read_toml,
)
from neuroanimator.systems.deformable import DeformableSystem
from neuroanimator.systems.given import give_file
from neuroanimator.systems.model_file import ModelFiles, compile_model, read_model_files
from neuroanimator.systems.model_system import ModelSystem
from neuroanimator.systems.mujoco import load_model
from neuroanimator.systems.python_system import PythonSystem
from neuroanimator.systems.recorded_system import RecordedSystem
from neuroanimator.systems.recording import read_recording
from neuroanimator.systems.system import System

LARGEST_TEXT = 512 * 1024
"""Largest JSON text of a system [bytes]: an emulator file carries it in its header."""


def packaged(name: str) -> System:
    """Return the system whose TOML, and MJCF if it has one, ship in the package under `name`."""
    with resources.as_file(resources.files("neuroanimator.systems") / "assets") as folder:
        values = read_toml(folder / f"{name}.toml")
    definition = check_definition(values, f"{name}.toml", _kind_of(values).table)
    if isinstance(definition, BodyDefinition):
        return DeformableSystem(definition)
    return ModelSystem(definition, load_model(definition.model))


class Kind(NamedTuple):
    """One way to bring a system."""

    table: type[Any]
    """What its TOML file may hold."""
    source: str
    """Key that names the file beside the TOML; empty if there is none."""
    pack: Callable[[Path], Any]
    """What of that file travels along, as JSON."""
    make: Callable[[Any, Any, str], System]
    """From (definition, what travelled along, text) to the system."""


def _pack_model(path: Path) -> Any:
    return read_model_files(path).to_json()


def _make_model(definition: Definition, files: Any, text: str) -> System:
    return ModelSystem(definition, compile_model(ModelFiles.from_json(files)), text)


def _pack_function(path: Path) -> dict[str, Any]:
    return {"name": path.name, "sha256": give_file(path)}


def _pack_recording(path: Path) -> dict[str, Any]:
    digest = give_file(path)
    runs = read_recording(digest, path.name)
    rows = [len(states) for states in runs.states]
    return {"name": path.name, "sha256": digest, "rows": rows, "origins": list(runs.origins)}


def _pack_nothing(path: Path) -> None:
    """A body is all in its definition."""


def _make_body(definition: BodyDefinition, files: None, text: str) -> System:
    return DeformableSystem(definition, text)


KINDS = {
    "mujoco": Kind(Definition, "model", _pack_model, _make_model),
    "mass-spring": Kind(BodyDefinition, "", _pack_nothing, _make_body),
    "python": Kind(PythonDefinition, "file", _pack_function, PythonSystem),
    "recorded": Kind(RecordedDefinition, "file", _pack_recording, RecordedSystem),
}


def _kind_of(values: Any) -> Kind:
    name = values.get("kind", "mujoco") if isinstance(values, dict) else values
    if not isinstance(name, str) or name not in KINDS:
        raise ArgumentError(f"kind: no kind of system called {str(name)[:40]!r}. Kinds: {', '.join(KINDS)}.")
    return KINDS[name]


USUAL_SUBSTEPS = 50


def resolve(reference: str) -> tuple[str, str, int]:
    """Return (name, definition text, usual substeps) of what a user calls a system: its name, or its TOML file.

    A TOML file's step function or recordings may be used by this process from then on.
    """
    if not reference.endswith(".toml"):
        return reference, "", USUAL_SUBSTEPS
    path = Path(reference)
    values = read_toml(path)
    kind = _kind_of(values)
    definition = check_definition(values, path.name, kind.table)
    source = getattr(definition, kind.source) if kind.source else ""
    if source and Path(source).name != source:
        raise ArgumentError(f"{path.name}: {kind.source}: wanted a file beside it, came '{source}'.")
    files = kind.pack(path.parent / source)
    text = canonical_json({"definition": definition.model_dump(mode="json"), "files": files})
    if len(text) > LARGEST_TEXT:
        raise BadFileError(
            f"{path.name}: the model with its meshes takes {len(text):,} bytes; wanted at most {LARGEST_TEXT:,}. "
            "Use simpler meshes, or primitive shapes."
        )
    from_text(text)
    return definition.name, text, definition.substeps


def from_text(text: str) -> System:
    """Return the system `resolve` wrote down. It is checked like any stranger's, and no code of its runs."""
    try:
        values = json.loads(text)
        definition, files = values["definition"], values["files"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise BadFileError("The system's definition is damaged. Make the dataset or emulator again.") from error
    kind = _kind_of(definition)
    return kind.make(check_definition(definition, "definition", kind.table), files, text)
