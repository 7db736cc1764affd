"""What a model's root stands among: what it can touch, what it is tied to, and so whether its place matters."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.parsing.names import model_name
from neuroanimator.systems.rigid.bones import JOINT_NAMES
from neuroanimator.systems.rigid.joints import joint_name
from neuroanimator.systems.rigid.touching import is_disabled, is_limited, touching_geoms

LEVEL_TOLERANCE = 1e-9
"""An axis is level, or at right angles to another, if their product is below this: rounding only."""


def gravity_of(model: mujoco.MjModel) -> Float[np.ndarray, " 3"]:
    """Return the acceleration of gravity [m/s²], zero where the model's flags turn it off."""
    if is_disabled(model, mujoco.mjtDisableBit.mjDSBL_GRAVITY):
        return np.zeros(3)
    return np.array(model.opt.gravity)


def has_free_root(model: mujoco.MjModel) -> bool:
    """Return whether the model's first joint is free."""
    return bool(model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE)


def has_contacts(model: mujoco.MjModel) -> bool:
    """Return whether anything can touch anything."""
    return len(touching_geoms(model)) > 0


def world_axes(model: mujoco.MjModel) -> Float[np.ndarray, "J 3"]:
    """Return each joint's axis in the world, in the reference pose."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return np.array(data.xaxis)


def can_touch_ground(model: mujoco.MjModel) -> bool:
    """Return whether a body that moves can touch something that does not."""
    bodies = model.body_weldid[model.geom_bodyid[touching_geoms(model)]]
    return bool((bodies == 0).any())


def planar_root(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the joints x, y, heading of a root that moves freely in a level plane, or nothing."""
    if (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any():
        return ()
    root = model.jnt_bodyid[0]
    joints = [joint for joint in range(model.njnt) if model.jnt_bodyid[joint] == root][:3]
    kinds = [JOINT_NAMES[int(model.jnt_type[joint])] for joint in joints]
    if kinds != ["slide", "slide", "hinge"] or model.body_parentid[root] != 0:
        return ()
    x, y, axis = world_axes(model)[joints]
    is_plane = np.allclose(np.cross(x, y), axis) and abs(x @ y) < LEVEL_TOLERANCE
    if not is_plane or any(_is_held(model, joint) for joint in joints):
        return ()
    axes = [x, y]
    weight = gravity_of(model)
    is_level = all(abs(weight @ direction) < LEVEL_TOLERANCE for direction in axes)
    if not is_level or any(what_tells_place(model, joint, axes) for joint in joints):
        return ()
    if not _looks_the_same_all_round(model, joints[0], joints[1]):
        return ()
    return tuple(joint_name(model, joint) for joint in joints)


def _looks_the_same_all_round(model: mujoco.MjModel, x: int, y: int) -> bool:
    """Return whether the heading of a root on the slides x and y does not matter: nothing acts along these but alike.

    A motor on a slide pushes along the world's axes, whatever the heading, and dry friction is stronger along diagonals.
    """
    if any(model.actuator_trnid[i][0] in (x, y) for i in _on_joints(model)):
        return False
    first, second = model.jnt_dofadr[x], model.jnt_dofadr[y]
    if model.dof_frictionloss[first] or model.dof_frictionloss[second]:
        return False
    is_damped_alike = np.array_equal(model.dof_damping[first], model.dof_damping[second])
    return is_damped_alike and bool(model.dof_armature[first] == model.dof_armature[second])


def world_axis_actuators(model: mujoco.MjModel) -> list[int]:
    """Return the actuators that push the free joint at the root along a level axis of the world, so its heading matters."""
    if not has_free_root(model):
        return []
    on_root = [i for i in _on_joints(model) if model.actuator_trnid[i][0] == 0]
    return [i for i in on_root if np.any(model.actuator_gear[i][:2])]


LEVEL = (np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
"""The level axes of the world."""


def free_root_is_placed(model: mujoco.MjModel) -> bool:
    """Return whether it matters where the free joint at the root stands, or which way it faces.

    It does where another body is free, where something tells the place, and where actuators push along the world's axes.
    """
    if np.sum(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE) > 1:
        return True
    return bool(what_tells_place(model, 0, LEVEL) or world_axis_actuators(model))


def is_placeless(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether nothing can tell where a slide stands, so that only its velocity matters.

    It is a slide of a root that neither range, spring nor servo holds, with only other slides before it, and
    `what_tells_place` finds nothing. Gravity does not tell: it is the same everywhere.
    """
    body = model.jnt_bodyid[joint]
    if model.body_parentid[body] != 0 or _is_held(model, joint):
        return False
    before = range(model.body_jntadr[body], joint)
    if any(model.jnt_type[other] != mujoco.mjtJoint.mjJNT_SLIDE for other in before):
        return False
    return not what_tells_place(model, joint, [world_axes(model)[joint]])


def _is_held(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether a range, a spring or a servo keeps the joint somewhere."""
    return is_limited(model, joint) or has_spring(model, joint) or has_servo(model, joint)


def has_spring(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether a spring of its own pulls the joint back; the model's flags may turn all springs off."""
    is_off = is_disabled(model, mujoco.mjtDisableBit.mjDSBL_SPRING)
    return bool(np.any(model.jnt_stiffness[joint])) and not is_off


def has_servo(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether an actuator drives the joint by how far it is from somewhere: a servo, or a muscle."""
    return any(
        servo_of(model, actuator) and model.actuator_trnid[actuator][0] == joint
        for actuator in _on_joints(model)
    )


def servo_of(model: mujoco.MjModel, actuator: int) -> bool:
    """Return whether an actuator's force depends on how long it is: a position servo, or a muscle."""
    bias = model.actuator_biastype[actuator]
    if bias == mujoco.mjtBias.mjBIAS_NONE:
        return False
    is_affine = bias == mujoco.mjtBias.mjBIAS_AFFINE
    return not is_affine or bool(model.actuator_biasprm[actuator][1])


def actuated_joint(model: mujoco.MjModel, actuator: int) -> int:
    """Return the joint an actuator is on, -1 if it is on something else."""
    if actuator in _on_joints(model):
        return int(model.actuator_trnid[actuator][0])
    return -1


def _on_joints(model: mujoco.MjModel) -> list[int]:
    # As whole numbers: MuJoCo's enumerations equal NumPy's numbers from one side only.
    kinds = [int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)]
    return [i for i in range(model.nu) if int(model.actuator_trntype[i]) in kinds]


def what_tells_place(
    model: mujoco.MjModel, joint: int, axes: Iterable[Float[np.ndarray, " 3"]]
) -> str:
    """Return the name of something by which the root of `joint` can tell where it is along `axes`; empty if nothing.

    That is anything it can touch but planes along all of `axes`, a tendon or an equality with something else, and one
    of the joint itself.
    """
    tree = int(model.body_rootid[model.jnt_bodyid[joint]])
    is_own = model.body_rootid == tree
    return (
        _obstacle(model, is_own, list(axes))
        or _tie_by_tendon(model, is_own, joint)
        or _tie_by_equality(model, is_own, joint)
    )


def _obstacle(
    model: mujoco.MjModel, is_own: Bool[np.ndarray, " B"], axes: list[Float[np.ndarray, " 3"]]
) -> str:
    """Return what the bodies `is_own` can touch besides one another, except planes that look the same all along `axes`."""
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


def _tie_by_tendon(model: mujoco.MjModel, is_own: Bool[np.ndarray, " B"], joint: int) -> str:
    """Return a tendon between the bodies `is_own` and others, or one that winds the joint itself; empty if none."""
    for tendon in range(model.ntendon):
        first = model.tendon_adr[tendon]
        wraps = range(first, first + model.tendon_num[tendon])
        bodies = [_wrapped_body(model, wrap) for wrap in wraps]
        sides = {bool(is_own[body]) for body in bodies if body >= 0}
        winds_joint = any(
            model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_JOINT and model.wrap_objid[wrap] == joint
            for wrap in wraps
        )
        if len(sides) > 1 or winds_joint:
            return model_name(model.tendon(tendon).name, f"tendon_{tendon}")
    return ""


def _wrapped_body(model: mujoco.MjModel, wrap: int) -> int:
    """Return the body of a point of a tendon; -1 for a pulley, which has none."""
    kind = model.wrap_type[wrap]
    thing = model.wrap_objid[wrap]
    if kind == mujoco.mjtWrap.mjWRAP_JOINT:
        return int(model.jnt_bodyid[thing])
    if kind == mujoco.mjtWrap.mjWRAP_SITE:
        return int(model.site_bodyid[thing])
    if kind == mujoco.mjtWrap.mjWRAP_SPHERE or kind == mujoco.mjtWrap.mjWRAP_CYLINDER:
        return int(model.geom_bodyid[thing])
    return -1


def _tie_by_equality(model: mujoco.MjModel, is_own: Bool[np.ndarray, " B"], joint: int) -> str:
    """Return an equality between the bodies `is_own` and others, or one of the joint itself; empty if none."""
    if is_disabled(
        model, mujoco.mjtDisableBit.mjDSBL_EQUALITY, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    ):
        return ""
    for equality in range(model.neq):
        first = int(model.eq_obj1id[equality])
        second = int(model.eq_obj2id[equality])
        kind = model.eq_type[equality]
        name = model_name(model.equality(equality).name, f"equality_{equality}")
        if kind == mujoco.mjtEq.mjEQ_JOINT:
            others = [model.jnt_bodyid[other] for other in (first, second) if other >= 0]
            if joint in (first, second) or len({bool(is_own[body]) for body in others}) > 1:
                return name
        elif kind == mujoco.mjtEq.mjEQ_CONNECT or kind == mujoco.mjtEq.mjEQ_WELD:
            if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
                first, second = int(model.site_bodyid[first]), int(model.site_bodyid[second])
            if is_own[first] != is_own[second]:
                return name
    return ""
