"""The skins of bodies. That of a deformable body is the `[skin]` table of its definition:

    [skin]
    kind = "swimmer"
    back = [0.2, 0.3, 0.4]
    belly = [0.9, 0.9, 0.9]
    sections = [[0, 0, 0, 0], [-0.1, 0.02, 0.03, -0.03], [-0.2, 0, 0, 0]]

An emulator carries this table and not its triangles: `skin_mesh` makes them when the skin is drawn. The skin of a
MuJoCo model consists of triangles from the start: see `MeshSkin`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from neuroanimator.appearance.mesh_skin import Coordinate, MeshSkin
from neuroanimator.files.tables import Share, Table

Colour = tuple[Share, Share, Share]
"""Red, green and blue, each 0 to 1."""

Size = Annotated[float, Field(ge=0, le=1e3, allow_inf_nan=False)]
"""A length of 0 or more [m]."""

MAX_SECTIONS = 40
"""Maximum number of sections of a body or a fin: a skin may come from a stranger, and its triangles grow with them."""

MAX_FINS = 12
"""Maximum number of fins of a body, for the same reason."""

BOX_CORNERS = 8
"""Number of bones a box is bound to, one at every corner."""


class Fin(Table):
    """A thin blade: fin, fluke or flipper."""

    edge: tuple[tuple[Coordinate, Coordinate, Coordinate, Size], ...] = Field(
        min_length=2, max_length=MAX_SECTIONS
    )
    """From one end of the blade to the other: x, y, z of its leading edge, and its chord behind it."""
    thickness: Annotated[float, Field(gt=0, le=1)] = 0.12
    """Thickness over chord."""
    both: bool = False
    """Whether there is another one, mirrored, on the right."""


class Swimmer(Table):
    """A smooth body around a spine along X, and its fins, which bend with the mass points along it."""

    kind: Literal["swimmer"]
    back: Colour
    belly: Colour
    fin: Colour | None = None
    """Colour of the fins; that of the back if not given."""
    sections: tuple[tuple[Coordinate, Size, Coordinate, Coordinate], ...] = Field(
        min_length=3, max_length=MAX_SECTIONS
    )
    """From nose to tail: x, half the width, top and bottom; a section of zero size ends in a rounded tip."""
    fins: tuple[Fin, ...] = Field((), max_length=MAX_FINS)
    eye: tuple[Coordinate, Coordinate, Coordinate, Size] | None = None
    """Position and radius of the left eye; the right one is its mirror image."""

    def fits(self, bone_positions: Sequence[Sequence[float]]) -> bool:
        """Return whether this skin can be bound to bones at these positions [m]: not all at one X."""
        along_x = {position[0] for position in bone_positions}
        return len(along_x) > 1


class Box(Table):
    """A box with rounded edges that follows the mass points at its eight corners."""

    kind: Literal["box"]
    face: Colour
    rim: Colour | None = None
    """Colour of the edges; that of the faces if not given."""
    margin: Size = 0.0
    """Distance of the skin outside the corners' mass points."""
    rounding: Annotated[float, Field(gt=0, le=1)] = 0.25
    """Radius of the edges, over half the shortest side."""

    def fits(self, bone_positions: Sequence[Sequence[float]]) -> bool:
        """Return whether this skin can be bound to bones at these positions [m]: eight, with some extent along each axis."""
        if len(bone_positions) != BOX_CORNERS:
            return False
        return all(len(set(along)) > 1 for along in zip(*bone_positions, strict=True))


SkinTable = Annotated[Swimmer | Box, Field(discriminator="kind")]
"""The skin of a deformable body as a field of a table: its `kind` says which."""

Skin = Swimmer | Box | MeshSkin
"""Kinds of skins."""
