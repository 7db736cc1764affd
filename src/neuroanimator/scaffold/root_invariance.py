"""Whether a model's motion depends on its root's position and heading: contacts, ties, forces of the world."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.files.names import model_name
from neuroanimator.physics.rigid.actuators import actuators_of_controls, input_of
from neuroanimator.physics.rigid.bones import joint_kind
from neuroanimator.physics.rigid.joints import joint_name
from neuroanimator.physics.rigid.touching import is_disabled, is_limited, touching_geoms
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.state.rotation import facing, multiply, rotate_in_plane

LEVEL_TOLERANCE = 1e-9
"""Largest dot product of two perpendicular directions, due to rounding."""

SHIFTS = (0.31, -4.7, 53.0)
"""Distances by which a root is shifted to test for a difference [m]."""

TURN = 2.0
"""Angle by which a root is turned about the vertical to test for a difference [rad]."""

PERTURBATION = 0.1
"""Standard deviation of the positions in which accelerations are compared [rad or m]."""

TOLERANCE = 1e-5
"""Relative or absolute difference of accelerations that counts as rounding."""

LEVEL = (np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
"""Level axes of the world."""

Vector = Float[np.ndarray, " _"]
"""Positions, velocities, controls or activations of a model."""


def gravity_of(model: mujoco.MjModel) -> Float[np.ndarray, " 3"]:
    """Return the acceleration of gravity [m/s²], zero if the model's flags turn it off."""
    if is_disabled(model, mujoco.mjtDisableBit.mjDSBL_GRAVITY):
        return np.zeros(3)
    return np.array(model.opt.gravity)


def has_free_root(model: mujoco.MjModel) -> bool:
    """Return whether the model's first joint is free."""
    return bool(model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE)


def has_contacts(model: mujoco.MjModel) -> bool:
    """Return whether anything can touch anything."""
    return len(touching_geoms(model)) > 0


def can_touch_ground(model: mujoco.MjModel) -> bool:
    """Return whether a moving body can touch something fixed."""
    bodies = model.body_weldid[model.geom_bodyid[touching_geoms(model)]]
    return bool((bodies == 0).any())


def planar_root(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the joints x, y, heading of a root that moves freely in a level plane, or nothing."""
    root = model.jnt_bodyid[0]
    joints = np.flatnonzero(model.jnt_bodyid == root)[:3].tolist()
    kinds = [joint_kind(model, joint) for joint in joints]
    has_free_body = (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any()
    if kinds != ["slide", "slide", "hinge"] or model.body_parentid[root] != 0 or has_free_body:
        return ()
    x, y, axis = world_axes(model)[joints]
    if not np.allclose(np.cross(x, y), axis) or any(is_limited(model, joint) for joint in joints):
        return ()
    if obstacle(model, 0, (x, y)) or not is_same_anywhere(model, joints):
        return ()
    return tuple(joint_name(model, joint) for joint in joints)


def world_axes(model: mujoco.MjModel) -> Float[np.ndarray, "J 3"]:
    """Return each joint's axis in the world, in the reference pose."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return np.array(data.xaxis)


def why_root_is_placed(model: mujoco.MjModel) -> str:
    """Return why the position or heading of the free joint at the root matters; empty if it does not."""
    if np.sum(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE) > 1:
        return "it is not the only free body"
    touched = obstacle(model, 0, LEVEL)
    if touched:
        return f"it can touch '{touched}'"
    if not is_same_anywhere(model, [0]):
        return "something pushes or pulls it along the world's axes"
    return ""


def is_placeless(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether only the velocity of a root's slide matters, not its position."""
    if model.body_parentid[model.jnt_bodyid[joint]] != 0 or is_limited(model, joint):
        return False
    is_unobstructed = not obstacle(model, joint, [world_axes(model)[joint]])
    return is_unobstructed and is_same_anywhere(model, [joint])


def obstacle(model: mujoco.MjModel, joint: int, axes: Iterable[Vector]) -> str:
    """Return something that the tree of bodies on `joint` can touch, except planes that are invariant along `axes`."""
    is_own = model.body_rootid == model.body_rootid[model.jnt_bodyid[joint]]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for pair in touching_geoms(model):
        others = [int(geom) for geom in pair if not is_own[model.geom_bodyid[geom]]]
        if len(others) != 1:
            continue
        [other] = others
        normal = data.geom_xmat[other].reshape(3, 3)[:, 2]
        is_plane = model.geom_type[other] == mujoco.mjtGeom.mjGEOM_PLANE
        is_fixed = model.body_weldid[model.geom_bodyid[other]] == 0
        is_along = all(abs(normal @ axis) < LEVEL_TOLERANCE for axis in axes)
        if not (is_plane and is_fixed and is_along):
            return model_name(model.geom(other).name, f"geom_{other}")
    return ""


def is_same_anywhere(model: mujoco.MjModel, joints: Sequence[int]) -> bool:
    """Return whether accelerations are the same wherever `joints` put the root, apart from contacts.

    `joints` are a slide, or those of a planar root, or a free joint; roots of the latter two kinds are turned, too.
    Springs, servos, tendons and equalities that tie the root to the world, and forces along its axes, make a difference.
    """
    loose = model.__copy__()
    loose.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    rng = np.random.default_rng(0)
    for shift in SHIFTS:
        positions = np.array(model.qpos0)
        mujoco.mj_integratePos(model, positions, rng.normal(size=model.nv), PERTURBATION)
        velocities = rng.normal(size=model.nv)
        drive = (rng.normal(size=model.nu), rng.uniform(size=model.na))
        usual = _turned(model, joints, _accelerations(loose, positions, velocities, *drive))
        moved = positions.copy()
        first = model.jnt_qposadr[joints[0]]
        moved[first] += shift
        if _can_turn(model, joints):
            moved[first + 1] += shift
            if len(joints) > 1:
                moved[first + 2] += TURN
            else:
                orientation = slice(first + 3, first + 7)
                moved[orientation] = multiply(facing(np.array(TURN)), positions[orientation])
        found = _accelerations(loose, moved, _turned(model, joints, velocities), *drive)
        if (np.abs(found - usual) > TOLERANCE * np.maximum(1, np.abs(usual))).any():
            return False
    return True


def _accelerations(
    model: mujoco.MjModel,
    positions: Vector,
    velocities: Vector,
    controls: Vector,
    activations: Vector,
) -> Vector:
    data = mujoco.MjData(model)
    data.qpos[:] = positions
    data.qvel[:] = velocities
    data.ctrl[:] = controls
    data.act[:] = activations
    with warnings_counted:
        mujoco.mj_forward(model, data)
    return np.array(data.qacc)


def _turned(model: mujoco.MjModel, joints: Sequence[int], vector: Vector) -> Vector:
    """Return velocities or accelerations with those of the root turned by `TURN`, if it can turn."""
    turned = vector.copy()
    if _can_turn(model, joints):
        first = model.jnt_dofadr[joints[0]]
        level = slice(first, first + 2)
        turned[level] = rotate_in_plane(np.array([TURN]), vector[level])
    return turned


def _can_turn(model: mujoco.MjModel, joints: Sequence[int]) -> bool:
    is_free = bool(model.jnt_type[joints[0]] == mujoco.mjtJoint.mjJNT_FREE)
    return is_free or len(joints) > 1


def has_spring(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether a spring of its own pulls the joint back; the model's flags may turn all springs off."""
    is_off = is_disabled(model, mujoco.mjtDisableBit.mjDSBL_SPRING)
    return bool(np.any(model.jnt_stiffness[joint])) and not is_off


def has_servo(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether an actuator drives the joint depending on its position: a servo, or a muscle."""
    return any(
        is_servo(model, actuator) and actuated_joint(model, actuator) == joint
        for actuator in range(model.nactuator)
    )


def is_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Return whether an actuator's force depends on its length: a position servo, or a muscle."""
    bias = model.actuator_biastype[actuator]
    is_affine = bias == mujoco.mjtBias.mjBIAS_AFFINE
    is_without = bias == mujoco.mjtBias.mjBIAS_NONE
    return not is_without and (not is_affine or bool(model.actuator_biasprm[actuator][1]))


def aims(model: mujoco.MjModel, control: int) -> bool:
    """Return whether a control is where its actuator pulls to: the position of a servo, or the excitation of a muscle."""
    is_other_input = input_of(model, control) in ("vel", "ff", "voltage", "pressure")
    return is_servo(model, int(actuators_of_controls(model)[control])) and not is_other_input


def actuated_joint(model: mujoco.MjModel, actuator: int) -> int:
    """Return the joint an actuator is on, -1 if it is on something else."""
    # As integers: MuJoCo's enumerations equal NumPy's numbers from one side only.
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    kind = int(model.actuator_trntype[actuator])
    first, second = model.actuator_trnid[actuator].tolist()
    is_orientation = kind == int(mujoco.mjtTrn.mjTRN_SO3) and second < 0  # else of two sites
    return first if kind in kinds or is_orientation else -1
