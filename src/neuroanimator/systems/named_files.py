"""The files that definitions name: their own TOML, and the models and shapes that this process knows or finds beside a file."""

from __future__ import annotations

from contextlib import AbstractContextManager
from importlib import resources
from itertools import chain
from pathlib import Path
from typing import Any

from neuroanimator.definitions.carried import (
    TABLES,
    is_whole_model,
    kind_of,
    read_definition_text,
    remembered_folders,
)
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.definitions.model import Definition
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.tables import check_table, read_toml
from neuroanimator.systems.model_files import ModelFiles, read_model_files
from neuroanimator.systems.trusted_files import digest_of, know_model, known_models, trusted_path
from neuroanimator.text import quoted


def shipped_folder() -> AbstractContextManager[Path]:
    """Return the folder of the shipped systems."""
    return resources.as_file(resources.files("neuroanimator.systems") / "assets")


class MissingPhysicsError(BadFileError):
    """The model of a system is missing, or is another than named."""


def read_definition(path: Path) -> tuple[str, Any]:
    """Return the kind of system that a TOML file defines, and the checked definition."""
    values = _whole_table(read_toml(path))
    kind = kind_of(values)
    return kind, check_table(values, path.name, TABLES[kind])


def _whole_table(values: dict[str, Any]) -> dict[str, Any]:
    """Return the table of a file: the `family_of` a shipped system inherits the tables it does not give."""
    values = dict(values)
    base = values.pop("family_of", None)
    if base is None:
        return values
    with shipped_folder() as folder:
        tables = {path.stem: read_toml(path) for path in sorted(folder.glob("*.toml"))}
        for table in tables.values():
            if "model" in table:
                table["model"] = str(folder / table["model"])
    bases = [
        name
        for name, table in tables.items()
        if kind_of(table) in ("mujoco", "mass-spring") and "family_of" not in table
    ]
    if base not in bases:
        raise ArgumentError(
            f"family_of: no system with families is called {quoted(base)}. Systems: {', '.join(bases)}."
        )
    return tables[base] | values


def read_named_model(toml: Path, definition: Definition | FlexDefinition) -> ModelFiles:
    """Return the files of the model that a TOML file names, and remember them."""
    tree = toml.parent / definition.tree if definition.tree else None
    files = read_model_files(toml.parent / definition.model, tree)
    know_model(definition.name, files)
    return files


def names_model(text: str) -> bool:
    """Return whether the definition in `text` names a model's files, which it does not contain."""
    return _model_part(text) is not None


def named_model(text: str) -> ModelFiles | None:
    """Return the files of the model that `text` names; None if it names none, or if they are missing."""
    named = _model_part(text)
    if named is None:
        return None
    try:
        return find_model(read_definition_text(text).definition.name, named, text)
    except MissingPhysicsError:
        return None


def _model_part(text: str) -> Any:
    """Return the names of a model's files in the definition in `text`; None if there are none."""
    if not text:
        return None
    written = read_definition_text(text)
    if written.kind == "flex":
        return written.files["model"]
    if written.kind == "mujoco" and not is_whole_model(written.files):
        return written.files
    return None


def find_model(name: str, named: Any, text: str) -> ModelFiles:
    """Return the files a definition text names: known here, or beside a file that has this text.

    Raises MissingPhysicsError if they are missing, or one differs.
    """
    if is_whole_model(named):
        return ModelFiles.from_json(named)
    toml = named["toml"]
    beside = (_model_beside(folder / toml) for folder in remembered_folders(text))
    changed: list[str] = []
    for files in chain(known_models(name), beside):
        if files is None:
            continue
        changed = files.differences(named["sha256"])
        if files.main == named["main"] and not changed:
            return files
    if changed:
        raise MissingPhysicsError(
            f"{name}: {quoted(changed[0])} is not what it was trained on, so the physics would differ. Put the old file "
            "back, or train again."
        )
    raise MissingPhysicsError(
        f"{name}: its physics was not found: wanted {toml} and its model beside it, or --system {toml} (in Python "
        f"trust_files({toml!r})). Without it an emulator animates, can be exported, and finds controls, but cannot verify them."
    )


def _model_beside(toml: Path) -> ModelFiles | None:
    """Return the files of the model that a TOML file beside an emulator names; None if there are none in its folder.

    The user has not named that file: it may be a stranger's, and can only reach its own folder and the shipped models.
    """
    if not toml.is_file():
        return None
    _, definition = read_definition(toml)
    if not isinstance(definition, Definition | FlexDefinition):
        return None
    folder = toml.parent.resolve()
    with shipped_folder() as assets:
        allowed = (folder, assets.resolve())
    for path in (definition.model, definition.tree or ""):
        whole = (folder / path).resolve()
        if not any(whole.is_relative_to(place) for place in allowed):
            return None
    return read_named_model(toml, definition)


def named_shapes(text: str) -> Path | None:
    """Return the path of the shapes that the definition in `text` names; None if it names none, or if they are missing."""
    if not text:
        return None
    written = read_definition_text(text)
    if written.kind not in ("soft", "flex"):
        return None
    files = written.files
    if written.kind == "flex":
        files = files["shapes"]
    try:
        return find_shapes(written.definition.name, files, text)
    except MissingPhysicsError:
        return None


def find_shapes(name: str, files: dict[str, Any], text: str) -> Path:
    """Return the path of the shapes with this sha256: those of a TOML file named here, or beside a file that has this text."""
    wanted = files["sha256"]
    known = trusted_path(wanted)
    beside = [folder / files["name"] for folder in remembered_folders(text)]
    for path in [known, *beside]:
        if path is not None and path.is_file() and digest_of(path) == wanted:
            return path
    raise MissingPhysicsError(
        f"{name}: its shapes were not found: wanted {files['name']}, which --system with its TOML file makes again. Without "
        "them an emulator animates, can be exported, and finds controls, but cannot verify them."
    )
