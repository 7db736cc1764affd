"""A soft body of MuJoCo's written down: a model with one flex, and its movers.

name = "jelly"
kind = "flex"
model = "jelly.xml"

[movers.paddle]
speed = [0.5, 0.5, 0.5]

Everything else is in the model: the flex, what holds it, and the geoms of the movers, which are its mocap bodies.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from neuroanimator.appearance.shapes import MAX_SHAPES
from neuroanimator.definitions.parts import GoalTable
from neuroanimator.definitions.soft import MotionTable, NotNegative, SoftPhysics
from neuroanimator.files.names import ModelPath, PartName, SystemName
from neuroanimator.files.tables import Table


class FlexPhysics(SoftPhysics):
    """The physics steps and contacts."""

    contact_time: NotNegative = 0.0
    """Time constant of contacts with movers, and of ties to them [s], MuJoCo's `solref`; if 0, the model's own.

    What a mover pushes trails it by about twice this, times its speed; what a tie pulls trails it too, by an amount that
    depends on the masses.
    """


class FlexDefinition(Table):
    """A system whose physics is a MuJoCo model with a flex."""

    name: SystemName
    kind: Literal["flex"]
    model: ModelPath
    """The model's file, beside this one or elsewhere."""
    tree: ModelPath | None = None
    """Folder that may hold the model's includes and meshes; by default the model's own, or the ROS package it is in."""
    substeps: int = Field(16, ge=1, le=1000)
    """Default number n of physics steps in a super step."""
    shapes: int = Field(64, ge=1, le=MAX_SHAPES)
    """Number of shapes that make up the state."""
    contact_nodes: int = Field(96, ge=1, le=256)
    """Number of nodes whose contacts are features of an emulator."""
    physics: FlexPhysics
    movers: dict[PartName, MotionTable] = Field(min_length=1, max_length=8)
    """Movers by the names of their mocap bodies; in a state they are sorted by name."""
    goals: dict[SystemName, GoalTable] = Field(default={})

    @field_validator("movers")
    @classmethod
    def _in_order(cls, movers: dict[str, MotionTable]) -> dict[str, MotionTable]:
        return dict(sorted(movers.items()))
