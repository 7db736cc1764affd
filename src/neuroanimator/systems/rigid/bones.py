"""The skeleton of a MuJoCo model: what its viewer would draw, without MuJoCo."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from neuroanimator.appearance.skeleton import Bone, Joint, Shape, Skeleton
from neuroanimator.parsing.names import model_name

DRAWN_GROUPS = 3
"""Geoms of groups 0 to 2 are drawn, as in MuJoCo's own viewer; higher groups are for contact only."""

MAX_GROUND = 20.0
"""[m] Half the side at which an infinite plane is drawn."""

GROUND_THICKNESS = 0.01
"""[m] A plane is drawn as a slab this thick, its top where the plane is."""

JOINT_NAMES = {
    int(mujoco.mjtJoint.mjJNT_FREE): "free",
    int(mujoco.mjtJoint.mjJNT_BALL): "ball",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
}


def skeleton_of(model: mujoco.MjModel) -> Skeleton:
    """Return the bodies of `model` with their joints and shapes; the world is a bone if it has shapes."""
    first = 0 if _shapes(model, 0) else 1
    return Skeleton(tuple(_bone(model, body, first) for body in range(first, model.nbody)))


def _bone(model: mujoco.MjModel, body: int, first: int) -> Bone:
    joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
    return Bone(
        name=model_name(model.body(body).name, f"body_{body}"),
        parent=-1 if body == 0 else int(model.body_parentid[body]) - first,
        offset=_numbers(model.body_pos[body]),
        orientation=_numbers(model.body_quat[body]),
        joints=tuple(_joint(model, joint) for joint in joints),
        shapes=_shapes(model, body),
    )


def _joint(model: mujoco.MjModel, joint: int) -> Joint:
    kind, entry = JOINT_NAMES[int(model.jnt_type[joint])], int(model.jnt_qposadr[joint])
    reference = float(model.qpos0[entry]) if kind in ("hinge", "slide") else 0.0
    return Joint(
        kind, entry, _numbers(model.jnt_axis[joint]), _numbers(model.jnt_pos[joint]), reference
    )


def _shapes(model: mujoco.MjModel, body: int) -> tuple[Shape, ...]:
    geoms = range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
    drawn = [
        geom
        for geom in geoms
        if model.geom_group[geom] < DRAWN_GROUPS and model.geom_rgba[geom][3] > 0
    ]
    return tuple(_shape(model, geom) for geom in drawn)


def _shape(model: mujoco.MjModel, geom: int) -> Shape:
    kind, size = SHAPES.get(int(model.geom_type[geom]), _bounding_box)(model, geom)
    position = np.array(model.geom_pos[geom])
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
        position[2] -= GROUND_THICKNESS
    return Shape(
        kind,
        size,
        _numbers(position),
        _numbers(model.geom_quat[geom]),
        _numbers(_colour(model, geom)),
    )


def _colour(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Return a geom's colour (4,); of a texture the mean, for triangles have none."""
    material = model.geom_matid[geom]
    if material < 0:
        return np.clip(model.geom_rgba[geom], 0, 1)
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
    colour = np.array(model.mat_rgba[material], float)
    if texture >= 0:
        colour[:3] *= _mean_texel(model, texture)
    return np.clip(colour, 0, 1)


def _mean_texel(model: mujoco.MjModel, texture: int) -> np.ndarray:
    """Return the mean colour (3,) of a texture, 0 to 1."""
    channels = int(model.tex_nchannel[texture])
    size = int(model.tex_height[texture]) * int(model.tex_width[texture])
    first = int(model.tex_adr[texture])
    texels = np.asarray(model.tex_data[first : first + size * channels]).reshape(size, channels)
    mean = texels.mean(axis=0) / 255
    return mean[:3] if channels >= 3 else np.repeat(mean[:1], 3)


def _as_is(kind: str) -> Callable[[mujoco.MjModel, int], tuple[str, tuple[float, ...]]]:
    return lambda model, geom: (kind, _numbers(model.geom_size[geom]))


def _plane(model: mujoco.MjModel, geom: int) -> tuple[str, tuple[float, ...]]:
    sides = [float(side) or MAX_GROUND for side in model.geom_size[geom][:2]]
    return "box", (*(min(side, MAX_GROUND) for side in sides), GROUND_THICKNESS)


def _bounding_box(model: mujoco.MjModel, geom: int) -> tuple[str, tuple[float, ...]]:
    """Meshes and height fields are drawn as their bounding boxes, to keep emulator files small."""
    return "box", _numbers(model.geom_aabb[geom][3:])


SHAPES = {
    int(mujoco.mjtGeom.mjGEOM_PLANE): _plane,
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): _as_is("capsule"),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): _as_is("cylinder"),
    int(mujoco.mjtGeom.mjGEOM_SPHERE): _as_is("sphere"),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): _as_is("ellipsoid"),
    int(mujoco.mjtGeom.mjGEOM_BOX): _as_is("box"),
}


def _numbers(values: np.ndarray) -> tuple[float, ...]:
    return tuple(round(float(value), 9) + 0.0 for value in values)
