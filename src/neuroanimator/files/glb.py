"""GLB files: the constants of the container, and a reader of strangers' files, which are bounded before they are parsed."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import one_line, read_bounded
from neuroanimator.files.json_text import parse_json_object
from neuroanimator.files.numbers import listed, whole
from neuroanimator.text import quoted

MAGIC = 0x46546C67
"""First number of a GLB file: 'glTF'."""

VERSION = 2
"""Version of the GLB container."""

JSON_CHUNK = 0x4E4F534A
"""Type of the document's chunk: 'JSON' as a number."""

BINARY_CHUNK = 0x004E4942
"""Type of the binary chunk: 'BIN' as a number."""

HEADER_SIZE = 12
"""Size of the file's header [bytes]."""

CHUNK_HEADER_SIZE = 8
"""Size of a chunk's header [bytes]: its length and its type."""

COMPONENTS = {
    "float32": 5126,
    "uint32": 5125,
    "uint16": 5123,
    "int16": 5122,
    "uint8": 5121,
    "int8": 5120,
}
"""The format's codes of number types, by their names in NumPy."""

WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
"""Number of numbers in an element, by the format's name: those used by animations and skins."""

MAX_FILE = 256 * 2**20
"""Maximum size of a file read [bytes]: a character with its meshes and textures."""

MAX_DOCUMENT = 16 * 2**20
"""Maximum size of a JSON document read [bytes]."""

MAX_OBJECTS = 100_000
"""Maximum number of nodes, and of other objects of one kind."""

MAX_COUNT = 1_000_000
"""Maximum number of elements of an array: an animation of hours."""


@dataclass(frozen=True, eq=False)
class Glb:
    """A document and the bytes it points into."""

    document: dict[str, Any]
    binary: bytes
    _checked: dict[str, list[dict[str, Any]]] = field(default_factory=dict, init=False, repr=False)
    """Lists of objects by kind, once they are checked: many objects point into each."""

    def objects(self, kind: str) -> list[dict[str, Any]]:
        """Return the objects in the document's list `kind`; ValueError if it is not a list of objects."""
        if kind not in self._checked:
            self._checked[kind] = objects_in(self.document, kind)
        return self._checked[kind]

    def array(
        self, accessor: Any, element: str, *, is_last_alone: bool = False, is_index: bool = False
    ) -> Float[np.ndarray, "N W"]:
        """Return the finite numbers of an accessor of `element`s, such as `VEC3`, or the last of them.

        Whole numbers are shares of the largest, or indices. Raises ValueError with what is wrong.
        """
        described = object_at(self.objects("accessors"), accessor, "accessor")
        what = f"accessor {accessor}"
        if described.get("type") != element:
            raise ValueError(f"{what}: wanted {element}, got {quoted(described.get('type'))}")
        if "sparse" in described or "bufferView" not in described:
            raise ValueError(f"{what}: a sparse array. Save the file without them")
        count = whole(described.get("count"), f"{what}: count", 1, MAX_COUNT)
        code = described.get("componentType")
        names = [name for name, number in COMPONENTS.items() if number == code]
        if not names:
            raise ValueError(f"{what}: unknown componentType {quoted(code)}")
        kind = np.dtype(names[0]).newbyteorder("<")
        width = WIDTHS[element]
        size = kind.itemsize * width
        view, stride = self._view(described["bufferView"], size)
        offset = whole(described.get("byteOffset", 0), f"{what}: byteOffset", 0, len(view))
        if stride != size or offset + count * size > len(view):
            raise ValueError(f"{what}: it reads beyond its bufferView, or not in one piece")
        if is_last_alone:
            offset += (count - 1) * size
            count = 1
        numbers = np.frombuffer(view, kind, count * width, offset).reshape(count, width)
        values = numbers.astype(float)
        if kind.kind in "iu" and not is_index:
            values = np.maximum(values / np.iinfo(kind).max, -1)
        if not np.isfinite(values).all():
            raise ValueError(f"{what}: a number that is not finite")
        return values

    def _view(self, index: Any, size: int) -> tuple[memoryview, Any]:
        """Return the bytes of a bufferView, and the stride of its elements, each of `size` bytes."""
        view = object_at(self.objects("bufferViews"), index, "bufferView")
        what = f"bufferView {index}"
        if view.get("extensions"):
            raise ValueError(f"{what}: compressed. Save the file without compression")
        buffer = object_at(self.objects("buffers"), view.get("buffer"), "buffer")
        if view.get("buffer") != 0 or "uri" in buffer:
            raise ValueError(f"{what}: its data is in another file. Save all in one .glb file")
        offset = whole(view.get("byteOffset", 0), f"{what}: byteOffset", 0, len(self.binary))
        room = len(self.binary) - offset
        length = whole(view.get("byteLength"), f"{what}: byteLength", 1, room)
        return memoryview(self.binary)[offset : offset + length], view.get("byteStride", size)


def objects_in(owner: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    """Return the objects in a list `kind` of `owner`, none if it is missing; ValueError if it is not a list of objects."""
    values = listed(owner.get(kind, []), kind, _object)
    if len(values) > MAX_OBJECTS:
        raise ValueError(f"{kind}: {len(values):,} of them; wanted at most {MAX_OBJECTS:,}")
    return list(values)


def _object(value: Any, what: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{what}: wanted JSON objects, got {quoted(value)}")
    return value


def object_at(objects: list[dict[str, Any]], index: Any, what: str) -> dict[str, Any]:
    """Return one of the `objects`; ValueError if the file's `index` is out of range."""
    if not objects:
        raise ValueError(f"no {what} in the file")
    return objects[whole(index, f"number of a {what}", 0, len(objects) - 1)]


def read_glb(path: Path) -> Glb:
    """Return the document and the bytes of a GLB file; BadFileError names the fault."""
    content = read_bounded(path, MAX_FILE)
    try:
        return parse_glb(content)
    except ValueError as error:
        raise BadFileError(f"{path}: {one_line(error)}.") from error


def parse_glb(content: bytes) -> Glb:
    """Return the document and the bytes in the content of a GLB file; ValueError says what is wrong."""
    header = np.frombuffer(content[:HEADER_SIZE].ljust(HEADER_SIZE, b"\0"), "<u4")
    magic, version, size = header.tolist()
    if magic != MAGIC:
        raise ValueError("not a GLB file. Save it as .glb (glTF in one file)")
    if version != VERSION:
        raise ValueError(f"version {version} of GLB; wanted {VERSION}")
    if size != len(content):
        raise ValueError(f"truncated: {len(content):,} bytes; its header says {size:,}")
    text, rest = _chunk(content[HEADER_SIZE:], JSON_CHUNK, "JSON")
    document = parse_json_object(text.rstrip(b" \0"), MAX_DOCUMENT)
    binary = b""
    if rest:
        binary, _ = _chunk(rest, BINARY_CHUNK, "binary")
    return Glb(document, binary)


def _chunk(content: bytes, wanted: int, name: str) -> tuple[bytes, bytes]:
    """Return the first chunk of `content`, and the rest."""
    if len(content) < CHUNK_HEADER_SIZE:
        raise ValueError(f"no {name} chunk")
    length, kind = np.frombuffer(content[:CHUNK_HEADER_SIZE], "<u4").tolist()
    end = CHUNK_HEADER_SIZE + length
    if kind != wanted or end > len(content):
        raise ValueError(f"no {name} chunk, or one that is longer than the file")
    return content[CHUNK_HEADER_SIZE:end], content[end:]
