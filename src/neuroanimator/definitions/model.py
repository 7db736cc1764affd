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
from neuroanimator.definitions.parts import GoalTable, Parameters
from neuroanimator.definitions.task import TaskTable
from neuroanimator.files.names import ModelPath, PartName, SystemName
from neuroanimator.files.tables import Finite, Share, Step, Table

Integrator = Literal["euler", "implicit", "implicitfast", "rk4", "discrete"]
"""MuJoCo's names of its integrators, in small letters."""

Feature = Literal["sine", "plain", "cyclic", "free", "placed", "ball", "planar"]
"""How a joint is represented to the network; `physics.rigid.joints.FEATURES` lists which suit it."""


class Physics(Table):
    """How the physics is stepped; see `System.scheme`, `truth` and `fine`."""

    step: Step
    integrator: Integrator = "implicitfast"
    truth_step: Step
    truth_integrator: Integrator = "implicitfast"
    fine_step: Step
    fine_integrator: Integrator = "implicitfast"


class FrameTable(Table):
    """The part of the root's position and orientation that matters to the motion."""

    ground: bool = False
    """Whether the root's height matters."""
    probes: tuple[tuple[Finite, Finite, Finite, Finite], ...] = ()
    """Round parts of its body whose height above the ground matters: x, y, z, radius [m]."""
    contacts: bool = False
    """Whether the network gets features of possible contacts with the ground, and of joints near their stops."""
    symmetries: bool = False
    """Whether training looks for mirror symmetries and equal limbs, and adds every example transformed by them."""
    symmetry_order: Annotated[int, Field(ge=1, le=64)] = 1
    """Order of the body's rotational symmetry about its own Z axis: a turn by 2π over this leaves it unchanged."""
    symmetry_controls: tuple[tuple[str, str], ...] = ()
    """Pairs of controls that rotate with it as X and Y do, such as torques about X and Y."""
    planar: Annotated[tuple[str, ...], Field(max_length=3)] = ()
    """Joints x, y and heading of a root that moves in a plane, where position and heading do not matter."""


Width = Annotated[float, Field(ge=0, le=1e4)]
"""Half the width of a uniform spread [rad or m], or a standard deviation."""

Spread = Width | tuple[Finite, Finite]
"""Spread of random positions: half its width around rest, or its two ends."""


class Sampling(Table):
    """Random starts of training runs, around the state of rest."""

    rest_share: Share = 0.3
    """Share of starts near rest, as most motions begin."""
    rest_spread: Share = 0.15
    """Spread of starts near rest, as a share of the others'."""
    reset_share: Share = 0.0
    """Share of runs that begin at rest or at a keyframe, neither driven before nor lifted."""
    reset_noise: Width = 0.0
    """Maximum deviation of such a start in every position [rad or m], and standard deviation of its velocities."""
    warm_up: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Duration of random driving from which starts are taken [s], so that contacts have settled in most."""
    height: tuple[Finite, Finite] = (0.0, 0.0)
    """Minimum and maximum height of a free root's start above its height at rest [m]."""
    tilt: Annotated[float, Field(ge=0, le=3.2)] = 0.0
    """Standard deviation of a free root's tilt [rad]."""
    above_ground: bool = False
    """Whether a start with something below the ground is lifted out of it, by a free root or a vertical slide."""
    position: dict[str, Spread] = Field(default={})
    """Per hinge or slide: half the width of the uniform spread around rest, or its two ends [rad or m]; per ball the
    standard deviation [rad]; per free joint whose position matters half the width along x and y [m]."""
    velocity: dict[str, tuple[Annotated[float, Field(ge=0, le=1e4)], ...]] = Field(default={})
    """Per joint: standard deviation of each of its velocities [rad/s or m/s]; for a root, along its own axes."""


class Definition(Table):
    """A system whose physics is a MuJoCo model."""

    name: SystemName
    substeps: int = Field(50, ge=1, le=1000)
    """Default number n of physics steps in a super step."""
    kind: Literal["mujoco"] = "mujoco"
    model: ModelPath
    """The model's file, beside this one or elsewhere."""
    tree: ModelPath | None = None
    """Folder that may hold the model's includes and meshes; by default the model's own, or the ROS package it is in."""
    base: Literal["fixed", "free"] = "fixed"
    """Whether the root of a URDF is fixed to the world or free to move over a floor; no effect on MJCF."""
    passive: tuple[str, ...] = ()
    """Joints of a URDF without a motor, though they have an effort."""
    keyframe: str = ""
    """Keyframe of the model that is the state of rest; if empty `home`, or the reference pose if there is none."""
    physics: Physics
    state: dict[str, Feature] = Field(default={})
    """Per joint, the feature that represents it to the network."""
    control: dict[str, tuple[Finite, Finite]] = Field(default={})
    """Minimum and maximum value of each actuator."""
    holding: dict[str, Finite] = Field(default={})
    """Per actuator, the control that holds the model at rest; 0 by default. Controls that cease return to it."""
    sensors: tuple[str, ...] = ()
    """Sensors to emulate, too."""
    frame: FrameTable = FrameTable()
    groups: dict[PartName, tuple[str, ...]] = Field(default={})
    """Joints of each limb or other part of the body, no joint twice; for hierarchy networks."""
    sampling: Sampling = Sampling()
    parameters: Parameters = Field(default={})
    """Parameters that vary between the bodies of a family."""
    task: TaskTable | None = None
    """Task of a policy; no effect on emulators."""
    follow: FollowTable | None = None
    """Motion that it is to follow instead."""
    goals: dict[SystemName, GoalTable] = Field(default={})
