"""The planar three-link pendulum of the 1998 paper, passive and with motors."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from neuroanimator.physics.rigid.bones import skeleton_of
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem, load_model
from neuroanimator.state.layout import Bounds, Layout, Slice
from neuroanimator.state.structure import Structure
from neuroanimator.systems.goal import Goal
from neuroanimator.systems.system import Scheme

STATE = Layout((Slice("angle", 3, "rad"), Slice("velocity", 3, "rad/s")))
"""State of the pendulum: the angle of each link relative to the one above, and its rate of change."""

MOTOR_TORQUE = (30.0, 14.0, 4.0)
"""Largest torques of the motors [N·m], about 1.4 times those that hold the arm level (22.1, 9.8, 2.5): the arm can lift
itself, slowly."""

MOTOR_DAMPING = (1.5, 0.75, 0.2)
"""Damping by motors [N·m·s/rad], of friction and back-EMF: the largest torque over it is a motor's no-load speed, 20
rad/s."""

BEARING_DAMPING = (0.15, 0.075, 0.02)
"""Damping by bearings alone [N·m·s/rad], a tenth of the above: the passive arm swings for many seconds."""

PUSH_FORCE = (10.0, 10.0, 10.0)
"""Largest external forces [N], horizontal and at the middle of each link: about a link's own weight, a firm shove."""

START_VELOCITY = (2.0, 3.0, 4.0)
"""Standard deviation of the joints' velocities at random starts [rad/s]; free fall reaches two to three times it."""

REST_SHARE = 0.3
"""Share of random starts near hanging and nearly at rest, where most motions begin."""

REST_SPREAD = 0.15
"""Angles and velocities of a start near rest, as a share of the random ones."""

ANGLES = (
    (1, 0, 0, 0, 0, 0),
    (1, 1, 0, 0, 0, 0),
    (1, 1, 1, 0, 0, 0),
    (0, 1, 0, 0, 0, 0),
    (0, 0, 1, 0, 0, 0),
    (0, 1, 1, 0, 0, 0),
)
"""Angles of the links as sums of state entries: first against the vertical, on which gravity acts, then against each
other, on which inertia depends."""


UPRIGHT_ANGLE_ERROR = 0.1
"""Angle error that counts as 1 in a cost [rad]: about half of the 10° that still count as upright."""

UPRIGHT_VELOCITY_ERROR = 0.5
"""Velocity error that counts as 1 in a cost [rad/s]: half of what still counts as at rest."""

UPRIGHT_WITHIN = math.radians(10.0)
"""Largest lean of a link that counts as upright [rad]."""

STILL_WITHIN = 1.0
"""Largest turn rate of a link that counts as still [rad/s]."""

SWING_UP_SECONDS = 1.5
"""Duration of a swing-up [s], that of a quick human arm; the motors could do it in one second."""

UPRIGHT = Goal(
    values=((0, math.pi), (1, 0.0), (2, 0.0), (3, 0.0), (4, 0.0), (5, 0.0)),
    tolerances=(UPRIGHT_WITHIN,) * 3 + (STILL_WITHIN,) * 3,
    seconds=SWING_UP_SECONDS,
    sums=(
        (1, 0, 0, 0, 0, 0),
        (1, 1, 0, 0, 0, 0),
        (1, 1, 1, 0, 0, 0),
        (0, 0, 0, 1, 0, 0),
        (0, 0, 0, 1, 1, 0),
        (0, 0, 0, 1, 1, 1),
    ),
    scales=(UPRIGHT_ANGLE_ERROR,) * 3 + (UPRIGHT_VELOCITY_ERROR,) * 3,
)
"""Goal with all three links up and still: angles and velocities against the vertical, not against the link above."""


class Pendulum(MujocoSystem):
    """An arm of three links and hinges: angles [rad] relative to the link above, zero when hanging, and their velocities."""

    state = STATE
    scheme = Scheme("euler", 0.001)
    truth = Scheme("rk4", 0.005)
    fine = Scheme("rk4", 0.0001)
    rest = np.zeros(6)
    structure = Structure(ANGLES, rates=((0, 3), (1, 4), (2, 5)), plain=(3, 4, 5), is_odd=True)

    def __init__(
        self, name: str, control: Layout, limit: tuple[float, ...], damping: tuple[float, ...]
    ):
        self.name = name
        self.control = control
        self.bounds = Bounds.symmetric(limit)
        self.model = load_model(f"{name}.xml")
        self.model.dof_damping[:] = damping
        self.skeleton = skeleton_of(self.model)
        if control.slices[0].unit == "N":
            self.is_pushed = True
            self.external_forces = (("upper", 0), ("middle", 0), ("lower", 0))

    def sample_starts(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, "B 6"]:
        angles = rng.uniform(-np.pi, np.pi, (count, 3))
        velocities = rng.normal(size=(count, 3)) * START_VELOCITY
        is_near_rest = rng.random(count) < REST_SHARE
        spread = np.where(is_near_rest, REST_SPREAD, 1.0)
        return np.concatenate([angles, velocities], axis=1) * spread[:, None]


def active_pendulum() -> Pendulum:
    """Return the arm with a torque motor at each joint."""
    control = Layout((Slice("torque", 3, "N·m"),))
    pendulum = Pendulum("pendulum", control, MOTOR_TORQUE, MOTOR_DAMPING)
    pendulum.goals = {"upright": UPRIGHT}
    return pendulum


def passive_pendulum() -> Pendulum:
    """Return the arm without motors, whose controls are horizontal forces on its links."""
    control = Layout((Slice("push", 3, "N"),))
    return Pendulum("pendulum-passive", control, PUSH_FORCE, BEARING_DAMPING)
