"""Make the motions that the human follows from markers: examples/human/walk.csv, jog.csv and run.csv.

git clone https://github.com/google-deepmind/mujoco_mpc
python -m tools.human_clips mujoco_mpc/mjpc/tasks/humanoid/tracking/keyframes

The keyframes of that tracking task (Apache-2.0) hold the positions of sixteen points of an actor's body, 30 times a second, and
angles of the first pose only. The data were obtained from mocap.cs.cmu.edu; that database was created with funding from NSF
EIA-0196217.

markers → angles by least squares on MuJoCo's kinematics → the floor levelled → one cycle cut out and closed
        → resampled, one control apart → velocities by central differences

The run is the jog, straightened and averaged with its mirror image half a cycle later: the actor leans into a turn, a straight
run does not.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from benchmarks.harness import HUMAN
from neuroanimator.export.csv_file import write_table
from neuroanimator.physics import load_system
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.rotation import facing, heading_of, multiply

STEPS = 4
"""Number of physics steps between two states: for so long a control is held."""

RATE = 30.0
"""Number of keyframes a second."""


@dataclass(frozen=True)
class Attachment:
    """Where on the body a marker is."""

    body: str
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """[m]"""
    weight: float = 1.0


ATTACHMENTS = {
    "pelvis": Attachment("pelvis", (0.0, 0.0, 0.09)),
    "head": Attachment("torso", (0.0, 0.0, 0.54), 0.3),
    "ltoe": Attachment("foot_left", (0.127, 0.03, -0.03)),
    "rtoe": Attachment("foot_right", (0.127, -0.03, -0.03)),
    "lheel": Attachment("foot_left", weight=2.0),
    "rheel": Attachment("foot_right", weight=2.0),
    "lknee": Attachment("shin_left"),
    "rknee": Attachment("shin_right"),
    "lhand": Attachment("forearm_left", (0.0, 0.0, -0.25), 0.7),
    "rhand": Attachment("forearm_right", (0.0, 0.0, -0.25), 0.7),
    "lelbow": Attachment("forearm_left", weight=0.7),
    "relbow": Attachment("forearm_right", weight=0.7),
    "lshoulder": Attachment("upper_arm_left", weight=0.7),
    "rshoulder": Attachment("upper_arm_right", weight=0.7),
    "lhip": Attachment("thigh_left"),
    "rhip": Attachment("thigh_right"),
}
"""Where the markers are, in the files' order; a heel is at the ankle, a toe at the ball of the foot."""

PRIOR = 0.02
"""Weight that draws each angle to the reference pose [m/rad]: markers leave the twist of straight limbs open."""

PRIORS = {"ankle_x": 0.05, "hip_z": 0.06, "shoulder_z": 0.04}
"""Weights of angles that markers say less about."""

SMOOTH = 0.03
"""Weight that draws each angle to that of the frame before [m/rad]."""

LEVEL = 0.1
"""Weight that keeps feet from rolling [m]."""

ITERATIONS = 60

FOOT = 4
"""Number of points of a sole: the two ends of its two capsules."""


@dataclass(frozen=True)
class Cycle:
    """What to cut out of a recording."""

    file: str
    first: int
    """Frame."""
    last: int
    """Frame in which the pose of the first comes again."""
    is_straight: bool
    """Whether it is unbent to go straight along X; otherwise it goes on turning as it does in a cycle."""
    always_touches: bool
    """Whether a foot is on the floor at all times: then that is kept to."""
    is_symmetric: bool = False
    """Whether it is averaged with its mirror image, half a cycle later."""


CYCLES = {
    "walk": Cycle("CMU-CMU-137-137_40_poses.xml", 117, 165, True, True),
    "jog": Cycle("CMU-CMU-108-108_13_poses.xml", 6, 31, False, False),
    "run": Cycle("CMU-CMU-108-108_13_poses.xml", 6, 31, True, False, is_symmetric=True),
}

Pose = Float[np.ndarray, " Q"]
Poses = Float[np.ndarray, "K Q"]


def read_markers(path: Path) -> Float[np.ndarray, "K 16 3"]:
    """Return the positions of the markers [m] in each keyframe."""
    keys = ElementTree.parse(path).findall(".//key")
    rows = [[float(number) for number in key.attrib["mpos"].split()] for key in keys]
    return np.array(rows).reshape(len(rows), len(ATTACHMENTS), 3)


def fit_poses(
    model: mujoco.MjModel,
    markers: Float[np.ndarray, "K M 3"],
    attachments: dict[str, Attachment],
) -> Poses:
    """Return the poses whose points lie nearest to the markers: by Gauss-Newton, each from the one before."""
    names = list(attachments)
    left = markers[0, names.index("lhip")]
    right = markers[0, names.index("rhip")]
    across = left - right
    pose = model.qpos0.copy()
    pose[:3] = (left + right) / 2
    pose[3:7] = facing(np.asarray(np.arctan2(-across[0], across[1])))
    poses = []
    for frame in markers:
        pose = _fit_pose(model, frame, attachments, pose, is_first=not poses)
        poses.append(pose)
    return np.array(poses)


def _fit_pose(
    model: mujoco.MjModel,
    frame: Float[np.ndarray, "M 3"],
    attachments: dict[str, Attachment],
    start: Pose,
    *,
    is_first: bool,
) -> Pose:
    data = mujoco.MjData(model)
    priors = _weights(model, PRIOR, PRIORS)
    smooth = np.zeros(model.nv) if is_first else _weights(model, SMOOTH, {})
    pose = start.copy()
    for _ in range(ITERATIONS):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        jacobian, residual = _equations(model, data, frame, attachments)
        normal = jacobian.T @ jacobian + np.diag(priors**2 + smooth**2 + 1e-6)
        right = jacobian.T @ residual
        right += priors**2 * difference(model, pose, model.qpos0)
        right += smooth**2 * difference(model, pose, start)
        step = np.linalg.solve(normal, right)
        step[6:] = np.clip(step[6:], -0.3, 0.3)
        mujoco.mj_integratePos(model, pose, step, 1.0)
        hinges = slice(7, 7 + model.njnt - 1)
        limits = model.jnt_range[1:].copy()
        limits[~model.jnt_limited[1:].astype(bool)] = [-np.inf, np.inf]
        pose[hinges] = np.clip(pose[hinges], limits[:, 0], limits[:, 1])
        if np.abs(step).max() < 1e-5:
            break
    return pose


def _equations(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    frame: Float[np.ndarray, "M 3"],
    attachments: dict[str, Attachment],
) -> tuple[Float[np.ndarray, "E V"], Float[np.ndarray, " E"]]:
    """Return (Jacobian, residual) of markers and of feet that should not roll."""
    rows = []
    residuals = []
    for wanted, attachment in zip(frame, attachments.values(), strict=True):
        body = model.body(attachment.body).id
        point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ attachment.offset
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, point, body)
        rows.append(attachment.weight * jacobian)
        residuals.append(attachment.weight * (wanted - point))
    for name in ("foot_left", "foot_right"):
        body = model.body(name).id
        turning = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, None, turning, data.xpos[body], body)
        across = data.xmat[body].reshape(3, 3)[:, 1]
        rows.append(LEVEL * (turning[0] * across[1] - turning[1] * across[0])[None])
        residuals.append(np.array([-LEVEL * across[2]]))
    return np.concatenate(rows), np.concatenate(residuals)


def _weights(
    model: mujoco.MjModel, usual: float, others: dict[str, float]
) -> Float[np.ndarray, " V"]:
    """Return the weight of each velocity: none of the root's, `usual` of angles but `others`, by how their names begin."""
    weights = np.full(model.nv, usual)
    weights[:6] = 0
    for joint in range(model.njnt):
        for prefix, weight in others.items():
            if model.joint(joint).name.startswith(prefix):
                weights[model.jnt_dofadr[joint]] = weight
    return weights


def difference(model: mujoco.MjModel, first: Pose, second: Pose) -> Float[np.ndarray, " V"]:
    """Return the velocity that moves the first pose to the second in a second [rad/s, m/s]."""
    velocity = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, velocity, 1.0, first, second)
    return velocity


def soles(model: mujoco.MjModel, pose: Pose) -> Float[np.ndarray, "2 4 3"]:
    """Return the lowest points at the ends of the soles' capsules [m]: right, left."""
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_kinematics(model, data)
    points = []
    for side in ("right", "left"):
        for sole in ("sole_in", "sole_out"):
            geom = model.geom(f"{sole}_{side}").id
            radius, half, _ = model.geom_size[geom]
            along = half * data.geom_xmat[geom].reshape(3, 3)[:, 2]
            middle = data.geom_xpos[geom] - [0, 0, radius]
            points += [middle + along, middle - along]
    return np.array(points).reshape(2, FOOT, 3)


def _lowest(model: mujoco.MjModel, poses: Poses) -> Float[np.ndarray, " K"]:
    return np.array([soles(model, pose)[..., 2].min() for pose in poses])


def smoothed(poses: Poses, width: float) -> Poses:
    """Return the poses after a Gaussian filter over time, `width` in frames."""
    poses = _continuous(poses)
    poses = gaussian_filter1d(poses, width, axis=0, mode="nearest")
    poses[:, 3:7] /= np.linalg.norm(poses[:, 3:7], axis=1, keepdims=True)
    return poses


def _continuous(poses: Poses) -> Poses:
    """Return the poses with each quaternion the one of its two signs that is nearer to the one before."""
    poses = poses.copy()
    for number in range(1, len(poses)):
        if poses[number, 3:7] @ poses[number - 1, 3:7] < 0:
            poses[number, 3:7] *= -1
    return poses


def levelled(model: mujoco.MjModel, poses: Poses, *, always_touches: bool) -> Poses:
    """Return the poses with the floor at zero: in the recordings it slopes, by up to ten centimetres on the way."""
    poses = poses.copy()
    lowest = _lowest(model, poses)
    if always_touches:
        poses[:, 2] -= gaussian_filter1d(lowest, 3.0)
        return poses
    times = np.arange(len(poses))
    stands = _stands(lowest)
    poses[:, 2] -= np.polyval(np.polyfit(times[stands], lowest[stands], 1), times)
    return poses


def _stands(lowest: Float[np.ndarray, " K"]) -> Bool[np.ndarray, " K"]:
    """Return whether a foot is on the floor, in a motion that also flies."""
    return lowest < np.percentile(lowest, 35)


def _turned(poses: Poses, angle: float) -> Poses:
    """Return poses turned about the world's Z axis."""
    poses = poses.copy()
    cosine = np.cos(angle)
    sine = np.sin(angle)
    poses[:, :2] = poses[:, :2] @ np.array([[cosine, sine], [-sine, cosine]])
    turn = np.broadcast_to(facing(np.asarray(angle)), (len(poses), 4))
    poses[:, 3:7] = multiply(turn, poses[:, 3:7])
    return poses


def _turn_of(poses: Poses) -> float:
    turn = heading_of(poses[-1, 3:7]) - heading_of(poses[0, 3:7])
    return float((turn + np.pi) % (2 * np.pi) - np.pi)


def closed(poses: Poses, *, is_straight: bool) -> Poses:
    """Return a cycle from the origin along X whose last pose is its first, moved on: what is missing is spread over it."""
    turn = _turn_of(poses)
    count = len(poses)
    if is_straight:
        unbent = [poses[:1]]
        for number in range(1, count):
            step = poses[number : number + 1].copy()
            step[0, :2] -= poses[number - 1, :2]
            step = _turned(step, -turn * number / (count - 1))
            step[0, :2] += unbent[-1][0, :2]
            unbent.append(step)
        poses = np.concatenate(unbent)
        turn = 0.0
    poses = poses.copy()
    poses[:, :2] -= poses[0, :2]
    heading = -heading_of(poses[0, 3:7])
    if is_straight:
        heading = -np.arctan2(poses[-1, 1], poses[-1, 0])
    poses = _continuous(_turned(poses, float(heading)))
    missing = _turned(poses[-1:], -turn)[0] - poses[0]
    if missing[3] < -1:  # the other sign of the same quaternion
        missing[3:7] = -_turned(poses[-1:], -turn)[0, 3:7] - poses[0, 3:7]
    missing[:2] = 0
    poses -= np.linspace(-0.5, 0.5, count)[:, None] * missing
    poses[:, 3:7] /= np.linalg.norm(poses[:, 3:7], axis=1, keepdims=True)
    return poses


def symmetric(model: mujoco.MjModel, poses: Poses) -> Poses:
    """Return evenly spaced poses along X, from one before a lap to two after its last, as their mean with their mirror image."""
    steps = len(poses) - 3
    lap = _continuous(poses[1 : steps + 1])
    length = poses[steps + 1, 0] - poses[1, 0]
    lap[:, 0] -= length * np.arange(steps) / steps
    later = _continuous(
        np.concatenate([lap[:1], _mirrored(model, np.roll(lap, -steps // 2, axis=0))])
    )
    lap = (lap + later[1:]) / 2
    numbers = np.arange(-1, steps + 2)
    mean = lap[numbers % steps]
    mean[:, 0] += length * numbers / steps
    mean[:, 3:7] /= np.linalg.norm(mean[:, 3:7], axis=1, keepdims=True)
    mean[:, -1] = poses[:, -1]
    return mean


def _mirrored(model: mujoco.MjModel, poses: Poses) -> Poses:
    """Return the poses with left and right exchanged: limbs' angles have the same sign on both sides."""
    mirrored = poses.copy()
    mirrored[:, [1, 4, 6]] *= -1
    for joint in range(1, model.njnt):
        name = model.joint(joint).name
        other = (
            name.replace("_right", "_left") if "_right" in name else name.replace("_left", "_right")
        )
        sign = -1.0 if name in ("abdomen_x", "abdomen_z") else 1.0
        mirrored[:, model.joint(joint).qposadr[0]] = sign * poses[:, model.joint(other).qposadr[0]]
    return mirrored


def sampled(
    model: mujoco.MjModel, cycle: Poses, dt: float, *, always_touches: bool, is_symmetric: bool
) -> Float[np.ndarray, "K S"]:
    """Return the states of a closed cycle, `dt` apart; its time is rounded to whole steps."""
    steps = round((len(cycle) - 1) / RATE / dt)
    turn = _turn_of(cycle)
    before = _turned(cycle - _at_place(cycle[-1]), -turn)
    after = _turned(cycle, turn) + _at_place(cycle[-1])
    long = smoothed(np.concatenate([before[:-1], cycle[:-1], after]), 0.7)
    times = np.arange(len(long)) - (len(cycle) - 1)
    spline = CubicSpline(times * (steps * dt / (len(cycle) - 1)), long)
    poses = spline(np.arange(-1, steps + 2) * dt)
    poses[:, 3:7] /= np.linalg.norm(poses[:, 3:7], axis=1, keepdims=True)
    poses[:, -1] = 2 * np.pi * np.arange(-1, steps + 2) / steps
    if is_symmetric:
        poses = symmetric(model, poses)
        lowest = _lowest(model, poses)
        poses[:, 2] -= lowest[_stands(lowest)].mean()
    if always_touches:
        lowest = _lowest(model, poses)
        lowest[1:-2] = gaussian_filter1d(lowest[1:-2], 1.5, mode="wrap")
        lowest[[0, -2, -1]] = lowest[[-3, 1, 2]]
        poses[:, 2] -= lowest
    return with_velocities(model, poses, dt)


def with_velocities(model: mujoco.MjModel, poses: Poses, dt: float) -> Float[np.ndarray, "K S"]:
    """Return the states of all poses but the first and the last, `dt` apart [s], with velocities by central differences."""
    states = []
    for number in range(1, len(poses) - 1):
        velocity = difference(model, poses[number - 1], poses[number + 1]) / (2 * dt)
        states.append(np.concatenate([poses[number], velocity]))
    return np.array(states)


def _at_place(pose: Pose) -> Pose:
    """Return where along the floor a pose is, all else zero."""
    place = np.zeros_like(pose)
    place[:2] = pose[:2]
    return place


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("keyframes", type=Path, help="folder of the tracking task's keyframes")
    parser.add_argument("--out", type=Path, default=HUMAN)
    arguments = parser.parse_args()
    system = load_system(str(HUMAN / "human.toml"))
    assert isinstance(system, MujocoSystem)
    model = system.model
    dt = STEPS * system.physics_dt
    for name, cycle in CYCLES.items():
        markers = read_markers(arguments.keyframes / cycle.file)
        poses = smoothed(fit_poses(model, markers, ATTACHMENTS), 1.0)
        poses = levelled(model, poses, always_touches=cycle.always_touches)
        cut = closed(poses[cycle.first : cycle.last + 1], is_straight=cycle.is_straight)
        states = sampled(
            model,
            cut,
            dt,
            always_touches=cycle.always_touches,
            is_symmetric=cycle.is_symmetric,
        )
        times = np.arange(len(states)) * dt
        write_table(arguments.out / f"{name}.csv", times, states.round(5), system.state)
        speed = np.linalg.norm(states[-1, :2]) / times[-1]
        print(f"{name}: {len(states) - 1} steps of {dt:g} s, {speed:.2f} m/s")


if __name__ == "__main__":
    main()
