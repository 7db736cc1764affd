"""A skin of triangles that follow the bones of a model, as an emulator's file carries it: integers in base64."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from pydantic import Field, model_validator

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

MAX_TEXT = 2**20
"""Maximum number of characters of an array."""

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

Numbers = Annotated[str, Field(max_length=MAX_TEXT, pattern=r"^[A-Za-z0-9+/]*={0,2}$")]
"""Little-endian unsigned integers, in base64."""


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
        vertices = _unpacked(self.vertices, "<u2", 3)
        triangles = _unpacked(self.triangles, "<u2", 3)
        influences = _unpacked(self.influences, "u1", INFLUENCES)
        weights = _unpacked(self.weights, "u1", INFLUENCES)
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
        steps = _unpacked(self.vertices, "<u2", 3)
        return SkinArrays(
            vertices=np.array(self.lowest) + self.step * steps,
            triangles=_unpacked(self.triangles, "<u2", 3).astype(int),
            bones=numbers[_unpacked(self.influences, "u1", INFLUENCES)],
            weights=_unpacked(self.weights, "u1", INFLUENCES) / WHOLE,
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
            vertices=_packed(np.round((arrays.vertices - lowest) / step), "<u2"),
            triangles=_packed(arrays.triangles, "<u2"),
            influences=_packed(influences, "u1"),
            weights=_packed(_whole_weights(arrays.weights), "u1"),
        )


def _whole_weights(weights: Float[np.ndarray, "V 4"]) -> Int[np.ndarray, "V 4"]:
    """Return weights as integers that add up to `WHOLE`: the largest takes what rounding leaves."""
    whole = np.round(WHOLE * weights).astype(int)
    rows = np.arange(len(whole))
    whole[rows, whole.argmax(axis=1)] += WHOLE - whole.sum(axis=1)
    return whole


def _packed(numbers: np.ndarray, kind: str) -> str:
    return base64.b64encode(numbers.astype(kind).tobytes()).decode("ascii")


def _unpacked(text: str, kind: str, columns: int) -> np.ndarray:
    """Return the rows of `columns` numbers that `_packed` wrote; ValueError if they are not whole."""
    try:
        content = base64.b64decode(text, validate=True)
    except binascii.Error as error:
        raise ValueError("an array is not base64") from error
    row_size = columns * np.dtype(kind).itemsize
    if not content or len(content) % row_size:
        raise ValueError("an array is truncated")
    return np.frombuffer(content, kind).reshape(-1, columns)
