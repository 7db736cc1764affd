"""Points of a MuJoCo model that may touch the ground, and joints that may reach their stops, from its own geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.appearance.skeleton import Bone, kinematics_of
from neuroanimator.physics.rigid.joints import JointView
from neuroanimator.physics.rigid.rows import rows_at
from neuroanimator.physics.rigid.touching import is_limited, touching_geoms
from neuroanimator.state.contacts import (
    MAX_PLANES,
    ContactPoint,
    Contacts,
    JointStop,
    Plane,
    in_order,
)
from neuroanimator.state.layout import Pairs
from neuroanimator.state.segments import Segment, orientations_of

MAX_POINTS = 24
"""Maximum number of points: more cost more than they help."""

POSES = 16
"""Number of poses in which points are examined, drawn from `SEED`."""

SEED = 0

POSE_SPREAD = 0.7
"""Spread of these poses about the reference pose [rad or m]."""

MIN_MOVED = 1e-6
"""Motion over all poses below which a point does not move [m]."""

MIN_RADIUS = 1e-3
"""Distance, unless a radius is larger, within which points in all poses are one [m]."""

RIM = 4
"""Number of points of a cylinder's rim."""

PLACELESS = ("cyclic", "planar")
"""Features of joints whose position does not matter."""

Balls = list[tuple[Float[np.ndarray, " 3"], float]]
"""Centres in the frame of a geom [m], and radii [m]."""


def contacts_of(
    model: mujoco.MjModel,
    bones: tuple[Bone, ...],
    views: list[JointView],
    rates: Pairs,
    segments: tuple[Segment, ...],
) -> Contacts | None:
    """Return the possible contacts of the model, whose skeleton has these `bones`, with fixed planes and stops; None if there
    are none.

    Of points that always move together only one is kept, and points whose height never changes are left out.
    """
    kinematics = kinematics_of(bones)
    points = _points(model, first_body=model.nbody - len(bones))
    planes = _planes(model)
    contacts = Contacts(
        kinematics=kinematics,
        points=in_order(points, kinematics),
        planes=tuple(planes),
        stops=tuple(_stops(model, views)),
        axes=(0, 1, 2),
        placeless=tuple(_placeless(views, planes)),
        rates=rates,
        orientations=orientations_of(segments),
    )
    if contacts.points:
        contacts = _without_what_never_moves(contacts, _poses(model))
    return contacts if contacts.size else None


def _planes(model: mujoco.MjModel) -> list[Plane]:
    """Return the fixed planes that something can touch."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    planes = []
    for geom in _fixed_planes(model):
        normal = data.geom_xmat[geom].reshape(3, 3)[:, 2]
        offset = float(normal @ data.geom_xpos[geom])
        planes.append(Plane(*normal.tolist(), offset=offset))
    return planes[:MAX_PLANES]


def _fixed_planes(model: mujoco.MjModel) -> list[int]:
    geoms = np.unique(touching_geoms(model))
    is_plane = model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_PLANE
    is_fixed = model.body_weldid[model.geom_bodyid[geoms]] == 0
    return geoms[is_plane & is_fixed].tolist()


def _points(model: mujoco.MjModel, first_body: int) -> list[ContactPoint]:
    """Return the points of all geoms that can touch a fixed plane; `first_body` is the body that is link 0."""
    planes = _fixed_planes(model)
    points = []
    for pair in touching_geoms(model).tolist():
        if not {*pair} & {*planes}:
            continue
        [geom] = [geom for geom in pair if geom not in planes]
        body = int(model.geom_bodyid[geom])
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        of_type = BALLS.get(int(model.geom_type[geom]), _corners)
        for centre, radius in of_type(model, geom):
            place = model.geom_pos[geom] + rotation.reshape(3, 3) @ centre
            points.append(ContactPoint(body - first_body, *place.tolist(), radius=radius))
    return points


def _sphere(model: mujoco.MjModel, geom: int) -> Balls:
    return [(np.zeros(3), float(model.geom_size[geom][0]))]


def _capsule(model: mujoco.MjModel, geom: int) -> Balls:
    radius, half_length, _ = model.geom_size[geom]
    return [(np.array([0, 0, end * half_length]), float(radius)) for end in (-1, 1)]


def _cylinder(model: mujoco.MjModel, geom: int) -> Balls:
    radius, half_length, _ = model.geom_size[geom]
    rim = []
    for end, angle in product((-1, 1), 2 * np.pi * np.arange(RIM) / RIM):
        rim.append(np.array([radius * np.cos(angle), radius * np.sin(angle), end * half_length]))
    return [(point, 0.0) for point in rim]


def _ellipsoid(model: mujoco.MjModel, geom: int) -> Balls:
    axes = np.diag(model.geom_size[geom])
    return [(end * axis, 0.0) for end in (-1, 1) for axis in axes]


def _mesh(model: mujoco.MjModel, geom: int) -> Balls:
    """Return the mesh's outermost vertices towards the corners of a cube, and along its axes."""
    mesh = int(model.geom_dataid[geom])
    rows = rows_at(model.mesh_vertadr[mesh], model.mesh_vertnum[mesh])
    vertices = np.array(model.mesh_vert[rows], float)
    directions = np.array(list(product((-1, 0, 1), repeat=3)), float)
    outermost = np.unique(np.argmax(vertices @ directions.T, axis=0))
    return [(vertices[vertex], 0.0) for vertex in outermost]


def _corners(model: mujoco.MjModel, geom: int) -> Balls:
    """Return the corners of the geom's bounding box, or of a box itself."""
    centre, half = np.array(model.geom_aabb[geom], float).reshape(2, 3)
    return [(centre + half * signs, 0.0) for signs in product((-1, 1), repeat=3)]


BALLS: dict[int, Callable[[mujoco.MjModel, int], Balls]] = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): _sphere,
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): _capsule,
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): _cylinder,
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): _ellipsoid,
    int(mujoco.mjtGeom.mjGEOM_MESH): _mesh,
}
"""Functions that return the balls that touch a plane, by MuJoCo's type of geom; for others the corners of the bounding box."""


def _stops(model: mujoco.MjModel, views: list[JointView]) -> list[JointStop]:
    """Return the ranges of the joints that have one."""
    stops = []
    for view in views:
        is_seen = view.kind in ("hinge", "slide") and view.feature not in PLACELESS
        if is_seen and is_limited(model, view.index):
            low, high = model.jnt_range[view.index].tolist()
            stops.append(JointStop(view.position_entry, low, high))
    return stops


def _placeless(views: list[JointView], planes: list[Plane]) -> list[int]:
    """Return the state entries of positions that do not matter: those of free joints unless there are walls."""
    is_level = all(plane.z == 1 for plane in planes)
    entries = []
    for view in views:
        if view.kind == "free" and is_level:
            entries += [view.position_entry, view.position_entry + 1]
        elif view.feature in PLACELESS:
            entries.append(view.position_entry)
    return entries


def _poses(model: mujoco.MjModel) -> Float[np.ndarray, "N S"]:
    """Return states in random poses, at random velocities."""
    rng = np.random.default_rng(SEED)
    poses = np.zeros((POSES, model.nq + model.nv))
    for pose in poses:
        positions = np.array(model.qpos0)
        mujoco.mj_integratePos(model, positions, rng.uniform(-1, 1, model.nv), POSE_SPREAD)
        pose[: model.nq] = positions
        pose[model.nq :] = rng.normal(size=model.nv)
    return poses


def _without_what_never_moves(contacts: Contacts, poses: Float[np.ndarray, "N S"]) -> Contacts:
    """Return `contacts` without points of constant height, duplicate points, and axes along which none moves."""
    centres = contacts.centres(poses)
    heights = contacts.heights(centres).reshape(len(poses), len(contacts.planes), -1)
    moves = (np.ptp(heights, axis=0) > MIN_MOVED).any(axis=0)
    kept = _distinct(contacts, centres, moves)
    contacts = replace(contacts, points=tuple(contacts.points[point] for point in kept))
    if not kept:
        return replace(contacts, planes=())
    way = contacts.centres(contacts.coasted(poses, 1.0)) - contacts.centres(poses)
    axes = np.flatnonzero(np.abs(way).max(axis=(0, 2)) > MIN_MOVED)
    return replace(contacts, axes=tuple(axes.tolist()))


def _distinct(
    contacts: Contacts, centres: Float[np.ndarray, "N 3 P"], moves: Bool[np.ndarray, " P"]
) -> list[int]:
    """Return the points that move and do not always coincide with another, the outermost first."""
    left = np.flatnonzero(moves).tolist()
    kept: list[int] = []
    while left and len(kept) < MAX_POINTS:
        farthest = max(left, key=lambda point: _distance(centres, point, kept))
        left.remove(farthest)
        own_radius = max(contacts.points[farthest].radius, MIN_RADIUS)
        if not kept or _distance(centres, farthest, kept) >= own_radius:
            kept.append(farthest)
    return sorted(kept)


def _distance(centres: Float[np.ndarray, "N 3 P"], point: int, others: list[int]) -> float:
    """Return the distance of a point from the nearest of `others`, each in the pose of the largest distance [m]."""
    if not others:
        middle = centres.mean(axis=2)
        return float(np.linalg.norm(centres[:, :, point] - middle, axis=1).max())
    apart = np.linalg.norm(centres[:, :, others] - centres[:, :, point, None], axis=1)
    return float(apart.max(axis=0).min())
