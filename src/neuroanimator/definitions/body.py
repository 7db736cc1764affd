"""A deformable system written down: mass points, springs, muscles and faces by name.

    name = "jelly"
    kind = "mass-spring"

    [nodes]
    a = [0.0, 0.0, 0.1, 0.02]            # position [m] and mass [kg]

    [springs.edges]
    stiffness = 50.0                     # [N/m]
    damping = 0.2                        # [N·s/m]
    pairs = [["a", "b"], ["b", "c"]]

`systems/assets/fish.toml` shows every table.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from neuroanimator.appearance.skin import SkinTable
from neuroanimator.definitions.parts import (
    BodySampling,
    GaitTable,
    GoalTable,
    NotNegative,
    Parameters,
    WaterTable,
)
from neuroanimator.files.names import PartName, SystemName
from neuroanimator.files.tables import Finite, Positive, Step, Table

Integrator = Literal["symplectic", "semi-implicit", "rk4"]
"""Names of the integrators of deformable systems."""

Pair = tuple[PartName, PartName]
"""Two nodes joined by a spring."""

MAX_NODES = 300
"""Maximum number of mass points: a definition may come from a stranger, and costs grow with them."""

MAX_SPRINGS = 3000
"""Maximum number of springs, for the same reason."""


class BodyPhysics(Table):
    """How the physics is stepped; see `System.scheme`, `truth` and `fine`."""

    step: Step
    integrator: Integrator = "symplectic"
    truth_step: Step
    truth_integrator: Integrator = "rk4"
    fine_step: Step
    fine_integrator: Integrator = "rk4"


class SpringTable(Table):
    """Springs of one kind."""

    stiffness: Positive
    damping: NotNegative
    pairs: tuple[Pair, ...] = Field(min_length=1, max_length=MAX_SPRINGS)


class MuscleTable(Table):
    """Springs that shorten on command; every control is one muscle from -1, longest, to 1, shortest."""

    shorten: Annotated[float, Field(gt=0, lt=0.9)]
    """Share of its length by which a muscle shortens or lengthens at full control."""
    time_constant: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Time constant with which a muscle follows its control [s]."""
    springs: dict[PartName, tuple[Pair, ...]] = Field(min_length=1, max_length=100)
    """Springs that each control shortens."""


class GroundTable(Table):
    """Ground under the body; `physics.deformable.body.Ground` explains the keys."""

    stiffness: Positive
    damping: NotNegative = 0.0
    friction: NotNegative = 0.5
    slip: Positive = 0.05


class BodyDefinition(Table):
    """A system whose physics is a mass-spring body."""

    name: SystemName
    kind: Literal["mass-spring"]
    substeps: int = Field(50, ge=1, le=1000)
    physics: BodyPhysics
    nodes: dict[PartName, tuple[Finite, Finite, Finite, Finite]] = Field(min_length=2)
    """Position at rest [m] and mass [kg] of each mass point; X forward, Z up."""
    rest_height: Finite = 0.0
    """Height added to every node in the state of rest [m]: a swimmer rests below the surface."""
    springs: dict[PartName, SpringTable] = Field(min_length=1, max_length=50)
    muscles: MuscleTable | None = None
    external_forces: dict[PartName, tuple[Finite, Finite, Finite]] = Field(default={})
    """Force on the whole body at control 1 [N], for each control of a body without muscles."""
    faces: tuple[Annotated[tuple[PartName, ...], Field(min_length=3, max_length=4)], ...] = ()
    """Corners of the skin's faces that push water, counterclockwise seen from outside."""
    mirror: dict[PartName, PartName] = Field(default={})
    """Partner on the right of each mass point or control on the left, if the body is mirror-symmetric."""
    groups: dict[PartName, tuple[PartName, ...]] = Field(default={})
    """Segments of the body, each a list of mass points; every mass point belongs to exactly one."""
    water: WaterTable | None = None
    ground: GroundTable | None = None
    probes: Annotated[tuple[tuple[Finite, Finite, Finite], ...], Field(max_length=32)] = ()
    """Positions as in `nodes` [m] whose height above the ground or the water's surface is a feature of an emulator."""
    gait: GaitTable | None = None
    skin: SkinTable | None = None
    """The surface to draw; without it, a ball at every mass point."""
    sampling: BodySampling = BodySampling()
    parameters: Parameters = Field(default={})
    """Parameters that vary between bodies, and what each sets: `physics.deformable.body_parameters` lists the targets."""
    goals: dict[SystemName, GoalTable] = Field(default={})


def control_names(definition: BodyDefinition) -> list[str]:
    """Return the names of the controls in order."""
    if definition.muscles:
        return list(definition.muscles.springs)
    return list(definition.external_forces)
