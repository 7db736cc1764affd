"""The tables of a TOML file about a system whose physics is a MuJoCo model.

The file lies beside its model, or names its path, and is checked key by key:

    name = "hopper"
    model = "hopper.xml"

    [physics]
    step = 0.002

`neuroanimator new` writes such a file; every table but these may be left out.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from neuroanimator.definitions.follow import FollowTable
from neuroanimator.definitions.goal import GoalTable
from neuroanimator.definitions.parameter import Parameters
from neuroanimator.definitions.task import TaskTable
from neuroanimator.files.names import ModelPath, PartName, SystemName
from neuroanimator.files.tables import Finite, Share, Step, Table

Integrator = Literal["euler", "implicit", "implicitfast", "rk4"]
"""These are our names of MuJoCo's integrators."""

Feature = Literal["sine", "plain", "cyclic", "free", "placed", "ball", "planar"]
"""A joint is represented to the network by one of these; `systems.rigid.joints.FEATURES` says which suit it."""


class Physics(Table):
    """How the physics is stepped; see `System.scheme`, `truth` and `fine`."""

    step: Step
    integrator: Integrator = "implicitfast"
    truth_step: Step
    truth_integrator: Integrator = "implicitfast"
    fine_step: Step
    fine_integrator: Integrator = "implicitfast"


class FrameTable(Table):
    """How much of the root's position and orientation matters to the motion."""

    ground: bool = False
    """Whether its height matters."""
    probes: tuple[tuple[Finite, Finite, Finite, Finite], ...] = ()
    """Round parts of its body whose height over the ground matters: x, y, z, radius [m]."""
    contacts: bool = False
    """Whether the network is shown what may touch the ground, and which joints may reach their stops."""
    symmetries: bool = False
    """Whether training looks for mirrors and like limbs, and shows the network every example by them too."""
    symmetry_order: Annotated[int, Field(ge=1, le=64)] = 1
    """Order of the body's symmetry about its own Z axis: turned by a whole turn over this, it is as it was."""
    symmetry_controls: tuple[tuple[str, str], ...] = ()
    """Pairs of controls that turn with it, as X and Y do: torques about X and Y."""
    planar: Annotated[tuple[str, ...], Field(max_length=3)] = ()
    """Joints x, y and heading of a root that moves in a plane, where position and heading do not matter."""


Width = Annotated[float, Field(ge=0, le=1e4)]
"""Half the width of a uniform spread [rad or m], or a standard deviation."""

Spread = Width | tuple[Finite, Finite]
"""How random positions are spread: so far around rest, or from the first of two ends to the second."""


class Sampling(Table):
    """Random starts of training runs, around the state of rest."""

    rest_share: Share = 0.3
    """Share of starts that are near rest, where most motions begin."""
    rest_spread: Share = 0.15
    """Spread of such a start, as a share of the others'."""
    reset_share: Share = 0.0
    """Share of runs that begin at rest or at a keyframe as they are: neither driven before nor lifted."""
    reset_noise: Width = 0.0
    """Such a start is off by up to this in every position [rad or m]; in velocities it is their standard deviation."""
    warm_up: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Starts are taken from this first stretch of random driving [s], so that contacts have settled in most."""
    height: tuple[Finite, Finite] = (0.0, 0.0)
    """Lowest and highest start of a free root over its height at rest [m]."""
    tilt: Annotated[float, Field(ge=0, le=3.2)] = 0.0
    """Standard deviation of a free root's tilt [rad]."""
    above_ground: bool = False
    """Whether a start in which something lies in the ground is lifted out of it, by a free root or a vertical slide."""
    position: dict[str, Spread] = Field(default={})
    """Per hinge or slide: half the width of the uniform spread around rest, or its two ends [rad or m]; a ball's standard
    deviation [rad]; of a free joint whose place matters half the width along x and y [m]."""
    velocity: dict[str, tuple[Annotated[float, Field(ge=0, le=1e4)], ...]] = Field(default={})
    """Per joint: standard deviation of each of its velocities [rad/s or m/s]; a root's along its own axes."""


class Definition(Table):
    """A system whose physics is a MuJoCo model."""

    name: SystemName
    substeps: int = Field(50, ge=1, le=1000)
    """Physics steps n in a super step, if nothing else is asked for."""
    kind: Literal["mujoco"] = "mujoco"
    model: ModelPath
    """The model's file, beside this one or wherever it lies."""
    tree: ModelPath | None = None
    """The folder in which the model's includes and meshes may lie; if not given its own, or the ROS package it lies in."""
    base: Literal["fixed", "free"] = "fixed"
    """Whether the root of a URDF is fixed to the world or free to move over a floor; of no meaning to MJCF."""
    passive: tuple[str, ...] = ()
    """Joints of a URDF that no motor drives, though they have an effort."""
    keyframe: str = ""
    """The keyframe of the model that is the state of rest; if empty `home`, or the reference pose if there is none."""
    physics: Physics
    state: dict[str, Feature] = Field(default={})
    """Per joint, the feature that represents it to the network."""
    control: dict[str, tuple[Finite, Finite]] = Field(default={})
    """Per actuator, its least and largest value."""
    holding: dict[str, Finite] = Field(default={})
    """Per actuator, the control that holds the model at rest; 0 if not given. Where controls cease, they cease to this."""
    sensors: tuple[str, ...] = ()
    """Sensors that are emulated too."""
    frame: FrameTable = FrameTable()
    groups: dict[PartName, tuple[str, ...]] = Field(default={})
    """Per limb or other part of the body its joints, no joint twice; of a hierarchy's networks."""
    sampling: Sampling = Sampling()
    parameters: Parameters = Field(default={})
    """What varies from body to body of a family."""
    task: TaskTable | None = None
    """What a policy is to do; of no meaning to emulators."""
    follow: FollowTable | None = None
    """What motion it is to follow instead."""
    goals: dict[SystemName, GoalTable] = Field(default={})
