"""Key a motion by hand, as animators do: examples/human/get-up.csv, a human who gets up from the floor.

python -m tools.human_get_up
python -m benchmarks.following.following get-up --seed 1

He lies on his front, pushes himself up, sits back on his heels, kneels, sets a foot in front and stands up. Twelve keys say where
his hips, shoulders, knees, feet, elbows and hands are; what lies on the floor stays there between keys.

keys → points at every control, by monotone cubic interpolation → angles by least squares on MuJoCo's kinematics
     → smoothed, the lowest part on the floor → velocities by central differences
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from benchmarks.harness import HUMAN
from neuroanimator.export.csv_file import write_table
from neuroanimator.physics import load_system
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from tools.human_clips import STEPS, Attachment, Poses, fit_poses, smoothed, with_velocities

Point = tuple[float, float]
"""Position along X and height [m]."""


class Key(NamedTuple):
    """Where the body's points are at one time, seen from the side."""

    time: float
    """[s]"""
    hips: Point
    shoulders: Point
    knees: tuple[Point, Point]
    """Right, left."""
    ankles: tuple[Point, Point]
    toes: tuple[Point, Point]
    elbows: Point
    hands: Point
    aside: float = 0.0
    """Distance of hips and shoulders to the left of the middle [m]."""


KNEE = (-0.36, 0.07)
"""Where a knee is while it kneels; ankle and toe are the tucked foot's."""

ANKLE = (-0.737, 0.205)

TOE = (-0.717, 0.09)

KNEES = (KNEE, KNEE)

ANKLES = (ANKLE, ANKLE)

TOES = (TOE, TOE)

SOLE = (0.0, 0.075)
"""Ankle of a foot that stands at the origin; its toe is the ball of the foot."""

BALL = (0.127, 0.045)

LYING = Key(0.0, (0.01, 0.115), (0.515, 0.13), KNEES, ANKLES, TOES, (0.3, 0.3), (0.54, 0.03))

STANDING = Key(
    5.4,
    (0.0, 0.857),
    (0.0, 1.367),
    ((0.0, 0.476), (0.0, 0.476)),
    (SOLE, SOLE),
    (BALL, BALL),
    (-0.02, 1.11),
    (0.03, 0.77),
)

KEYS = (
    LYING,
    LYING._replace(time=0.6),
    Key(1.2, (-0.026, 0.254), (0.42, 0.5), KNEES, ANKLES, TOES, (0.44, 0.26), (0.54, 0.03)),
    Key(1.8, (-0.38, 0.45), (0.12, 0.4), KNEES, ANKLES, TOES, (0.32, 0.22), (0.54, 0.03)),
    Key(2.4, (-0.62, 0.33), (-0.26, 0.69), KNEES, ANKLES, TOES, (-0.18, 0.45), (0.0, 0.2)),
    Key(3.0, (-0.4, 0.449), (-0.41, 0.958), KNEES, ANKLES, TOES, (-0.4, 0.71), (-0.3, 0.4)),
    Key(
        3.5,
        (-0.42, 0.447),
        (-0.46, 0.955),
        ((-0.03, 0.5), KNEE),
        ((-0.25, 0.17), ANKLE),
        ((-0.12, 0.14), TOE),
        (-0.46, 0.7),
        (-0.36, 0.4),
        aside=0.05,
    ),
    Key(
        3.9,
        (-0.34, 0.45),
        (-0.31, 0.957),
        ((0.0, 0.476), KNEE),
        (SOLE, ANKLE),
        (BALL, TOE),
        (-0.31, 0.71),
        (-0.2, 0.4),
    ),
    Key(
        4.5,
        (-0.17, 0.69),
        (0.12, 1.11),
        ((0.13, 0.457), (-0.33, 0.345)),
        (SOLE, (-0.655, 0.215)),
        (BALL, TOE),
        (0.12, 0.86),
        (0.2, 0.55),
        aside=-0.03,
    ),
    Key(
        4.9,
        (-0.03, 0.82),
        (0.07, 1.32),
        ((0.08, 0.468), (0.0, 0.45)),
        (SOLE, (-0.22, 0.13)),
        (BALL, (-0.12, 0.06)),
        (0.03, 1.07),
        (0.12, 0.76),
        aside=-0.03,
    ),
    STANDING,
    STANDING._replace(time=6.4),
)
"""From lying to standing: at first and in the end he rests for a while."""

PALM = (0.008, 0.0, -0.34)
"""Middle of a hand's end, in the frame of its forearm [m]."""

ATTACHMENTS = {
    "rhip": Attachment("thigh_right"),
    "lhip": Attachment("thigh_left"),
    "rshoulder": Attachment("upper_arm_right", weight=0.7),
    "lshoulder": Attachment("upper_arm_left", weight=0.7),
    "rknee": Attachment("shin_right"),
    "lknee": Attachment("shin_left"),
    "rankle": Attachment("foot_right"),
    "lankle": Attachment("foot_left"),
    "rtoe": Attachment("foot_right", (0.127, -0.03, -0.03)),
    "ltoe": Attachment("foot_left", (0.127, 0.03, -0.03)),
    "relbow": Attachment("forearm_right", weight=0.3),
    "lelbow": Attachment("forearm_left", weight=0.3),
    "rhand": Attachment("forearm_right", PALM, 0.7),
    "lhand": Attachment("forearm_left", PALM, 0.7),
}
"""Where on the body the points are, in the order of `_points`."""

HIP_WIDTH = 0.0685
"""Distance of a hip, and of a knee and an ankle, from the middle [m]."""

TOE_WIDTH = 0.0985

SHOULDER_WIDTH = 0.177

ELBOW_WIDTH = 0.25

HAND_WIDTH = 0.23

SMOOTH = 1.5
"""Width of the filter of angles and heights [controls]."""


def _points(key: Key) -> Float[np.ndarray, "M 3"]:
    """Return the points of a key [m], in the order of `ATTACHMENTS`."""
    points = [
        *_pair((key.hips, key.hips), HIP_WIDTH, key.aside),
        *_pair((key.shoulders, key.shoulders), SHOULDER_WIDTH, key.aside),
        *_pair(key.knees, HIP_WIDTH),
        *_pair(key.ankles, HIP_WIDTH),
        *_pair(key.toes, TOE_WIDTH),
        *_pair((key.elbows, key.elbows), ELBOW_WIDTH),
        *_pair((key.hands, key.hands), HAND_WIDTH),
    ]
    return np.array(points)


def _pair(
    points: tuple[Point, Point], width: float, aside: float = 0.0
) -> list[tuple[float, float, float]]:
    right, left = points
    return [(right[0], aside - width, right[1]), (left[0], aside + width, left[1])]


def keyed_points(dt: float) -> Float[np.ndarray, "K M 3"]:
    """Return where the points are at every control of the motion [m], `dt` apart [s]."""
    times = [key.time for key in KEYS]
    points = np.array([_points(key) for key in KEYS])
    return PchipInterpolator(times, points, axis=0)(np.arange(0, times[-1], dt))


def on_the_floor(model: mujoco.MjModel, poses: Poses) -> Poses:
    """Return the poses with the lowest part of the body on the floor."""
    poses = poses.copy()
    lowest = np.array([_lowest(model, pose) for pose in poses])
    poses[:, 2] -= gaussian_filter1d(lowest, SMOOTH, mode="nearest")
    return poses


def _lowest(model: mujoco.MjModel, pose: Float[np.ndarray, " Q"]) -> float:
    """Return the height of the lowest point of the body's capsules and ellipsoids [m]."""
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_kinematics(model, data)
    heights = []
    for geom in range(model.ngeom):
        kind = model.geom_type[geom]
        upward = data.geom_xmat[geom].reshape(3, 3)[2]
        size = model.geom_size[geom]
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            reach = size[0] + size[1] * abs(upward[2])
        elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            reach = np.linalg.norm(upward * size)
        else:
            continue
        heights.append(data.geom_xpos[geom, 2] - reach)
    return min(heights)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=HUMAN / "get-up.csv")
    arguments = parser.parse_args()
    system = load_system(str(HUMAN / "human.toml"))
    assert isinstance(system, MujocoSystem)
    model = system.model
    dt = STEPS * system.physics_dt
    poses = fit_poses(model, keyed_points(dt), ATTACHMENTS)
    poses = on_the_floor(model, smoothed(poses, SMOOTH))
    poses[:, -1] = np.linspace(0, 2 * np.pi, len(poses))
    at_rest = np.concatenate([poses[:1], poses, poses[-1:]])
    states = with_velocities(model, at_rest, dt)
    times = np.arange(len(states)) * dt
    write_table(arguments.out, times, states.round(5), system.state)
    print(f"get-up: {len(states) - 1} steps of {dt:g} s, {times[-1]:.1f} s")


if __name__ == "__main__":
    main()
