"""The file of a soft body's shapes, made once for a definition and its mesh or model, and kept beside them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.appearance.shapes import TENSORS, Shapes
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import (
    canonical_json,
    one_line,
    read_bounded,
    read_tensors,
    write_tensors,
)
from neuroanimator.systems.rigid.compiled_model import compile_model
from neuroanimator.systems.rigid.model_files import ModelFiles
from neuroanimator.systems.soft.find_shapes import find_shapes
from neuroanimator.systems.soft.flex_scene import FlexScene
from neuroanimator.systems.soft.obj_file import MAX_FILE, read_obj
from neuroanimator.systems.soft.scene import Scene

ENDING = ".shapes.safetensors"
"""Ending of the file's name, after that of the TOML file."""

METHOD = 1
"""Number of the way shapes are found, raised whenever others would be."""

MAX_STARTS = 10_000
"""Maximum number of states in a file."""

MAX_NUMBER = 1e6
"""Largest number of a state in a file."""


class ShapeFile(NamedTuple):
    """A mesh, its shapes, and states that motions may begin from, the first that of rest."""

    positions: Float[np.ndarray, "N 3"]
    """As the mesh has them [m]."""
    shapes: Shapes
    starts: Float[np.ndarray, "P S"]


def made_for(toml: Path, definition: SoftDefinition) -> Path:
    """Return the path of the shapes of a TOML file; they are found first, in under a minute, unless they are there."""
    mesh = toml.parent / definition.mesh
    content = read_bounded(mesh, MAX_FILE)
    values = definition.model_dump(mode="json", exclude={"name", "goals", "mesh"})
    text = canonical_json({"method": METHOD, "definition": values})
    origin = hashlib.sha256(text.encode() + content).hexdigest()

    def scene() -> Scene:
        positions, faces = read_obj(mesh.name, content)
        return Scene(definition, positions, faces)

    return _made(toml, definition, origin, scene)


def made_for_model(toml: Path, definition: FlexDefinition, files: ModelFiles) -> Path:
    """Return the path of the shapes of a TOML file about a model with a flex; they are found first unless they are there."""
    values = definition.model_dump(mode="json", exclude={"name", "goals", "model", "tree"})
    text = canonical_json({"method": METHOD, "definition": values, "files": files.digests})
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
    """Return the path of the shapes that follow from what has the hash `origin`."""
    path = toml.with_name(toml.stem + ENDING)
    if path.exists():
        _, metadata = read_tensors(path, "shapes")
        if metadata.get("origin") == origin:
            return path
    scene = scene_of()
    found = find_shapes(definition, scene)
    tensors = found.shapes.tensors()
    tensors["positions"] = scene.positions.astype(np.float32)
    tensors["starts"] = found.starts.astype(np.float32)
    write_tensors(path, tensors, {"kind": "shapes", "origin": origin})
    return path


def read_shapes(path: Path, movers: int, anchor: int) -> ShapeFile:
    """Return what `made_for` wrote, of a body that goes with mover `anchor`; -1 if it goes with none.

    BadFileError names what is wrong with the file.
    """
    tensors, _ = read_tensors(path, "shapes")
    try:
        return _checked(tensors, movers, anchor)
    except (ValueError, KeyError) as error:
        raise BadFileError(
            f"{path.name}: {one_line(error)}. Remove it; it is made again."
        ) from error


def _checked(tensors: dict[str, np.ndarray], movers: int, anchor: int) -> ShapeFile:
    first = 6 * movers
    own = {name: tensors[name] for name in TENSORS}
    count = len(own["modes"])
    size = first + 2 * count
    shapes = Shapes.from_tensors(own, first, 3 * anchor if anchor >= 0 else -1, size)
    positions = tensors["positions"]
    starts = tensors["starts"]
    if positions.shape != shapes.mean.shape:
        raise ValueError("another number of nodes in the mesh than in the shapes")
    if starts.ndim != 2 or starts.shape[1] != size or not 1 <= len(starts) <= MAX_STARTS:
        raise ValueError("states of another size")
    for array in (positions, starts):
        if not (np.abs(array) <= MAX_NUMBER).all():
            raise ValueError("a number that is too large")
    return ShapeFile(positions.astype(float), shapes, starts.astype(float))
