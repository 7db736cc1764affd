"""Make systems from definitions: the packaged ones, and a user's own by their TOML file.

What makes up a user's system travels as one JSON text with its datasets and emulators, so that
they can be measured, refined and replayed. A model travels whole. A step function and recordings
travel by name and sha256 only: they are used where the user allows it with `trust_files`.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from neuroanimator.definitions.body import BodyDefinition
from neuroanimator.definitions.carried import TABLES, kind_of, read_definition_text
from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.definitions.model import Definition
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.errors import BadFileError
from neuroanimator.parsing.json_text import MAX_DEFINITION
from neuroanimator.storage.files import canonical_json
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.systems.functions.function_system import PythonSystem
from neuroanimator.systems.recorded.recorded_system import RecordedSystem
from neuroanimator.systems.recorded.recording import read_recording
from neuroanimator.systems.rigid.model_files import ModelFiles, compile_model, read_model_files
from neuroanimator.systems.rigid.model_system import ModelSystem
from neuroanimator.systems.rigid.mujoco_system import load_model
from neuroanimator.systems.system import System
from neuroanimator.systems.trusted_files import digest_of, trust_file
from neuroanimator.tables import check_table, read_toml


def packaged(name: str) -> System:
    """Return the system whose TOML, and MJCF if it has one, ship in the package under `name`."""
    with resources.as_file(resources.files("neuroanimator.systems") / "assets") as folder:
        values = read_toml(folder / f"{name}.toml")
    definition = check_table(values, f"{name}.toml", TABLES[kind_of(values)])
    if isinstance(definition, BodyDefinition):
        return DeformableSystem(definition)
    return ModelSystem(definition, load_model(definition.model))


class Loader(NamedTuple):
    """The functions that write down systems of one kind and make them again."""

    file_key: str
    """Key of the TOML that names the file beside it; empty if there is none."""
    needs_trust: bool
    """Whether that file is run or opened again later, where the user must have allowed it."""
    pack: Callable[[Path, Any], Any]
    """Returns what of that file travels along, as JSON values, given the TOML file's folder and the definition."""
    make: Callable[[Any, Any, str], System]
    """Returns the system made of (definition, what travelled along, definition text)."""


def _pack_model(folder: Path, definition: Definition) -> Any:
    tree = folder / definition.tree if definition.tree else None
    return read_model_files(folder / definition.model, tree).to_json()


def _make_model(definition: Definition, files: Any, text: str) -> System:
    model = compile_model(ModelFiles.from_json(files), definition.base, definition.passive)
    return ModelSystem(definition, model, text)


def _pack_function(folder: Path, definition: PythonDefinition) -> dict[str, Any]:
    path = folder / definition.file
    return {"name": path.name, "sha256": digest_of(path)}


def _pack_recording(folder: Path, definition: RecordedDefinition) -> dict[str, Any]:
    path = folder / definition.file
    digest = digest_of(path)
    runs = read_recording(digest, path.name)
    rows = [len(states) for states in runs.states]
    return {"name": path.name, "sha256": digest, "rows": rows, "origins": list(runs.origins)}


def _pack_nothing(folder: Path, definition: BodyDefinition) -> None:
    """A body is all in its definition."""


def _make_body(definition: BodyDefinition, files: Any, text: str) -> System:
    return DeformableSystem(definition, text)


LOADERS = {
    "mujoco": Loader("model", False, _pack_model, _make_model),
    "mass-spring": Loader("", False, _pack_nothing, _make_body),
    "python": Loader("file", True, _pack_function, PythonSystem),
    "recorded": Loader("file", True, _pack_recording, RecordedSystem),
}
"""Each kind of system has its loader; the kinds are those of `definitions.carried.TABLES`."""

USUAL_SUBSTEPS = 50
"""A super step of a system of the package has this many physics steps, if nothing else is said."""


def trust_files(toml: str | Path) -> None:
    """Allow this process to run the step function, or to open the recordings, that a TOML file names beside it.

    This is the one act by which Python code of a user's is run: call it only for a file whose code you would run.
    The command line calls it for the TOML files named there, `load_system` for the one it is given; no dataset,
    emulator or policy can. A TOML file of another kind allows nothing.
    """
    path = Path(toml)
    loader, definition = _read_definition(path)
    if loader.needs_trust:
        trust_file(_source(path, loader, definition))


def resolve(reference: str) -> tuple[str, str, int]:
    """Return (name, definition text, usual substeps) of what a user calls a system: its name, or its TOML file.

    Runs nothing and allows nothing: see `trust_files`, which recordings need before. The text is empty for a system
    of the package. Raises ArgumentError or BadFileError for a wrong definition or one that is too long.
    """
    if not reference.endswith(".toml"):
        return reference, "", USUAL_SUBSTEPS
    path = Path(reference)
    loader, definition = _read_definition(path)
    files = loader.pack(path.parent, definition)
    text = canonical_json({"definition": _travelling(definition), "files": files})
    if len(text) > MAX_DEFINITION:
        raise BadFileError(
            f"{path.name}: the model with its meshes takes {len(text):,} bytes; wanted at most {MAX_DEFINITION:,}. "
            "Use simpler meshes, or primitive shapes."
        )
    from_text(text)
    return definition.name, text, definition.substeps


def _travelling(definition: Any) -> dict[str, Any]:
    """Return the definition as JSON values, without the folders it was read from: nobody else has these."""
    values = definition.model_dump(mode="json")
    if isinstance(definition, Definition):
        values["model"] = Path(definition.model).name
        del values["tree"]
        for key in ("holding", "passive"):
            if not values[key]:  # as before there was such a key
                del values[key]
        if not definition.sampling.reset_share:
            del values["sampling"]["reset_share"], values["sampling"]["reset_noise"]
    return values


def _read_definition(path: Path) -> tuple[Loader, Any]:
    """Return the loader for the kind of system a TOML file defines, and the checked definition."""
    values = read_toml(path)
    kind = kind_of(values)
    return LOADERS[kind], check_table(values, path.name, TABLES[kind])


def _source(path: Path, loader: Loader, definition: Any) -> Path:
    """Return the file that a TOML file names, or its folder if it names none."""
    if not loader.file_key:
        return path.parent
    return path.parent / getattr(definition, loader.file_key)


def from_text(text: str) -> System:
    """Return the system `resolve` wrote down. It is checked like any stranger's, and no code of its runs."""
    written = read_definition_text(text)
    loader = LOADERS[written.kind]
    return loader.make(written.definition, written.files, text)
