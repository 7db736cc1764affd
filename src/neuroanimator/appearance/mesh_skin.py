"""A skin of triangles that follow the bones of a model, as an emulator's file carries it: packed integers in base64."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from neuroanimator.files.names import LABEL_PATTERN
from neuroanimator.files.tables import Share, Table

MAX_VERTICES = 10_000
"""Maximum number of vertices: a file carries them in its header, and they are drawn."""

MAX_TRIANGLES = 20_000
"""Maximum number of triangles."""

MAX_PARTS = 32
"""Maximum number of parts, each of one colour."""

MAX_BONES = 255
"""Maximum number of bones that vertices follow: their numbers take one byte."""

MAX_BONE = 10_000
"""Largest bone number accepted before the skeleton is known."""

MAX_BYTES = 6 * MAX_TRIANGLES
"""Maximum size of an array [bytes]: a stranger's few may unpack to very many."""

PACKED = "zlib:"
"""Prefix of base64 whose bytes are packed; those of older files are not."""

INFLUENCES = 4
"""Number of bones a vertex follows, as in glTF."""

WHOLE = 255
"""Sum of the four weights of a vertex, which are integers."""

LARGEST = 2**16 - 1
"""Largest coordinate of a vertex, in steps from the skin's lowest corner."""

UNIT_TOLERANCE = 1e-3
"""Tolerance of the length of a bone's quaternion, which should be 1."""

Coordinate = Annotated[float, Field(ge=-1e3, le=1e3, allow_inf_nan=False)]
"""A coordinate [m]."""

Component = Annotated[float, Field(ge=-2, le=2, allow_inf_nan=False)]
"""A component of a quaternion."""


def _packed(numbers: bytes) -> str:
    """Return the text of an array in a file."""
    return PACKED + base64.b64encode(zlib.compress(numbers, zlib.Z_BEST_COMPRESSION)).decode()


def _unpacked(text: Any) -> bytes:
    """Return the array that `_packed` wrote, or an older file holds; ValueError if it is damaged. Bytes stay as they are."""
    if isinstance(text, bytes):
        return text
    if not isinstance(text, str):
        raise ValueError("an array is not text")
    try:
        content = base64.b64decode(text.removeprefix(PACKED), validate=True)
    except ValueError as error:
        raise ValueError("an array is not base64") from error
    if not text.startswith(PACKED):
        return content
    stream = zlib.decompressobj()
    try:
        numbers = stream.decompress(content, MAX_BYTES + 1)
    except zlib.error as error:
        raise ValueError("an array is damaged") from error
    if not stream.eof or stream.unused_data:
        raise ValueError(f"an array is truncated, or larger than {MAX_BYTES:,} bytes")
    return numbers


Numbers = Annotated[bytes, BeforeValidator(_unpacked), PlainSerializer(_packed, when_used="json")]
"""Little-endian unsigned integers: bytes in memory, text in a file."""


class BoundBone(Table):
    """A bone that vertices follow, and its pose when the skin was made."""

    number: int = Field(ge=0, le=MAX_BONE)
    """Its number in the skeleton."""
    position: tuple[Coordinate, Coordinate, Coordinate]
    """Its position in the bind pose [m]."""
    orientation: tuple[Component, Component, Component, Component]
    """Its quaternion wxyz in the bind pose."""


class SkinPart(Table):
    """Triangles of one colour, after those of the part before."""

    name: str = Field(pattern=LABEL_PATTERN)
    colour: tuple[Share, Share, Share]
    """Red, green and blue."""
    triangles: int = Field(ge=1, le=MAX_TRIANGLES)
    """Number of its triangles."""


class SkinArrays(NamedTuple):
    """The arrays of a skin."""

    vertices: Float[np.ndarray, "V 3"]
    """Positions in the bind pose [m]."""
    triangles: Int[np.ndarray, "M 3"]
    """Numbers of vertices, counterclockwise from outside."""
    bones: Int[np.ndarray, "V 4"]
    """Numbers of the bones that a vertex follows, in the skeleton."""
    weights: Float[np.ndarray, "V 4"]
    """Weight of each of those bones; the rows add up to 1."""


class MeshSkin(Table):
    """Triangles whose vertices follow up to four bones each by linear blending: what MuJoCo calls a skin."""

    kind: Literal["mesh"]
    bones: tuple[BoundBone, ...] = Field(min_length=1, max_length=MAX_BONES)
    parts: tuple[SkinPart, ...] = Field(min_length=1, max_length=MAX_PARTS)
    lowest: tuple[Coordinate, Coordinate, Coordinate]
    """Corner from which coordinates are measured [m]."""
    step: float = Field(gt=0, le=1, allow_inf_nan=False)
    """Unit of the coordinates [m]."""
    vertices: Numbers
    """Coordinates (V, 3), 16 bits each."""
    triangles: Numbers
    """Vertices of the triangles (M, 3), 16 bits each."""
    influences: Numbers
    """Indices into `bones` of the four that each vertex follows (V, 4), 8 bits each."""
    weights: Numbers
    """Weights of those bones (V, 4), 8 bits each; rows add up to 255."""

    @model_validator(mode="after")
    def _check(self) -> MeshSkin:
        vertices = _rows(self.vertices, "<u2", 3)
        triangles = _rows(self.triangles, "<u2", 3)
        influences = _rows(self.influences, "u1", INFLUENCES)
        weights = _rows(self.weights, "u1", INFLUENCES)
        count = len(vertices)
        if not 3 <= count <= MAX_VERTICES or len(triangles) > MAX_TRIANGLES:
            raise ValueError(f"{len(triangles)} triangles of {count} vertices")
        if len(influences) != count or len(weights) != count:
            raise ValueError("wanted four bones and four weights per vertex")
        if len({part.name for part in self.parts}) < len(self.parts):
            raise ValueError("two parts with the same name")
        if sum(part.triangles for part in self.parts) != len(triangles):
            raise ValueError("its parts do not cover all triangles")
        if triangles.max() >= count:
            raise ValueError("a triangle names a vertex that does not exist")
        if influences.max() >= len(self.bones):
            raise ValueError("a vertex follows a bone that does not exist")
        if (weights.sum(axis=1, dtype=int) != WHOLE).any():
            raise ValueError(f"the weights of a vertex do not add up to {WHOLE}")
        for bone in self.bones:
            if abs(np.linalg.norm(bone.orientation) - 1) > UNIT_TOLERANCE:
                raise ValueError("a quaternion is not of length 1")
        return self

    def fits(self, bone_positions: Sequence[Sequence[float]]) -> bool:
        """Return whether the bones at these positions [m] include all that vertices follow."""
        return max(bone.number for bone in self.bones) < len(bone_positions)

    @cached_property
    def arrays(self) -> SkinArrays:
        """The arrays as numbers to compute with."""
        numbers = np.array([bone.number for bone in self.bones])
        steps = _rows(self.vertices, "<u2", 3)
        return SkinArrays(
            vertices=np.array(self.lowest) + self.step * steps,
            triangles=_rows(self.triangles, "<u2", 3).astype(int),
            bones=numbers[_rows(self.influences, "u1", INFLUENCES)],
            weights=_rows(self.weights, "u1", INFLUENCES) / WHOLE,
        )

    @classmethod
    def of(
        cls, arrays: SkinArrays, bones: Sequence[BoundBone], parts: Sequence[SkinPart]
    ) -> MeshSkin:
        """Return the skin of `arrays` as a file holds it: coordinates in steps of a power of two, so that reading and
        writing them again keeps them."""
        lowest = arrays.vertices.min(axis=0)
        extent = float(np.ptp(arrays.vertices, axis=0).max())
        step = 2.0 ** np.ceil(np.log2(max(extent, 1e-6) / (LARGEST - 1)))
        lowest = np.floor(lowest / step) * step
        places = {bone.number: place for place, bone in enumerate(bones)}
        influences = np.vectorize(places.__getitem__, otypes=[int])(arrays.bones)
        return cls(
            kind="mesh",
            bones=tuple(bones),
            parts=tuple(parts),
            lowest=tuple(lowest.tolist()),
            step=step,
            vertices=_bytes(np.round((arrays.vertices - lowest) / step), "<u2"),
            triangles=_bytes(arrays.triangles, "<u2"),
            influences=_bytes(influences, "u1"),
            weights=_bytes(_whole_weights(arrays.weights), "u1"),
        )


def _whole_weights(weights: Float[np.ndarray, "V 4"]) -> Int[np.ndarray, "V 4"]:
    """Return weights as integers that add up to `WHOLE`: the largest takes what rounding leaves."""
    whole = np.round(WHOLE * weights).astype(int)
    rows = np.arange(len(whole))
    whole[rows, whole.argmax(axis=1)] += WHOLE - whole.sum(axis=1)
    return whole


def _bytes(numbers: np.ndarray, kind: str) -> bytes:
    return numbers.astype(kind).tobytes()


def _rows(numbers: bytes, kind: str, columns: int) -> np.ndarray:
    """Return an array of the NumPy type `kind` as rows of `columns` numbers; ValueError if the last is not whole."""
    row_size = columns * np.dtype(kind).itemsize
    if not numbers or len(numbers) % row_size:
        raise ValueError("an array is truncated")
    return np.frombuffer(numbers, kind).reshape(-1, columns)
