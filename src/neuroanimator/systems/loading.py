"""Make systems from definitions: the shipped ones, and users' own from their TOML files.

A user's system travels with its datasets and emulators as one JSON text: its checked definition, and the sha256 of the
files of its physics. These files stay with the user, and are looked for when needed: see `trusted_files`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from importlib import resources
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.body import BodyDefinition
from neuroanimator.definitions.carried import (
    TABLES,
    is_whole_model,
    kind_of,
    read_definition_text,
    remembered_folders,
)
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.definitions.model import Definition
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.atomic import canonical_json
from neuroanimator.files.sources import refuse_source
from neuroanimator.files.tables import check_table, read_toml
from neuroanimator.files.zoo import SOFT, shipped_path
from neuroanimator.state.shape_contacts import place_movers
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.systems.functions.function_system import PythonSystem
from neuroanimator.systems.recorded.recorded_system import RecordedSystem
from neuroanimator.systems.recorded.recording import read_recording
from neuroanimator.systems.rigid.compiled_model import compile_model
from neuroanimator.systems.rigid.model_files import ModelFiles, read_model_files
from neuroanimator.systems.rigid.model_system import ModelSystem
from neuroanimator.systems.rigid.mujoco_system import load_model
from neuroanimator.systems.soft.mesh_file import read_mesh
from neuroanimator.systems.soft.movers import Movers, mocap_movers
from neuroanimator.systems.soft.scene import Scene
from neuroanimator.systems.soft.shape_file import (
    ShapeFile,
    flex_scene,
    made_for,
    made_for_model,
    read_flex_shapes,
    read_shapes,
)
from neuroanimator.systems.soft.soft_system import SoftSystem
from neuroanimator.systems.system import System
from neuroanimator.systems.trusted_files import (
    digest_of,
    know_model,
    known_models,
    trust_file,
    trusted_path,
)
from neuroanimator.text import quoted


def packaged(name: str) -> System:
    """Return the system whose TOML, and MJCF if any, ship under `name`."""
    with _assets() as folder:
        _, definition = _read_definition(folder / f"{name}.toml")
        if isinstance(definition, SoftDefinition):
            return _packaged_soft(definition, folder)
    if isinstance(definition, BodyDefinition):
        return DeformableSystem(definition)
    return ModelSystem(definition, load_model(definition.model))


def _assets() -> AbstractContextManager[Path]:
    """Return the folder of the shipped systems."""
    return resources.as_file(resources.files("neuroanimator.systems") / "assets")


def movers_of(name: str, text: str, rest: Float[np.ndarray, " S"]) -> Movers | None:
    """Return the movers of the soft body `name` that rests at `rest`, with the definition `text`, empty if it ships.

    None for any other system. Only the definition is read.
    """
    if text:
        definition = read_definition_text(text).definition
    else:
        with _assets() as folder:
            _, definition = _read_definition(folder / f"{name}.toml")
    if isinstance(definition, SoftDefinition):
        return Movers(definition.movers)
    if isinstance(definition, FlexDefinition):
        turning = tuple(table.turns for table in definition.movers.values())
        entries = [place.entry for place in place_movers(turning)]
        return mocap_movers(definition.movers, np.stack([rest[i : i + 3] for i in entries]))
    return None


def _packaged_soft(definition: SoftDefinition, folder: Path) -> SoftSystem:
    """Return the soft body whose mesh lies in `folder`; its shapes and its state of rest are those of its emulator."""
    from neuroanimator.emulator.emulator import load_emulator

    mesh = read_mesh(definition.mesh, (folder / definition.mesh).read_bytes(), definition)
    emulator = load_emulator(shipped_path(definition.name, definition.substeps))
    shapes = emulator.skeleton.shapes
    assert shapes is not None
    return SoftSystem(definition, Scene(definition, mesh), ShapeFile(shapes, emulator.rest))


class Loader(NamedTuple):
    """The functions that describe systems of one kind as text and make them again."""

    trust: Callable[[Path, Any], object]
    """Allows this process to use that file, given the TOML file and the definition."""
    pack: Callable[[Path, Any], Any]
    """Returns the description of that file that travels along, as JSON values, given the TOML file and the definition."""
    make: Callable[[Any, Any, str], System]
    """Returns the system made from (definition, that description, definition text)."""


class MissingPhysicsError(BadFileError):
    """The model of a system is missing, or is another than named."""


def _read_model(toml: Path, definition: Definition | FlexDefinition) -> ModelFiles:
    """Return the files of the model that a TOML file names, and remember them."""
    tree = toml.parent / definition.tree if definition.tree else None
    files = read_model_files(toml.parent / definition.model, tree)
    know_model(definition.name, files)
    return files


def _pack_model(toml: Path, definition: Definition) -> Any:
    files = _read_model(toml, definition)
    return _model_named(toml, files)


def _model_named(toml: Path, files: ModelFiles) -> dict[str, Any]:
    """Return the names of a model's files for a definition text."""
    return {"toml": toml.name, "main": files.main, "sha256": files.digests}


def _make_model(definition: Definition, files: Any, text: str) -> System:
    found = _find_model(definition.name, files, text)
    model = compile_model(found, definition.base, definition.passive)
    if model.nflex:
        raise BadFileError(
            f"{found.main}: it has a soft body, which 'kind = \"mujoco\"' does not support. Write the TOML file again: "
            f"neuroanimator new {found.main} --force"
        )
    return ModelSystem(definition, model, text)


def names_model(text: str) -> bool:
    """Return whether the definition in `text` names a model's files, which it does not contain."""
    return _model_part(text) is not None


def named_model(text: str) -> ModelFiles | None:
    """Return the files of the model that `text` names; None if it names none, or if they are missing."""
    named = _model_part(text)
    if named is None:
        return None
    try:
        return _find_model(read_definition_text(text).definition.name, named, text)
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


def _find_model(name: str, named: Any, text: str) -> ModelFiles:
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
    _, definition = _read_definition(toml)
    if not isinstance(definition, Definition | FlexDefinition):
        return None
    folder = toml.parent.resolve()
    with _assets() as assets:
        allowed = (folder, assets.resolve())
    for path in (definition.model, definition.tree or ""):
        whole = (folder / path).resolve()
        if not any(whole.is_relative_to(place) for place in allowed):
            return None
    return _read_model(toml, definition)


def _trust_source(toml: Path, definition: PythonDefinition | RecordedDefinition) -> None:
    trust_file(toml.parent / definition.file)


def _pack_function(toml: Path, definition: PythonDefinition) -> dict[str, Any]:
    path = toml.parent / definition.file
    return {"name": path.name, "sha256": digest_of(path)}


def _pack_recording(toml: Path, definition: RecordedDefinition) -> dict[str, Any]:
    path = toml.parent / definition.file
    digest = digest_of(path)
    runs = read_recording(digest, path.name, definition.resample)
    rows = [len(states) for states in runs.states]
    return {"name": path.name, "sha256": digest, "rows": rows, "origins": list(runs.origins)}


def _pack_nothing(toml: Path, definition: BodyDefinition) -> None:
    """Return nothing: a body is complete in its definition."""


def _make_body(definition: BodyDefinition, files: Any, text: str) -> System:
    return DeformableSystem(definition, text)


def _pack_shapes(toml: Path, definition: SoftDefinition) -> dict[str, Any]:
    path = made_for(toml, definition)
    return {"name": path.name, "sha256": trust_file(path)}


def _make_soft(definition: SoftDefinition, files: dict[str, Any], text: str) -> System:
    path = _find_shapes(definition.name, files, text)
    file, mesh = read_shapes(path, definition)
    return SoftSystem(definition, Scene(definition, mesh), file, text)


def _pack_flex(toml: Path, definition: FlexDefinition) -> dict[str, Any]:
    files = _read_model(toml, definition)
    shapes = made_for_model(toml, definition, files)
    return {
        "model": _model_named(toml, files),
        "shapes": {"name": shapes.name, "sha256": trust_file(shapes)},
    }


def _make_flex(definition: FlexDefinition, files: dict[str, Any], text: str) -> System:
    scene = flex_scene(definition, _find_model(definition.name, files["model"], text))
    path = _find_shapes(definition.name, files["shapes"], text)
    file = read_flex_shapes(path, scene)
    return SoftSystem(definition, scene, file, text)


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
        return _find_shapes(written.definition.name, files, text)
    except MissingPhysicsError:
        return None


def _find_shapes(name: str, files: dict[str, Any], text: str) -> Path:
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


LOADERS = {
    "mujoco": Loader(_read_model, _pack_model, _make_model),
    "mass-spring": Loader(_pack_nothing, _pack_nothing, _make_body),
    "python": Loader(_trust_source, _pack_function, PythonSystem),
    "recorded": Loader(_trust_source, _pack_recording, RecordedSystem),
    "soft": Loader(_pack_shapes, _pack_shapes, _make_soft),
    "flex": Loader(_pack_flex, _pack_flex, _make_flex),
}
"""Loaders by kind of system; the kinds are those of `definitions.carried.TABLES`."""

USUAL_SUBSTEPS = 50
"""Default number of physics steps in a super step of a shipped system."""


def trust_files(toml: str | Path) -> None:
    """Allow this process to run the step function, to open the recordings, or to use the model that a TOML file names.

    This is the only way to run a user's Python code: call it only for a file whose code you would run. The command line
    calls it for the TOML files named there, `load_system` for the one it is given; no dataset, emulator or policy can.
    Emulators and datasets of the TOML file's system then find their physics.
    """
    path = Path(toml)
    loader, definition = _read_definition(path)
    loader.trust(path, definition)


def resolve(reference: str) -> tuple[str, str, int]:
    """Return (name, definition text, usual substeps) of a system given by its name or its TOML file.

    Runs nothing and allows nothing: see `trust_files`, which recordings need first. The text is empty for a shipped
    system. Raises ArgumentError or BadFileError for a wrong definition.
    """
    if not reference.endswith(".toml"):
        refuse_source(reference, "system or TOML file")
        return reference, "", dict(SOFT).get(reference, USUAL_SUBSTEPS)
    path = Path(reference)
    loader, definition = _read_definition(path)
    files = loader.pack(path, definition)
    text = canonical_json({"definition": _travelling(definition), "files": files})
    from_text(text)
    return definition.name, text, definition.substeps


def _travelling(definition: Any) -> dict[str, Any]:
    """Return the definition as JSON values, without the folders it was read from, which only this machine has."""
    if isinstance(definition, SoftDefinition):
        return definition.travelling()
    values = definition.model_dump(mode="json")
    if isinstance(definition, Definition | FlexDefinition):
        values["model"] = Path(definition.model).name
        del values["tree"]
    if isinstance(definition, Definition):
        for key in ("holding", "passive", "task", "follow"):
            if not values[key]:  # as before this key existed
                del values[key]
        if not definition.sampling.reset_share:
            del values["sampling"]["reset_share"], values["sampling"]["reset_noise"]
    for key in ("parameters", "resample", "velocities"):
        if not values.get(key, True):
            del values[key]
    return values


def _read_definition(path: Path) -> tuple[Loader, Any]:
    """Return the loader for the kind of system a TOML file defines, and the checked definition."""
    values = _whole_table(read_toml(path))
    kind = kind_of(values)
    return LOADERS[kind], check_table(values, path.name, TABLES[kind])


def _whole_table(values: dict[str, Any]) -> dict[str, Any]:
    """Return the table of a file: the `family_of` a shipped system inherits the tables it does not give."""
    values = dict(values)
    base = values.pop("family_of", None)
    if base is None:
        return values
    with _assets() as folder:
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


def from_text(text: str) -> System:
    """Return the system of a text of `resolve`. It is checked like any stranger's, and none of its code runs.

    Raises MissingPhysicsError for a missing model.
    """
    written = read_definition_text(text)
    loader = LOADERS[written.kind]
    return loader.make(written.definition, written.files, text)
