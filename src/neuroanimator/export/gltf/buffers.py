"""The parts of a GLB file: numbers in one binary chunk, and a JSON document that points into it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Num

from neuroanimator.files.glb import (
    BINARY_CHUNK,
    CHUNK_HEADER_SIZE,
    COMPONENTS,
    HEADER_SIZE,
    JSON_CHUNK,
    MAGIC,
    VERSION,
)

ARRAY_BUFFER = 34962
"""The format's code for vertex attributes."""

ELEMENT_ARRAY_BUFFER = 34963
"""The format's code for vertex indices."""

ALIGNMENT = 4
"""Alignment of chunks and arrays [bytes]."""


class Buffer:
    """The binary chunk and the glTF objects that point into it."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self._known: dict[tuple[Any, ...], int] = {}

    def add(
        self,
        array: Num[np.ndarray, "*S"],
        element: str,
        *,
        target: int | None = None,
        has_bounds: bool = False,
    ) -> int:
        """Return the index of the accessor of `array`, appended unless the same numbers are there.

        `element` is the format's type of a row, such as `VEC3`; `target` is the purpose of the numbers, and
        `has_bounds` adds their minimum and maximum. Signed integers are normalised: the largest means 1.
        """
        key = (array.tobytes(), array.dtype.name, element, target, has_bounds)
        if key not in self._known:
            self._known[key] = self._append(array, element, target, has_bounds)
        return self._known[key]

    def _append(self, array: np.ndarray, element: str, target: int | None, has_bounds: bool) -> int:
        rows = array.reshape(len(array), -1)
        stride = rows.itemsize * rows.shape[1]
        beyond = -stride % ALIGNMENT
        content = array.tobytes()
        view = {"buffer": 0, "byteOffset": len(self.content)}
        if target == ARRAY_BUFFER and beyond:
            view["byteStride"] = stride + beyond
            padding = np.zeros((len(rows), beyond // rows.itemsize), rows.dtype)
            content = np.concatenate([rows, padding], axis=1).tobytes()
        view["byteLength"] = len(content)
        if target:
            view["target"] = target
        self.views.append(view)
        self.content += content + b"\0" * (-len(content) % ALIGNMENT)
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": COMPONENTS[array.dtype.name],
            "count": len(array),
            "type": element,
        }
        if array.dtype.kind == "i":
            accessor["normalized"] = True
        if has_bounds:
            accessor["min"] = rows.min(axis=0).tolist()
            accessor["max"] = rows.max(axis=0).tolist()
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def as_float32(values: Float[np.ndarray, "*S"]) -> Float32[np.ndarray, "*S"]:
    """Return `values` in the file's number type, ready for `Buffer.add`."""
    return np.ascontiguousarray(values, dtype=np.float32)


def glb_bytes(document: dict[str, Any], binary: bytes) -> bytes:
    """Return the bytes of a GLB file: a header, the JSON `document` and the `binary` chunk."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % ALIGNMENT)
    size = HEADER_SIZE + CHUNK_HEADER_SIZE + len(text) + CHUNK_HEADER_SIZE + len(binary)
    header = np.array([MAGIC, VERSION, size], "<u4").tobytes()
    text_header = np.array([len(text), JSON_CHUNK], "<u4").tobytes()
    binary_header = np.array([len(binary), BINARY_CHUNK], "<u4").tobytes()
    return header + text_header + text + binary_header + binary
