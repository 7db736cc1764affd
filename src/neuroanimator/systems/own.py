"""Systems from definitions: the packaged ones, and anybody's own by their TOML file.

What makes up a user's system travels as one JSON text with its datasets and emulators, so that
they can be measured, refined and replayed without the files they came from.
"""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files import canonical_json
from neuroanimator.systems.definition import Definition, check_definition, read_toml
from neuroanimator.systems.model_file import ModelFiles, compile_model, read_model_files
from neuroanimator.systems.model_system import ModelSystem
from neuroanimator.systems.mujoco import load_model
from neuroanimator.systems.system import System

LARGEST_TEXT = 512 * 1024
"""Largest JSON text of a system [bytes]: an emulator file carries it in its header."""


def packaged(name: str) -> System:
    """Return the system whose TOML and MJCF ship in the package under `name`."""
    with resources.as_file(resources.files("neuroanimator.systems") / "assets") as folder:
        definition = check_definition(read_toml(folder / f"{name}.toml"), f"{name}.toml")
    return ModelSystem(definition, load_model(definition.model))


USUAL_SUBSTEPS = 50


def resolve(reference: str) -> tuple[str, str, int]:
    """Return (name, definition text, usual substeps) of what a user calls a system: its name, or its TOML file."""
    if not reference.endswith(".toml"):
        return reference, "", USUAL_SUBSTEPS
    path = Path(reference)
    definition = check_definition(read_toml(path), path.name)
    if Path(definition.model).name != definition.model:
        raise ArgumentError(f"{path.name}: model: wanted a file beside it, came '{definition.model}'.")
    files = read_model_files(path.parent / definition.model)
    text = canonical_json({"definition": definition.model_dump(mode="json"), "files": files.to_json()})
    if len(text) > LARGEST_TEXT:
        raise BadFileError(
            f"{path.name}: the model with its meshes takes {len(text):,} bytes; wanted at most {LARGEST_TEXT:,}. "
            "Use simpler meshes, or primitive shapes."
        )
    from_text(text)
    return definition.name, text, definition.substeps


def from_text(text: str) -> System:
    """Return the system `resolve` wrote down. It is checked like any stranger's."""
    try:
        values = json.loads(text)
        definition, files = values["definition"], values["files"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise BadFileError("The system's definition is damaged. Make the dataset or emulator again.") from error
    checked: Definition = check_definition(definition, "definition")
    return ModelSystem(checked, compile_model(ModelFiles.from_json(files)), text)
