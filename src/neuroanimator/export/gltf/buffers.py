"""The pieces of a GLB file: numbers in one binary chunk, a JSON document that points into it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

COMPONENTS = {"float32": 5126, "uint16": 5123, "uint8": 5121}
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942


class Buffer:
    """The binary chunk and the glTF objects that point into it."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self._known: dict[tuple[Any, ...], int] = {}

    def add(
        self, array: np.ndarray, kind: str, *, target: int | None = None, bounds: bool = False
    ) -> int:
        """Return the index of the accessor of `array`, appended if the same numbers are not there yet."""
        key = (array.tobytes(), array.dtype.name, kind, target, bounds)
        if key not in self._known:
            self._known[key] = self._append(array, kind, target, bounds)
        return self._known[key]

    def _append(self, array: np.ndarray, kind: str, target: int | None, bounds: bool) -> int:
        view = {"buffer": 0, "byteOffset": len(self.content), "byteLength": array.nbytes}
        self.views.append(view | ({"target": target} if target else {}))
        self.content += array.tobytes() + b"\0" * (-array.nbytes % 4)
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": COMPONENTS[array.dtype.name],
            "count": len(array),
            "type": kind,
        }
        if bounds:
            flat = array.reshape(len(array), -1)
            accessor |= {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def float32(values: np.ndarray) -> np.ndarray:
    """Return `values` as the file holds numbers, ready for `Buffer.add`."""
    return np.ascontiguousarray(values, dtype=np.float32)


def container(document: dict[str, Any], binary: bytes) -> bytes:
    """Return the bytes of a GLB file."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    words = [MAGIC, 2, 12 + 8 + len(text) + 8 + len(binary), len(text), JSON_CHUNK]
    head = np.array(words, "<u4").tobytes()
    return head + text + np.array([len(binary), BINARY_CHUNK], "<u4").tobytes() + binary
