"""A soft body of MuJoCo's written down: a model with one flex, and what moves in it.

name = "jelly"
kind = "flex"
model = "jelly.xml"

[movers.paddle]
speed = [0.5, 0.5, 0.5]

All else is the model's: the flex, what holds it, and the geoms of the movers, which are its mocap bodies.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from neuroanimator.appearance.shapes import MAX_SHAPES
from neuroanimator.definitions.goal import GoalTable
from neuroanimator.definitions.soft import Extent, NotNegative, SoftPhysics
from neuroanimator.files.names import ModelPath, PartName, SystemName
from neuroanimator.files.tables import Positive, Table


class FlexPhysics(SoftPhysics):
    """The steps of the physics, and its contacts."""

    contact_time: NotNegative = 0.0
    """Time constant of contacts with movers, and of ties to them [s], MuJoCo's `solref`; if 0, what the model says.

    What a mover pushes trails it by about twice this, times its speed; what a tie pulls trails it too, by how much hangs
    on the masses.
    """


class FlexMoverTable(Table):
    """A mocap body. Its velocity is a control, and its turning rate."""

    speed: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    """Largest velocity along each axis [m/s]."""
    reach: Extent = (0.2, 0.2, 0.2)
    """Distance from rest it is moved to along each axis while the body's shapes are looked for [m]."""
    turns: bool = False
    """Whether it turns about the vertical, too."""
    turn_speed: Positive = 1.0
    """Largest turning rate [rad/s]."""
    turn_reach: NotNegative = 0.5
    """How far it is turned from rest while shapes are looked for [rad]."""


class FlexDefinition(Table):
    """A system whose physics is a MuJoCo model with a flex."""

    name: SystemName
    kind: Literal["flex"]
    model: ModelPath
    """The model's file, beside this one or wherever it lies."""
    tree: ModelPath | None = None
    """The folder in which the model's includes and meshes may lie; if not given its own, or the ROS package it lies in."""
    substeps: int = Field(16, ge=1, le=1000)
    """Physics steps n in a super step, if nothing else is asked for."""
    shapes: int = Field(64, ge=1, le=MAX_SHAPES)
    """Number of shapes that make up the state."""
    contact_nodes: int = Field(96, ge=1, le=256)
    """Number of nodes whose contacts an emulator is shown."""
    physics: FlexPhysics
    movers: dict[PartName, FlexMoverTable] = Field(min_length=1, max_length=8)
    """By the names of the mocap bodies; in a state they come in the order of their names."""
    goals: dict[SystemName, GoalTable] = Field(default={})

    @field_validator("movers")
    @classmethod
    def _in_order(cls, movers: dict[str, FlexMoverTable]) -> dict[str, FlexMoverTable]:
        return dict(sorted(movers.items()))
