"""A MuJoCo model with one soft body: the parts of its flex, and checks that name what is refused.

Each node of a flex is a separate body with slides along fixed axes, or belongs to a fixed body. So the positions of the
nodes are linear in the slides, and the slides in the positions:

    x = x₀ + Σ a q,    q = a · (x - x₀)
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float, Int

from neuroanimator.files.names import PART_PATTERN
from neuroanimator.physics.soft.soft_body import Points
from neuroanimator.state.shape_contacts import BoxCollider, RoundCollider
from neuroanimator.systems.model_xml import refuse
from neuroanimator.text import listed

ORTHONORMAL = 1e-6
"""Maximum dot product of two axes of a node's slides."""

LEVEL = 1 - 1e-6
"""Minimum dot product of two unit vectors that count as parallel."""

MAX_COLLIDERS = 8
"""Maximum number of a mover's geoms, the largest, with features for an emulator."""

MAX_MOVERS = 8
"""Maximum number of mocap bodies."""


Slides = Float[np.ndarray, " V"]
"""Values of the slides [m], or their rates [m/s]."""


@dataclass(frozen=True, eq=False)
class FlexBody:
    """A flex of N nodes and V slides."""

    positions: Points
    """Positions of the nodes with every slide at its reference [m]."""
    faces: Int[np.ndarray, "F 3"]
    """Corners of the surface's triangles, counterclockwise from outside; empty for a rope."""
    pairs: Int[np.ndarray, "E 2"]
    """The two nodes of each piece of a rope; empty for others."""
    masses: Float[np.ndarray, " N"]
    """Masses of the nodes' bodies [kg]; those of nodes of the world do not matter."""
    margin: float
    """Distance at which nodes touch colliders: the flex's radius [m]."""
    nodes: Int[np.ndarray, " V"]
    """The node each slide moves."""
    axes: Float[np.ndarray, "V 3"]
    """Direction of each slide."""
    reference: Slides
    """Value of each slide at its node's position."""

    def placed(self, slides: Slides) -> Points:
        """Return the positions of the nodes [m]."""
        return self.positions + self.moved(slides - self.reference)

    def moved(self, changes: Slides) -> Points:
        """Return the displacements of the nodes [m], or their velocities [m/s], for these changes or rates of slides."""
        away = np.zeros(self.positions.shape)
        np.add.at(away, self.nodes, changes[:, None] * self.axes)
        return away

    def slides(self, positions: Points) -> Slides:
        """Return the slides that bring nodes closest to `positions`."""
        return self.reference + self.rates(positions - self.positions)

    def rates(self, velocities: Points) -> Slides:
        """Return the rates of the slides of nodes with these `velocities`."""
        return np.einsum("va,va->v", velocities[self.nodes], self.axes)


def flex_body(main: str, model: mujoco.MjModel) -> FlexBody:
    """Return the flex of a model; BadFileError names what is not supported in the file `main`, and what to do."""
    _check_parts(main, model)
    data = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, data)
    bodies = np.array(model.flex_vertbodyid)
    _check_holders(main, model, bodies)
    nodes = []
    for joint in range(model.njnt):
        nodes.append(int(np.flatnonzero(bodies == model.jnt_bodyid[joint])[0]))
    axes = np.array(data.xaxis)
    for joint in range(1, model.njnt):
        for other in range(max(0, joint - 2), joint):
            same = nodes[other] == nodes[joint]
            if same and abs(float(axes[other] @ axes[joint])) > ORTHONORMAL:
                refuse(
                    main,
                    _name_of(model, nodes[joint]),
                    "slides of a node are not at right angles. Turn their axes",
                )
    faces = np.zeros((0, 3), int)
    pairs = np.zeros((0, 2), int)
    if model.flex_dim[0] == 1:
        pairs = np.reshape(model.flex_elem, (-1, 2)).astype(int)
    elif model.flex_dim[0] == 2:
        faces = np.reshape(model.flex_elem, (-1, 3)).astype(int)
    else:
        faces = np.reshape(model.flex_shell, (-1, 3)).astype(int)
    return FlexBody(
        np.array(data.flexvert_xpos),
        faces,
        pairs,
        np.array(model.body_mass[bodies]),
        float(model.flex_radius[0]),
        np.array(nodes),
        axes,
        np.array(model.qpos0),
    )


def _check_parts(main: str, model: mujoco.MjModel) -> None:
    """Refuse a model whose flex is not the only thing that moves by itself, or a flex of another kind."""
    if model.nflex != 1:
        refuse(main, "flex", f"{model.nflex} soft bodies; one is supported. Leave one in the model")
    if model.flex_rigid[0] or model.njnt == 0:
        refuse(main, "flex", "every node of it is fixed. Pin fewer, and leave out rigid")
    if model.flex_interp[0]:
        refuse(
            main,
            "flex",
            'nodes that follow a coarser grid are not supported. Leave out dof="trilinear" or "quadratic"',
        )
    if model.nu:
        refuse(
            main,
            "actuator",
            "a model with a soft body is moved by mocap bodies alone. Take the actuators out",
        )
    if not 0 < model.nmocap <= MAX_MOVERS:
        refuse(
            main,
            "worldbody",
            f'{model.nmocap} mocap bodies to be moved; wanted 1 to {MAX_MOVERS}. Write <body name="hand" mocap="true"> with a '
            "geom, which strikes the soft body, or an equality (connect) that carries it",
        )


def _check_holders(main: str, model: mujoco.MjModel, bodies: Int[np.ndarray, " N"]) -> None:
    """Refuse nodes that move other than by their own slides, and joints of other things."""
    others = np.setdiff1d(model.jnt_bodyid, bodies)
    if len(others):
        names = listed([model.body(int(body)).name or f"body {body}" for body in others[:3]])
        refuse(
            main, names, "moves by joints, beside the soft body. Make it a mocap body, or fix it"
        )
    counts = np.bincount(bodies, minlength=model.nbody)
    for node, body in enumerate(bodies.tolist()):
        joints = _joints_of(model, body)
        is_slide = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE
        if not is_slide.all() or (len(joints) > 0 and counts[body] > 1):
            refuse(
                main,
                _name_of(model, node),
                "a node of the soft body is attached to a body that moves. Pin it to the world, or let an equality (connect) tie "
                "it to a mocap body",
            )
        above = body if len(joints) == 0 else int(model.body_parentid[body])
        if model.body_weldid[above] != 0 or model.body_mocapid[model.body_rootid[above]] >= 0:
            refuse(
                main,
                _name_of(model, node),
                "the soft body lies inside a body that moves, where its nodes would be carried along without inertia. Put it "
                "into the world, and let an equality (connect) tie nodes to a mocap body",
            )


def _joints_of(model: mujoco.MjModel, body: int) -> Int[np.ndarray, " J"]:
    first = int(model.body_jntadr[body])
    return np.arange(first, first + int(model.body_jntnum[body]))


def _name_of(model: mujoco.MjModel, node: int) -> str:
    flex = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, 0) or "flex"
    return f"{flex}, node {node}"


def mover_names(model: mujoco.MjModel) -> dict[str, int]:
    """Return the mocap bodies of a model by name; one without a valid name is called `mover` with a number."""
    names: dict[str, int] = {}
    for body in mocap_bodies(model):
        name = model.body(body).name
        if not re.fullmatch(PART_PATTERN, name):
            name = f"mover{model.body_mocapid[body] + 1}"
        names[name] = body
    return names


def mocap_bodies(model: mujoco.MjModel) -> list[int]:
    """Return the mocap bodies of a model in the order of their numbers."""
    bodies = np.flatnonzero(model.body_mocapid >= 0)
    return [int(body) for body in bodies[np.argsort(model.body_mocapid[bodies])]]


def is_pinned(model: mujoco.MjModel) -> bool:
    """Return whether a node of the flex belongs to the world."""
    return 0 in model.body_weldid[model.flex_vertbodyid]


def tied_bodies(model: mujoco.MjModel) -> set[int]:
    """Return the bodies to which a connect or weld ties nodes: mocap bodies, and 0 for the world."""
    nodes = set(model.flex_vertbodyid.tolist())
    tied = set()
    for equality in range(model.neq):
        others = [body for body in _bodies_of(model, equality) if body not in nodes]
        if len(others) == 1:
            tied.add(int(model.body_rootid[others[0]]))
    return tied


def _bodies_of(model: mujoco.MjModel, equality: int) -> list[int]:
    """Return the two bodies that a connect or weld ties together; empty for another equality."""
    kinds = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
    if int(model.eq_type[equality]) not in kinds:
        return []
    ends = [int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])]
    if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
        return [int(model.site_bodyid[site]) for site in ends]
    return ends


def geoms_below(model: mujoco.MjModel, root: int) -> list[int]:
    """Return the geoms of a child of the world and of bodies fixed to it; those of the world for 0."""
    found = []
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        top = int(model.body_rootid[body])
        is_mocap = model.body_mocapid[top] >= 0
        if (top == root and is_mocap) or (
            root == 0 and not is_mocap and model.body_weldid[body] == 0
        ):
            found.append(geom)
    return found


def can_strike(model: mujoco.MjModel, geom: int) -> bool:
    """Return whether a geom and the flex may touch, by their contype and conaffinity."""
    mine = int(model.geom_contype[geom]) & int(model.flex_conaffinity[0])
    other = int(model.flex_contype[0]) & int(model.geom_conaffinity[geom])
    return bool(mine or other)


def harden(model: mujoco.MjModel, contact_time: float) -> None:
    """Set the time constant [s] of the flex's contacts with mocap bodies, and of ties to them; 0 leaves them.

    To MuJoCo, mocap bodies do not move: nodes they push trail them by about twice the constant times their speed, and so
    do nodes that a tie pulls.
    """
    if contact_time == 0:
        return
    solref = (contact_time, 1.0)  # critically damped, as is MuJoCo's default
    model.flex_solref[0] = solref
    for body in mocap_bodies(model):
        model.geom_solref[geoms_below(model, body)] = solref
    for equality in range(model.neq):
        if _bodies_of(model, equality):
            model.eq_solref[equality] = solref


def thicknesses(model: mujoco.MjModel) -> Float[np.ndarray, " G"]:
    """Return the smallest extent of the bounding box of each geom [m]."""
    return 2 * np.array(model.geom_aabb)[:, 3:].min(axis=1)


def ground_height(model: mujoco.MjModel, data: mujoco.MjData) -> float | None:
    """Return the height of the highest level plane that the flex may touch [m]; None if there is none."""
    heights = []
    for geom in geoms_below(model, 0):
        is_plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
        if is_plane and can_strike(model, geom) and data.geom_xmat[geom][8] > LEVEL:
            heights.append(float(data.geom_xpos[geom][2]))
    return max(heights, default=None)


def colliders_of(
    model: mujoco.MjModel, data: mujoco.MjData, body: int, mover: int, margin: float
) -> list[RoundCollider | BoxCollider]:
    """Return the parts of a mocap body that may strike the flex, as colliders of the `mover` with this number.

    `data` has all geoms at rest. At most `MAX_COLLIDERS`, the largest, are taken.
    """
    geoms = [geom for geom in geoms_below(model, body) if can_strike(model, geom)]
    geoms.sort(key=lambda geom: -float(model.geom_rbound[geom]))
    colliders = []
    for geom in geoms[:MAX_COLLIDERS]:
        colliders.append(_collider(model, data, geom, mover, margin))
    return colliders


def _collider(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, mover: int, margin: float
) -> RoundCollider | BoxCollider:
    """Return a geom as a sphere, capsule or box, or its bounding box; for a tilted box, the capsule around it."""
    size = np.array(model.geom_size[geom])
    axes = np.reshape(data.geom_xmat[geom], (3, 3))
    root = int(model.body_rootid[model.geom_bodyid[geom]])
    middle = data.geom_xpos[geom] - data.xpos[root]
    kind = int(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return RoundCollider(mover, _point(middle), (0.0, 0.0, 0.0), float(size[0]) + margin)
    if kind in (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER)):
        half = size[1] * axes[:, 2]
        radius = float(size[0])
    else:
        box = np.array(model.geom_aabb[geom])
        middle = middle + axes @ box[:3]
        halves = box[3:]
        if np.abs(axes).max(axis=0).min() > LEVEL:
            upright = np.abs(axes) @ halves
            return BoxCollider(mover, _point(middle), _point(upright), margin)
        longest = int(halves.argmax())
        radius = float(np.linalg.norm(np.delete(halves, longest)))
        half = halves[longest] * axes[:, longest]
    return RoundCollider(mover, _point(middle - half), _point(2 * half), radius + margin)


def _point(vector: Float[np.ndarray, " 3"]) -> tuple[float, ...]:
    return tuple(vector.tolist())
