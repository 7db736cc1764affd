"""A soft body written down: its mesh, its material, and the movers that hold or strike it.

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

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from neuroanimator.appearance.shapes import MAX_NODES, MAX_SHAPES
from neuroanimator.definitions.parts import (
    BodySampling,
    GaitTable,
    GoalTable,
    Parameters,
    WaterTable,
)
from neuroanimator.files.names import FileName, PartName, SystemName
from neuroanimator.files.tables import Finite, Positive, Step, Table
from neuroanimator.state.mover_poses import FREELY, Turns

Vector = tuple[Finite, Finite, Finite]

NotNegative = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
"""A number that may be zero, for the absence of the effect it measures."""

Extent = tuple[NotNegative, NotNegative, NotNegative]


SOLID_ENDING = ".msh"
"""Suffix of the files of tetrahedral meshes."""

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
"""Units of length of a mesh [m]."""


MAX_MOVERS = 24
"""Maximum number of movers."""

MAX_MUSCLES = 64
"""Maximum number of muscles."""


class MeshReading(Table):
    """How the mesh in a file is meant."""

    unit: Literal["mm", "cm", "m", "in"] = "m"
    """Unit of its numbers."""
    up: Literal["y", "z"] = "z"
    """Axis that points up."""
    keep: Literal["all", "largest"] = "all"
    """Whether all pieces are of the body, or only the largest."""


class SoftPhysics(Table):
    """The small steps of the physics; see `System.scheme`, `truth` and `fine`."""

    step: Step
    truth_step: Step
    fine_step: Step


class ClothTable(Table):
    """The material of a surface."""

    density: Positive = 0.2
    """Density [kg/m²]."""
    stretch: Positive = 20.0
    """Young's modulus times thickness [N/m]."""
    bend: Positive = 0.5
    """Stiffness of the springs across folds [N/m], which resist sharp folds, but hardly slight ones."""
    damping: NotNegative = 2e-3
    """Time constant of internal friction [s]: damping of a spring over its stiffness."""
    thickness: NotNegative = 0.01
    """Thickness [m]."""


Stiffness = Annotated[float, Field(gt=0, le=1e12, allow_inf_nan=False)]
"""A modulus of elasticity [Pa]."""


class SolidTable(Table):
    """The material of a body of tetrahedra."""

    density: Positive = 1000.0
    """Density [kg/m³]."""
    stretch: Stiffness = 2e4
    """Young's modulus [Pa]."""
    bulk: Stiffness = 2e5
    """Bulk modulus [Pa]."""
    damping: NotNegative = 2e-3
    """Time constant of internal friction [s]: damping of a spring over its stiffness."""
    margin: NotNegative = 0.0
    """Distance at which nodes touch colliders [m]."""


class AirTable(Table):
    """Air around the body; `physics.soft.soft_body.Air` explains the keys."""

    drag: NotNegative = 0.5
    density: NotNegative = 1.2
    wind: Vector = (0.0, 0.0, 0.0)


class ColliderTable(Table):
    """A sphere; with an end, a capsule; with half sizes, a box."""

    radius: Positive | None = None
    """Radius of a sphere or capsule [m]."""
    box: tuple[Positive, Positive, Positive] | None = None
    """Half the size of a box along each axis of its mover [m]."""
    start: Vector = (0.0, 0.0, 0.0)
    """Centre of the sphere, of the box, or of the capsule's first end, from its mover's position [m]."""
    end: Vector | None = None
    """Centre of the capsule's other end [m]."""
    friction: NotNegative = 0.3

    @model_validator(mode="after")
    def _is_one(self) -> ColliderTable:
        if (self.radius is None) == (self.box is None):
            raise ValueError("wanted a radius, or a box")
        if self.box is not None and self.end is not None:
            raise ValueError("wanted no end of a box")
        return self


class MotionTable(Table):
    """How far and how fast a mover moves; its velocity and turning rate are controls."""

    speed: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    """Largest velocity along each axis [m/s]."""
    reach: Extent = (0.2, 0.2, 0.2)
    """Distance from rest along each axis to which it is moved in the search for shapes [m]."""
    turns: Turns = False
    """Whether it also turns, with everything it holds: `true` about the vertical, `"freely"` as a bone does."""
    turn_speed: Positive | tuple[Positive, Positive, Positive] = 1.0
    """Largest turning rate [rad/s]; for a mover that turns freely also one about each of its own axes."""
    turn_reach: NotNegative | Extent = 0.5
    """Angle from rest to which it is turned in the search for shapes [rad]; as `turn_speed`."""

    @model_validator(mode="after")
    def _turns_as_it_may(self) -> MotionTable:
        if self.turns != FREELY and tuple in (type(self.turn_speed), type(self.turn_reach)):
            raise ValueError('turn_speed and turn_reach: three numbers are for turns = "freely"')
        return self


class MoverTable(MotionTable):
    """A thing moved from outside that holds nodes or strikes them."""

    position: Vector
    """Position at rest [m]."""
    pins: Annotated[tuple[int, ...], Field(max_length=MAX_NODES)] = ()
    """Nodes that move with it, numbered from 0 in the mesh's order."""
    colliders: Annotated[tuple[ColliderTable, ...], Field(max_length=16)] = ()


class SolidMusclesTable(Table):
    """Muscles of a solid: groups of its tetrahedra that shorten on command; every control is one from 0 to 1, shortest."""

    shorten: Annotated[float, Field(gt=0, lt=0.9)] = 0.3
    """Share of its length by which a muscle shortens at full control."""
    time_constant: Annotated[float, Field(ge=0, le=10)] = 0.05
    """Time constant with which a muscle follows its control [s]."""
    along: Annotated[dict[PartName, Vector], Field(min_length=1, max_length=MAX_MUSCLES)]
    """Direction of the mesh along which each group of tetrahedra shortens, by the group's name; controls are sorted by it."""

    @field_validator("along")
    @classmethod
    def _directed_in_order(cls, along: dict[str, Vector]) -> dict[str, Vector]:
        for name, direction in along.items():
            if not any(direction):
                raise ValueError(
                    f"{name} has a direction of no length; wanted for instance [1, 0, 0]"
                )
        return dict(sorted(along.items()))


class GroundPlaneTable(Table):
    """A horizontal plane that the body does not pass."""

    height: Finite = 0.0
    """Height of the plane [m]."""
    friction: NotNegative = 0.4


LATER_KEYS = (
    *MeshReading.model_fields,
    "motions",
    *("parameters", "muscles", "water", "rest_height", "gait", "sampling"),
)
"""Keys that definitions did not have at first."""


class SoftDefinition(MeshReading):
    """A system whose physics is a cloth or a soft solid."""

    name: SystemName
    kind: Literal["soft"]
    mesh: FileName
    """OBJ file of a cloth at rest, or Gmsh file of a solid, beside this file."""
    substeps: int = Field(40, ge=1, le=1000)
    """Default number n of small steps in a super step."""
    shapes: int = Field(96, ge=1, le=MAX_SHAPES)
    """Number of shapes that make up the state."""
    contact_nodes: int = Field(96, ge=1, le=256)
    """Number of nodes whose contacts are features of an emulator."""
    physics: SoftPhysics
    cloth: ClothTable = ClothTable()
    solid: SolidTable = SolidTable()
    air: AirTable = AirTable()
    ground: GroundPlaneTable | None = None
    movers: dict[PartName, MoverTable] = Field(default={}, max_length=MAX_MOVERS)
    """Movers by name; in a state they are sorted by name."""
    motions: FileName | None = None
    """GLB file of a character beside this file: movers called as its nodes follow its first animation in random runs."""
    muscles: SolidMusclesTable | None = None
    water: WaterTable | None = None
    """Water instead of air."""
    rest_height: Finite = 0.0
    """Height added to the mesh in the state of rest [m]: a swimmer rests below the surface."""
    gait: GaitTable | None = None
    sampling: BodySampling = BodySampling()
    parameters: Parameters = Field(default={})
    """Parameters that vary between runs, and what each sets: `air/wind_x`, `air/wind_y` or `air/wind_z` [m/s]."""
    goals: dict[SystemName, GoalTable] = Field(default={})

    @property
    def is_solid(self) -> bool:
        """Whether the mesh is tetrahedral."""
        return self.mesh.endswith(SOLID_ENDING)

    def travelling(self) -> dict[str, Any]:
        """Return the definition as JSON values, without later keys that say nothing: as before they existed."""
        values = self.model_dump(mode="json")
        later = {key: type(self).model_fields[key].get_default() for key in LATER_KEYS}
        return {
            key: value
            for key, value in values.items()
            if key not in later or getattr(self, key) != later[key]
        }

    @property
    def margin(self) -> float:
        """Distance at which nodes touch colliders [m]."""
        return self.solid.margin if self.is_solid else self.cloth.thickness / 2

    @field_validator("movers")
    @classmethod
    def _in_order(cls, movers: dict[str, MoverTable]) -> dict[str, MoverTable]:
        return dict(sorted(movers.items()))
