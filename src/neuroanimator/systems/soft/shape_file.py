"""The file of a soft body's shapes, made once for a definition and its mesh, and kept beside them."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.appearance.shapes import TENSORS, Shapes
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import (
    canonical_json,
    one_line,
    read_bounded,
    read_tensors,
    write_tensors,
)
from neuroanimator.state.shape_contacts import first_amplitude, placement_of
from neuroanimator.systems.soft.find_shapes import find_shapes
from neuroanimator.systems.soft.mesh_file import MAX_FILE, Mesh, read_mesh
from neuroanimator.systems.soft.scene import Scene

ENDING = ".shapes.safetensors"
"""Ending of the file's name, after that of the TOML file."""

METHOD = 2
"""Number of the way shapes are found, raised whenever others would be."""

MAX_STARTS = 10_000
"""Maximum number of states in a file."""

MAX_NUMBER = 1e6
"""Largest number of a state in a file."""


class ShapeFile(NamedTuple):
    """A mesh, its shapes, and states that motions may begin from, the first that of rest."""

    mesh: Mesh
    shapes: Shapes
    starts: Float[np.ndarray, "P S"]


def made_for(toml: Path, definition: SoftDefinition) -> Path:
    """Return the path of the shapes of a TOML file; they are found first, in under a minute, unless they are there."""
    path = toml.with_name(toml.stem + ENDING)
    mesh = toml.parent / definition.mesh
    content = read_bounded(mesh, MAX_FILE)
    origin = _origin(definition, content)
    if path.exists():
        _, metadata = read_tensors(path, "shapes")
        if metadata.get("origin") == origin:
            return path
    found_mesh = read_mesh(mesh.name, content)
    found = find_shapes(definition, Scene(definition, found_mesh))
    tensors = found.shapes.tensors()
    tensors["positions"] = found_mesh.positions.astype(np.float32)
    tensors["elements"] = found_mesh.elements.astype(np.int32)
    tensors["starts"] = found.starts.astype(np.float32)
    write_tensors(path, tensors, {"kind": "shapes", "origin": origin})
    return path


def read_shapes(path: Path, definition: SoftDefinition) -> ShapeFile:
    """Return what `made_for` wrote; BadFileError names what is wrong with the file."""
    tensors, _ = read_tensors(path, "shapes")
    try:
        return _checked(tensors, definition)
    except (ValueError, KeyError) as error:
        raise BadFileError(
            f"{path.name}: {one_line(error)}. Remove it; it is made again."
        ) from error


def _checked(tensors: dict[str, np.ndarray], definition: SoftDefinition) -> ShapeFile:
    turning = tuple(mover.turns for mover in definition.movers.values())
    holding = [number for number, mover in enumerate(definition.movers.values()) if mover.pins]
    anchor = holding[0] if holding else -1
    first = first_amplitude(turning, anchor)
    own = {name: tensors[name] for name in TENSORS}
    size = first + 2 * len(own["modes"])
    shapes = Shapes.from_tensors(own, first, placement_of(turning, anchor), size)
    positions = tensors["positions"]
    elements = tensors["elements"]
    if elements.ndim != 2 or elements.shape[1] != 3 + definition.is_solid:
        raise ValueError("elements of another kind")
    starts = tensors["starts"]
    if positions.shape != shapes.mean.shape:
        raise ValueError("another number of nodes in the mesh than in the shapes")
    if starts.ndim != 2 or starts.shape[1] != size or not 1 <= len(starts) <= MAX_STARTS:
        raise ValueError("states of another size")
    for array in (positions, elements, starts):
        if not (np.abs(array) <= MAX_NUMBER).all():
            raise ValueError("a number that is too large")
    mesh = Mesh(positions.astype(float), elements.astype(int))
    return ShapeFile(mesh, shapes, starts.astype(float))


def _origin(definition: SoftDefinition, mesh: bytes) -> str:
    """Return a hash of all that the shapes follow from."""
    values = definition.model_dump(mode="json", exclude={"name", "goals", "mesh"})
    text = canonical_json({"method": METHOD, "definition": values})
    return hashlib.sha256(text.encode() + mesh).hexdigest()
