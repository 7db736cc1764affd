"""Make systems from definitions: the shipped ones, and users' own from their TOML files.

A user's system travels with its datasets and emulators as one JSON text: its checked definition, and the sha256 of the
files of its physics. These files stay with the user, and are looked for when needed: see `trusted_files`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from neuroanimator.definitions.body import BodyDefinition
from neuroanimator.definitions.carried import (
    read_definition_text,
)
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.definitions.model import Definition
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import canonical_json
from neuroanimator.files.sources import refuse_source
from neuroanimator.files.zoo import SOFT, shipped_path
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.physics.functions.function_system import PythonSystem
from neuroanimator.physics.recorded.recorded_system import RecordedSystem
from neuroanimator.physics.recorded.recording import read_recording
from neuroanimator.physics.rigid.compiled_model import compile_model
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.physics.rigid.mujoco_system import load_model
from neuroanimator.physics.soft.find_shapes import RestingShapes
from neuroanimator.physics.soft.mesh_file import read_mesh
from neuroanimator.physics.soft.scene import Scene
from neuroanimator.physics.soft.shape_file import (
    flex_scene,
    made_for,
    made_for_model,
    read_flex_shapes,
    read_shapes,
)
from neuroanimator.physics.soft.soft_system import SoftSystem
from neuroanimator.systems.model_files import ModelFiles
from neuroanimator.systems.named_files import (
    find_model,
    find_shapes,
    read_definition,
    read_named_model,
    shipped_folder,
)
from neuroanimator.systems.system import System
from neuroanimator.systems.trusted_files import (
    digest_of,
    trust_file,
)


def packaged(name: str) -> System:
    """Return the system whose TOML, and MJCF if any, ship under `name`."""
    with shipped_folder() as folder:
        _, definition = read_definition(folder / f"{name}.toml")
        if isinstance(definition, SoftDefinition):
            return _packaged_soft(definition, folder)
    if isinstance(definition, BodyDefinition):
        return DeformableSystem(definition)
    return ModelSystem(definition, load_model(definition.model))


def _packaged_soft(definition: SoftDefinition, folder: Path) -> SoftSystem:
    """Return the soft body whose mesh lies in `folder`; its shapes and its state of rest are those of its emulator."""
    from neuroanimator.emulator.emulator import load_emulator

    mesh = read_mesh(definition.mesh, (folder / definition.mesh).read_bytes(), definition)
    emulator = load_emulator(shipped_path(definition.name, definition.substeps))
    shapes = emulator.skeleton.shapes
    assert shapes is not None
    return SoftSystem(definition, Scene(definition, mesh), RestingShapes(shapes, emulator.rest))


class Loader(NamedTuple):
    """The functions that describe systems of one kind as text and make them again."""

    trust: Callable[[Path, Any], object]
    """Allows this process to use that file, given the TOML file and the definition."""
    pack: Callable[[Path, Any], Any]
    """Returns the description of that file that travels along, as JSON values, given the TOML file and the definition."""
    make: Callable[[Any, Any, str], System]
    """Returns the system made from (definition, that description, definition text)."""


def _pack_model(toml: Path, definition: Definition) -> Any:
    files = read_named_model(toml, definition)
    return _model_named(toml, files)


def _model_named(toml: Path, files: ModelFiles) -> dict[str, Any]:
    """Return the names of a model's files for a definition text."""
    return {"toml": toml.name, "main": files.main, "sha256": files.digests}


def _make_model(definition: Definition, files: Any, text: str) -> System:
    found = find_model(definition.name, files, text)
    model = compile_model(found, definition.base, definition.passive)
    if model.nflex:
        raise BadFileError(
            f"{found.main}: it has a soft body, which 'kind = \"mujoco\"' does not support. Write the TOML file again: "
            f"neuroanimator new {found.main} --force"
        )
    return ModelSystem(definition, model, text)


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
    path = find_shapes(definition.name, files, text)
    file, mesh, motions = read_shapes(path, definition)
    return SoftSystem(definition, Scene(definition, mesh, motions), file, text)


def _pack_flex(toml: Path, definition: FlexDefinition) -> dict[str, Any]:
    files = read_named_model(toml, definition)
    shapes = made_for_model(toml, definition, files)
    return {
        "model": _model_named(toml, files),
        "shapes": {"name": shapes.name, "sha256": trust_file(shapes)},
    }


def _make_flex(definition: FlexDefinition, files: dict[str, Any], text: str) -> System:
    scene = flex_scene(definition, find_model(definition.name, files["model"], text))
    path = find_shapes(definition.name, files["shapes"], text)
    file = read_flex_shapes(path, scene)
    return SoftSystem(definition, scene, file, text)


LOADERS = {
    "mujoco": Loader(read_named_model, _pack_model, _make_model),
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
    kind, definition = read_definition(path)
    LOADERS[kind].trust(path, definition)


def resolve(reference: str) -> tuple[str, str, int]:
    """Return (name, definition text, usual substeps) of a system given by its name or its TOML file.

    Runs nothing and allows nothing: see `trust_files`, which recordings need first. The text is empty for a shipped
    system. Raises ArgumentError or BadFileError for a wrong definition.
    """
    if not reference.endswith(".toml"):
        refuse_source(reference, "system or TOML file")
        return reference, "", dict(SOFT).get(reference, USUAL_SUBSTEPS)
    path = Path(reference)
    kind, definition = read_definition(path)
    files = LOADERS[kind].pack(path, definition)
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


def from_text(text: str) -> System:
    """Return the system of a text of `resolve`. It is checked like any stranger's, and none of its code runs.

    Raises MissingPhysicsError for a missing model.
    """
    written = read_definition_text(text)
    loader = LOADERS[written.kind]
    return loader.make(written.definition, written.files, text)
