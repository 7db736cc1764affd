"""A cloth written down: its mesh, its material, what moves and holds it, and what strikes it.

name = "flag"
kind = "soft"
mesh = "flag.obj"

[movers.pole]
position = [0.0, 0.0, 1.0]
pins = [0, 1, 2]

[movers.ball]
position = [0.0, 0.6, 0.5]
colliders = [{ radius = 0.15 }]
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from neuroanimator.appearance.shapes import MAX_NODES, MAX_SHAPES
from neuroanimator.definitions.goal import GoalTable
from neuroanimator.files.names import FileName, PartName, SystemName
from neuroanimator.files.tables import Finite, Positive, Step, Table

Vector = tuple[Finite, Finite, Finite]

NotNegative = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
"""A number that may be zero, for a thing without the effect it measures."""

Extent = tuple[NotNegative, NotNegative, NotNegative]


class SoftPhysics(Table):
    """The small steps of the physics; see `System.scheme`, `truth` and `fine`."""

    step: Step
    truth_step: Step
    fine_step: Step


class ClothTable(Table):
    """The material; `systems.soft.meshes.Cloth` explains the keys."""

    density: Positive = 0.2
    stretch: Positive = 20.0
    bend: Positive = 0.5
    damping: NotNegative = 2e-3
    thickness: NotNegative = 0.01
    """[m]"""


class AirTable(Table):
    """Air around the cloth; `systems.soft.soft_body.Air` explains the keys."""

    drag: NotNegative = 0.5
    density: NotNegative = 1.2
    wind: Vector = (0.0, 0.0, 0.0)


class ColliderTable(Table):
    """A sphere; with an end, a capsule."""

    radius: Positive
    """[m]"""
    start: Vector = (0.0, 0.0, 0.0)
    """Centre of the sphere, or of the capsule's first end, from its mover's position [m]."""
    end: Vector | None = None
    """Centre of the capsule's other end [m]."""
    friction: NotNegative = 0.3


class MoverTable(Table):
    """A thing that is moved from outside: it holds nodes, or strikes them. Its velocity is a control."""

    position: Vector
    """Position at rest [m]."""
    speed: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    """Largest velocity along each axis [m/s]."""
    reach: Extent = (0.2, 0.2, 0.2)
    """Distance from rest it is moved to along each axis while the cloth's shapes are looked for [m]."""
    pins: Annotated[tuple[int, ...], Field(max_length=MAX_NODES)] = ()
    """Nodes that go with it, numbered from 0 in the mesh's order."""
    colliders: Annotated[tuple[ColliderTable, ...], Field(max_length=8)] = ()


class GroundTable(Table):
    """A horizontal plane the cloth does not pass."""

    height: Finite = 0.0
    """[m]"""
    friction: NotNegative = 0.4


class SoftDefinition(Table):
    """A system whose physics is a cloth's."""

    name: SystemName
    kind: Literal["soft"]
    mesh: FileName
    """OBJ file of the cloth at rest, beside this file [m]."""
    substeps: int = Field(40, ge=1, le=1000)
    """Small steps n in a super step, if nothing else is asked for."""
    shapes: int = Field(96, ge=1, le=MAX_SHAPES)
    """Number of shapes that make up the state."""
    physics: SoftPhysics
    cloth: ClothTable = ClothTable()
    air: AirTable = AirTable()
    ground: GroundTable | None = None
    movers: dict[PartName, MoverTable] = Field(min_length=1, max_length=8)
    """By name; in a state they come in the order of their names."""
    goals: dict[SystemName, GoalTable] = Field(default={})

    @field_validator("movers")
    @classmethod
    def _in_order(cls, movers: dict[str, MoverTable]) -> dict[str, MoverTable]:
        return dict(sorted(movers.items()))
