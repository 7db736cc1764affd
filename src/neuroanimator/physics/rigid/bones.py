"""The skeleton of a MuJoCo model: what MuJoCo's viewer would draw, without MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.appearance.skeleton import Bone, Shape, Skeleton
from neuroanimator.files.names import model_name
from neuroanimator.physics.rigid.rows import rows_at
from neuroanimator.physics.rigid.skins import skin_of
from neuroanimator.physics.rigid.visuals import colour_of, is_shown
from neuroanimator.state.links import Joint

MAX_GROUND = 20.0
"""Half side of the square drawn for an infinite plane [m]: large beside any body that moves on it."""

GROUND_THICKNESS = 0.01
"""Half the thickness of the slab drawn for a plane [m] (sizes of boxes are halves), with its top at the plane."""

DECIMALS = 9
"""Number of decimals of a skeleton's numbers, well below what is visible, to keep files small."""

JOINT_NAMES = {
    int(mujoco.mjtJoint.mjJNT_FREE): "free",
    int(mujoco.mjtJoint.mjJNT_BALL): "ball",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
}
"""Names of MuJoCo's types of joints."""


def skeleton_of(model: mujoco.MjModel) -> Skeleton:
    """Return the bodies of `model` with their joints and shapes, and its skins; the world is a bone if it has shapes."""
    has_world = bool(_shapes(model, 0))
    first = 1
    if has_world:
        first = 0
    bones = [_bone(model, body, first) for body in range(first, model.nbody)]
    return Skeleton(tuple(bones), skin_of(model, first))


def joint_kind(model: mujoco.MjModel, joint: int) -> str:
    """Return the name of a joint's type: free, ball, slide or hinge."""
    return JOINT_NAMES[int(model.jnt_type[joint])]


def joints_of_body(model: mujoco.MjModel, body: int) -> range:
    """Return the numbers of the joints that connect a body to its parent."""
    return range(model.njnt)[rows_at(model.body_jntadr[body], model.body_jntnum[body])]


def _bone(model: mujoco.MjModel, body: int, first: int) -> Bone:
    """Return the bone of a body; `first` is the body that becomes bone 0."""
    parent = -1
    if body > 0:
        parent = int(model.body_parentid[body]) - first
    joints = [_joint(model, joint) for joint in joints_of_body(model, body)]
    return Bone(
        name=model_name(model.body(body).name, f"body_{body}"),
        parent=parent,
        offset=_numbers(model.body_pos[body]),
        orientation=_numbers(model.body_quat[body]),
        joints=tuple(joints),
        shapes=_shapes(model, body),
    )


def _joint(model: mujoco.MjModel, joint: int) -> Joint:
    kind = joint_kind(model, joint)
    entry = int(model.jnt_qposadr[joint])
    reference = 0.0
    if kind in ("hinge", "slide"):
        reference = float(model.qpos0[entry])
    axis = _numbers(model.jnt_axis[joint])
    anchor = _numbers(model.jnt_pos[joint])
    return Joint(kind, entry, axis, anchor, reference)


def _shapes(model: mujoco.MjModel, body: int) -> tuple[Shape, ...]:
    geoms = range(model.ngeom)[rows_at(model.body_geomadr[body], model.body_geomnum[body])]
    return tuple(shape_of_geom(model, geom) for geom in geoms if is_drawn(model, geom))


def is_drawn(model: mujoco.MjModel, geom: int) -> bool:
    """Return whether a viewer would draw a geom."""
    return is_shown(int(model.geom_group[geom]), model.geom_rgba[geom])


def shape_of_geom(model: mujoco.MjModel, geom: int) -> Shape:
    """Return the shape drawn for a geom, in the frame of its body."""
    geom_type = int(model.geom_type[geom])
    kind = SHAPES.get(geom_type, "box")
    position = np.array(model.geom_pos[geom])
    if geom_type == mujoco.mjtGeom.mjGEOM_PLANE:
        position[2] -= GROUND_THICKNESS
        # MuJoCo writes an infinite side as 0.
        sides = [min(side or MAX_GROUND, MAX_GROUND) for side in model.geom_size[geom][:2].tolist()]
        size = (*sides, GROUND_THICKNESS)
    elif geom_type in SHAPES:
        size = _numbers(model.geom_size[geom])
    else:
        size = _numbers(model.geom_aabb[geom][3:])
    return Shape(
        kind,
        size,
        _numbers(position),
        _numbers(model.geom_quat[geom]),
        _numbers(colour_of(model, int(model.geom_matid[geom]), model.geom_rgba[geom])),
    )


SHAPES = {
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
}
"""Kinds of shapes of MuJoCo's types of geoms whose sizes it defines as we do. A plane is drawn as a slab, and any other geom,
such as a mesh or a height field, as its bounding box, to keep emulator files small."""


def _numbers(values: Float[np.ndarray, " N"]) -> tuple[float, ...]:
    # Adding 0.0 makes -0.0 plain zero.
    return tuple(round(float(value), DECIMALS) + 0.0 for value in values)
