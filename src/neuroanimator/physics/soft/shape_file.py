"""The file of a soft body's shapes, made once for a definition and its mesh, and kept beside them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from neuroanimator.appearance.shapes import TENSORS, Shapes
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import (
    Tensors,
    canonical_json,
    one_line,
    read_bounded,
    read_tensors,
    write_tensors,
)
from neuroanimator.physics.rigid.compiled_model import compile_model
from neuroanimator.physics.soft.find_shapes import RestingShapes, find_shapes
from neuroanimator.physics.soft.flex_scene import FlexScene
from neuroanimator.physics.soft.mesh import Mesh
from neuroanimator.physics.soft.mesh_file import MAX_FILE, read_mesh
from neuroanimator.physics.soft.recorded_motions import MOTION_STEP, recorded_motions
from neuroanimator.physics.soft.scene import Scene
from neuroanimator.state.mover_poses import Turns, place_movers
from neuroanimator.state.shape_contacts import FREE, first_amplitude, placement_of
from neuroanimator.systems.model_files import ModelFiles
from neuroanimator.systems.movers import Motions, Movers

ENDING = ".shapes.safetensors"
"""Suffix of the file, after the name of the TOML file."""

METHOD = 4
"""Version of the method that finds shapes, increased when its results change."""

FLEX_METHOD = 5
"""The same for a flex, whose points may change separately."""

MAX_NUMBER = 1e6
"""Largest number of a mesh or a state in a file."""


def made_for(toml: Path, definition: SoftDefinition) -> Path:
    """Return the path of the shapes of a TOML file; missing ones are computed first, in under a minute."""
    mesh = toml.parent / definition.mesh
    content = read_bounded(mesh, MAX_FILE)
    values = definition.travelling()
    for name in ("name", "goals", "mesh"):
        del values[name]
    text = canonical_json({"method": METHOD, "definition": values})
    origin = hashlib.sha256(text.encode() + content)
    file = toml.parent / (definition.motions or "")
    if definition.motions is not None:
        origin.update(read_bounded(file, MAX_FILE))

    def scene() -> Scene:
        movers = Movers(definition.movers)
        motions = None if definition.motions is None else recorded_motions(file, movers)
        return Scene(definition, read_mesh(mesh.name, content, definition), motions)

    return _made(toml, definition, origin.hexdigest(), scene)


def made_for_model(toml: Path, definition: FlexDefinition, files: ModelFiles) -> Path:
    """Return the path of the shapes of a TOML file about a model with a flex; missing ones are computed first."""
    values = definition.model_dump(mode="json", exclude={"name", "goals", "model", "tree"})
    text = canonical_json({"method": FLEX_METHOD, "definition": values, "files": files.digests})
    origin = hashlib.sha256(text.encode()).hexdigest()
    return _made(toml, definition, origin, lambda: flex_scene(definition, files))


def flex_scene(definition: FlexDefinition, files: ModelFiles) -> FlexScene:
    """Return the scene of a model with a flex; BadFileError names what is not supported."""
    return FlexScene(definition, files.main, compile_model(files))


def _made(
    toml: Path,
    definition: SoftDefinition | FlexDefinition,
    origin: str,
    scene_of: Callable[[], Scene | FlexScene],
) -> Path:
    """Return the path of the shapes made from sources with the hash `origin`."""
    path = toml.with_name(toml.stem + ENDING)
    if path.exists():
        _, metadata = read_tensors(path, "shapes")
        if metadata.get("origin") == origin:
            return path
    scene = scene_of()
    found = find_shapes(definition, scene)
    tensors = found.shapes.tensors()
    tensors["rest"] = found.rest.astype(np.float32)
    if scene.movers.motions is not None:
        tensors["motions"] = scene.movers.motions.poses.astype(np.float32)
    if isinstance(scene, Scene):
        tensors["positions"] = scene.mesh.positions.astype(np.float32)
        tensors["elements"] = scene.mesh.elements.astype(np.int32)
        if scene.muscles:
            tensors["members"] = _members(scene.mesh, scene.muscles)
    write_tensors(path, tensors, {"kind": "shapes", "origin": origin})
    return path


def read_shapes(
    path: Path, definition: SoftDefinition
) -> tuple[RestingShapes, Mesh, Motions | None]:
    """Return the shapes `made_for` wrote, the mesh, and recorded motions; BadFileError names the fault."""
    turning: tuple[Turns, ...] = tuple(mover.turns for mover in definition.movers.values())
    holding = [number for number, mover in enumerate(definition.movers.values()) if mover.pins]
    anchor = holding[0] if holding else FREE
    tensors, _ = read_tensors(path, "shapes")
    with _faults_named(path):
        muscles = tuple(definition.muscles.along) if definition.muscles else ()
        others = len(definition.parameters) + len(muscles)
        file = _checked(tensors, turning, anchor, others)
        mesh = _mesh_of(tensors, file.shapes, 3 + definition.is_solid)
        motions = None
        if definition.motions is not None:
            motions = _motions_of(tensors["motions"], turning)
        if not muscles:
            return file, mesh, motions
        members = tensors["members"]
        if (
            members.shape != (len(mesh.elements),)
            or not ((members >= -1) & (members < len(muscles))).all()
        ):
            raise ValueError("muscles of another mesh")
        return file, mesh._replace(groups=muscles, members=members.astype(int)), None


def _members(mesh: Mesh, muscles: tuple[str, ...]) -> np.ndarray:
    """Return the number of the muscle each element is in, -1 for none."""
    assert mesh.members is not None
    numbers = [muscles.index(name) if name in muscles else -1 for name in mesh.groups]
    return np.array([*numbers, -1], np.int16)[mesh.members]


def read_flex_shapes(path: Path, scene: FlexScene) -> RestingShapes:
    """Return the shapes `made_for_model` wrote; BadFileError names the fault."""
    tensors, _ = read_tensors(path, "shapes")
    with _faults_named(path):
        file = _checked(tensors, scene.movers.turning, scene.anchor)
        if file.shapes.mean.shape != scene.positions.shape:
            raise ValueError("other numbers of nodes in the model and in the shapes")
        return file


@contextmanager
def _faults_named(path: Path) -> Iterator[None]:
    try:
        yield
    except (ValueError, KeyError) as error:
        raise BadFileError(
            f"{path.name}: {one_line(error)}. Remove it; it is made again."
        ) from error


def _checked(
    tensors: Tensors, turning: tuple[Turns, ...], anchor: int, others: int = 0
) -> RestingShapes:
    first = first_amplitude(turning, anchor)
    own = {name: tensors[name] for name in TENSORS}
    size = first + 2 * len(own["scales"]) + others
    shapes = Shapes.from_tensors(own, first, placement_of(turning, anchor), size)
    rest = tensors["rest"]
    if rest.shape != (size,):
        raise ValueError("a state of another size")
    _check_numbers(rest)
    return RestingShapes(shapes, rest.astype(float))


def _mesh_of(tensors: Tensors, shapes: Shapes, corners: int) -> Mesh:
    positions = tensors["positions"]
    elements = tensors["elements"]
    if elements.ndim != 2 or elements.shape[1] != corners:
        raise ValueError("elements of another kind")
    if positions.shape != shapes.mean.shape:
        raise ValueError("other numbers of nodes in the mesh and in the shapes")
    _check_numbers(positions)
    _check_numbers(elements)
    return Mesh(positions.astype(float), elements.astype(int))


def _motions_of(poses: np.ndarray, turning: tuple[Turns, ...]) -> Motions:
    size = sum(place.size for place in place_movers(turning))
    if poses.ndim != 2 or poses.shape[1] != size or len(poses) < 2:
        raise ValueError("motions of other movers")
    _check_numbers(poses)
    return Motions(poses.astype(float), MOTION_STEP)


def _check_numbers(array: np.ndarray) -> None:
    if not (np.abs(array) <= MAX_NUMBER).all():
        raise ValueError("a number that is too large")
