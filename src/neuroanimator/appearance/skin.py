"""What a deformable body looks like, as its definition says it: the `[skin]` table.

    [skin]
    kind = "swimmer"
    back = [0.2, 0.3, 0.4]
    belly = [0.9, 0.9, 0.9]
    sections = [[0, 0, 0, 0], [-0.1, 0.02, 0.03, -0.03], [-0.2, 0, 0, 0]]

An emulator carries this table and not its triangles: `skin_mesh` makes them, wherever the skin is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from neuroanimator.tables import Share, Table

Colour = tuple[Share, Share, Share]
"""Red, green, blue."""
Length = Annotated[float, Field(ge=-1e3, le=1e3, allow_inf_nan=False)]
"""[m]"""
Size = Annotated[float, Field(ge=0, le=1e3, allow_inf_nan=False)]
"""[m]"""

MAX_SECTIONS, MAX_FINS = 40, 12
"""A skin may come from a stranger, and its triangles grow with these."""


class Fin(Table):
    """A thin blade: fin, fluke or flipper."""

    edge: tuple[tuple[Length, Length, Length, Size], ...] = Field(
        min_length=2, max_length=MAX_SECTIONS
    )
    """From one end of the blade to the other: x, y, z of its leading edge, and how far it reaches behind it."""
    thickness: Annotated[float, Field(gt=0, le=1)] = 0.12
    """Over how far it reaches behind its edge."""
    both: bool = False
    """Whether there is another one, mirrored, on the right."""


class Swimmer(Table):
    """A smooth body around a spine along X, and its fins, which bend with the mass points along it."""

    kind: Literal["swimmer"]
    back: Colour
    belly: Colour
    fin: Colour | None = None
    """Of the fins; the back's if not given."""
    sections: tuple[tuple[Length, Size, Length, Length], ...] = Field(
        min_length=3, max_length=MAX_SECTIONS
    )
    """From nose to tail: x, half the width, top and bottom; one without any size ends in a rounded tip."""
    fins: tuple[Fin, ...] = Field((), max_length=MAX_FINS)
    eye: tuple[Length, Length, Length, Size] | None = None
    """Of the left eye: place and radius."""

    def fits(self, bones: Sequence[Sequence[float]]) -> bool:
        """Return whether this skin can be bound to bones at these places."""
        return len({position[0] for position in bones}) > 1


class Box(Table):
    """A box with rounded edges that goes with the mass points at its eight corners."""

    kind: Literal["box"]
    face: Colour
    rim: Colour | None = None
    """Of the edges; the faces' if not given."""
    margin: Size = 0.0
    """How far the skin lies outside the corners' mass points."""
    rounding: Annotated[float, Field(gt=0, le=1)] = 0.25
    """Radius of the edges, over half the shortest side."""

    def fits(self, bones: Sequence[Sequence[float]]) -> bool:
        """Return whether this skin can be bound to bones at these places."""
        return len(bones) == 8 and all(len({*along}) > 1 for along in zip(*bones, strict=True))


Skin = Swimmer | Box
SkinTable = Annotated[Skin, Field(discriminator="kind")]
_SKIN: TypeAdapter[Skin] = TypeAdapter(SkinTable)


def skin_to_json(skin: Skin) -> dict[str, Any]:
    """Return the table as plain lists and numbers."""
    return skin.model_dump(mode="json")


def skin_from_json(row: Any) -> Skin:
    """Return the skin `skin_to_json` wrote; ValueError names what is wrong with it."""
    return _SKIN.validate_python(row)
