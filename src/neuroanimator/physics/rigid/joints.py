"""The joints of a MuJoCo model: their state layout, and the structure an emulator may use."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from neuroanimator.definitions.model import FrameTable
from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_known, model_name, refuse_twins
from neuroanimator.physics.rigid.bones import joint_kind, joints_of_body
from neuroanimator.state.layout import Layout, Slice
from neuroanimator.state.parameters import Parameter
from neuroanimator.state.segments import (
    Constant,
    Heading,
    Plain,
    PlanarPosition,
    PlanarVelocity,
    Position,
    Quaternion,
    Segment,
    Velocity,
)
from neuroanimator.state.structure import Structure

FEATURES = {
    "hinge": ("sine", "plain", "cyclic", "planar"),
    "slide": ("plain", "cyclic", "planar"),
    "ball": ("ball",),
    "free": ("free", "placed"),
}
"""Possible features of each kind of joint, the proposed one first.

Position and heading of a `free` joint do not matter; those of a `placed` one do, as other things stand around.
"""

POSITIONS = {
    "free": (Slice(".position", 3, "m"), Slice(".orientation", 4, "quaternion")),
    "ball": (Slice(".orientation", 4, "quaternion"),),
    "slide": (Slice("", 1, "m"),),
    "hinge": (Slice("", 1, "rad"),),
}
"""Parts of the position of each kind of joint, named by what follows the joint's name."""

VELOCITIES = {
    "free": (Slice(".velocity", 3, "m/s"), Slice(".angular_velocity", 3, "rad/s")),
    "ball": (Slice(".angular_velocity", 3, "rad/s"),),
    "slide": (Slice(".velocity", 1, "m/s"),),
    "hinge": (Slice(".velocity", 1, "rad/s"),),
}
"""Parts of its velocity."""


@dataclass(frozen=True)
class JointView:
    """One joint, its entries in the state, and its feature."""

    index: int
    """Number of the joint in the model."""
    name: str
    kind: str
    """MuJoCo's name of its type: hinge, slide, ball or free."""
    feature: str
    """Its feature for a network: one of `FEATURES` of its kind."""
    position_entry: int
    """First state entry of its position."""
    velocity_entry: int
    """First state entry of its velocity."""

    @property
    def positions(self) -> range:
        """State entries of its position."""
        size = sum(part.size for part in POSITIONS[self.kind])
        return range(self.position_entry, self.position_entry + size)

    @property
    def velocities(self) -> range:
        """State entries of its velocity."""
        size = sum(part.size for part in VELOCITIES[self.kind])
        return range(self.velocity_entry, self.velocity_entry + size)


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return the name of a joint; `joint_3` if it has none."""
    return model_name(model.joint(joint).name, f"joint_{joint}")


def sensor_name(model: mujoco.MjModel, sensor: int) -> str:
    """Return the name of a sensor; empty if it has none, in which case it cannot be requested."""
    return model_name(model.sensor(sensor).name, "")


def sensor_numbers(model: mujoco.MjModel, names: tuple[str, ...]) -> list[int]:
    """Return the numbers in the model of the sensors called `names`; ArgumentError lists the existing ones."""
    known = [sensor_name(model, i) for i in range(model.nsensor)]
    check_known(names, filter(None, known), "sensor", "sensors")
    return [known.index(name) for name in names]


def joint_views(
    model: mujoco.MjModel, features: dict[str, str], planar: tuple[str, ...] = ()
) -> list[JointView]:
    """Return the joints in the model's order.

    `features` gives features by joint name; other joints take the first of their kind's `FEATURES`, a free one that is
    not alone `placed`. `planar` names the three joints of a root in the plane.
    Raises ArgumentError for a feature a joint cannot have, an unknown joint, and planar joints out of order.
    """
    views = []
    free_joints = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    has_one_root = free_joints.tolist() == [0]
    for joint in range(model.njnt):
        kind = joint_kind(model, joint)
        name = joint_name(model, joint)
        is_planar = name in planar
        feature = features.get(name) or FEATURES[kind][0]
        if kind == "free" and name not in features and not has_one_root:
            feature = "placed"
        if is_planar:
            feature = "planar"
        if feature not in FEATURES[kind] or (feature == "planar") != is_planar:
            valid = ", ".join(feature for feature in FEATURES[kind] if feature != "planar")
            raise ArgumentError(
                f"state.{name}: a {kind} joint cannot be '{feature}'. Features: {valid}."
            )
        view = JointView(
            index=joint,
            name=name,
            kind=kind,
            feature=feature,
            position_entry=int(model.jnt_qposadr[joint]),
            velocity_entry=model.nq + int(model.jnt_dofadr[joint]),
        )
        views.append(view)
    check_known([*features, *planar], [view.name for view in views], "joint")
    _check_root(views, planar)
    return views


def _check_root(views: list[JointView], planar: tuple[str, ...]) -> None:
    roots = [view.name for view in views if view.kind == "free"]
    for view in views:
        if view.feature == "free" and (len(roots) > 1 or view.index > 0):
            raise ArgumentError(
                f"state.{view.name}: 'free' says that it does not matter where the body stands, so it must be the first joint, "
                "and the only free one. Use 'placed'."
            )
    if planar and not _is_planar_root(views, planar):
        raise ArgumentError(
            "frame.planar: wanted three joints x, y, heading, of which x and y follow each other."
        )


def _is_planar_root(views: list[JointView], planar: tuple[str, ...]) -> bool:
    if len(planar) != 3 or any(view.kind == "free" for view in views):
        return False
    names = [view.name for view in views]
    return names[names.index(planar[0]) + 1] == planar[1]


def state_layout(
    model: mujoco.MjModel,
    views: list[JointView],
    sensors: tuple[str, ...] = (),
    parameters: tuple[Parameter, ...] = (),
) -> Layout:
    """Return the named parts of (qpos, qvel, act, sensors, parameters); ArgumentError if two have one name."""
    parts: list[Slice] = []
    for parts_of_kind in (POSITIONS, VELOCITIES):
        for view in views:
            for part in parts_of_kind[view.kind]:
                parts.append(replace(part, name=view.name + part.name))
    if model.na:
        parts.append(Slice("activation", model.na, "1"))
    for name, number in zip(sensors, sensor_numbers(model, sensors), strict=True):
        parts.append(Slice(f"sensor.{name}", int(model.sensor_dim[number]), "1"))
    parts += [parameter.slice for parameter in parameters]
    refuse_twins((part.name for part in parts), "joints and parameters")
    return Layout(tuple(parts))


def structure_of(
    model: mujoco.MjModel,
    views: list[JointView],
    frame: FrameTable,
    control: Layout,
    size: int,
    parameters: int = 0,
) -> Structure:
    """Return the structure for an emulator of `model` with states of `size` entries, the last of them parameters.

    Raises ArgumentError for a rotational symmetry of a body that has more joints than a free one.
    """
    if frame.symmetry_order > 1 and [view.feature for view in views] != ["free"]:
        raise ArgumentError(
            "frame.symmetry_order: only a body whose one joint is free may have such a symmetry."
        )
    symmetry_controls = []
    for x, y in frame.symmetry_controls:
        symmetry_controls.append((control.index(x).start, control.index(y).start))
    plain = _plain_entries(model, views, frame.ground)
    plain += range(size - parameters, size)
    return Structure(
        angles=tuple(_angle_rows(model, views, size)),
        rates=tuple(_rates(views)),
        plain=tuple(plain),
        segments=_segments(views, frame.planar, size, parameters),
        probes=frame.probes,
        symmetry_order=frame.symmetry_order,
        symmetry_controls=tuple(symmetry_controls),
    )


def _rates(views: list[JointView]) -> list[tuple[int, int]]:
    """Return the pairs of state entries in which the second is the rate of change of the first."""
    pairs: list[tuple[int, int]] = []
    for view in views:
        if view.kind != "ball":  # an orientation's rate of change is not a state entry
            pairs += zip(view.positions[:3], view.velocities[:3], strict=True)
    return pairs


def _plain_entries(model: mujoco.MjModel, views: list[JointView], has_ground: bool) -> list[int]:
    """Return the state entries that are features themselves; a free root's velocity is given along its own axes instead."""
    entries = [view.position_entry for view in views if view.feature == "plain"]
    if views[0].feature == "free" and has_ground:
        height = views[0].position_entry + 2
        entries.append(height)
    for view in views:
        if view.feature == "placed":
            entries += [*view.positions[:3], *view.velocities]
        elif view.kind == "free":
            entries += view.velocities[3:]
        elif not (view.kind == "slide" and view.feature == "planar"):
            entries += view.velocities
    activations = model.nq + model.nv
    entries += range(activations, activations + model.na)
    return entries


def _angle_rows(model: mujoco.MjModel, views: list[JointView], size: int) -> list[tuple[int, ...]]:
    """Return, as rows of `size` factors, each sine hinge's angle, and its sum with those of parallel hinges above it.

    Gravity acts on the sum.
    """
    hinges = {view.index: view for view in views if view.feature == "sine"}
    rows: list[tuple[int, ...]] = []
    for view in hinges.values():
        alone = np.zeros(size, int)
        alone[view.position_entry] = 1
        chain = alone.copy()
        for above in _parallel_above(model, view, hinges):
            chain[above.position_entry] = 1
        rows.append(tuple(alone.tolist()))
        rows.append(tuple(chain.tolist()))
    return list(dict.fromkeys(rows))  # without duplicates


def _parallel_above(
    model: mujoco.MjModel, view: JointView, hinges: dict[int, JointView]
) -> list[JointView]:
    """Return the hinges on the bodies above that of `view` with an axis parallel to its own."""
    axis = model.jnt_axis[view.index]
    parallel: list[JointView] = []
    body = int(model.body_parentid[model.jnt_bodyid[view.index]])
    while body:
        for joint in joints_of_body(model, body):
            above = hinges.get(joint)
            if above and np.allclose(model.jnt_axis[joint], axis):
                parallel.append(above)
        body = int(model.body_parentid[body])
    return parallel


def _segments(
    views: list[JointView], planar: tuple[str, ...], size: int, parameters: int
) -> tuple[Segment, ...]:
    """Return the segments of the state, in order; empty for a state of plain numbers."""
    has_plain_joints_only = all(view.kind in ("hinge", "slide") for view in views)
    if has_plain_joints_only and not planar and not parameters:
        return ()
    of_joints = [_segments_of(view, planar) for view in views]
    segments = [segment for positions, _ in of_joints for segment in positions]
    segments += [segment for _, velocities in of_joints for segment in velocities]
    moving = size - parameters
    rest = moving - sum(segment.size for segment in segments)  # activations and sensors
    segments.append(Plain(size=rest))
    segments.append(Constant(size=parameters))
    return tuple(_merged(segments))


def _segments_of(view: JointView, planar: tuple[str, ...]) -> tuple[list[Segment], list[Segment]]:
    """Return the segments of a joint's position and of its velocity; `planar` names x, y and heading of a root in the plane."""
    rate = view.velocity_entry
    if view.feature == "placed":
        return [Plain(size=3), Quaternion(rate=rate + 3)], [Plain(size=6)]
    if view.kind == "free":
        return [Position(rate=rate), Quaternion(rate=rate + 3)], [Velocity(), Plain(size=3)]
    if view.kind == "ball":
        return [Quaternion(rate=rate)], [Plain(size=3)]
    if view.name in planar[:1]:
        return [PlanarPosition(rate=rate)], [PlanarVelocity()]
    if view.name in planar[1:2]:
        return [], []  # the segments of x cover both
    if view.name in planar[2:]:
        return [Heading(rate=rate)], [Plain(size=1)]
    return [Plain(size=1)], [Plain(size=1)]


def _merged(parts: list[Segment]) -> list[Segment]:
    """Return `parts` with neighbouring plain segments joined, for fewer copies at every step."""
    joined: list[Segment] = []
    for part in parts:
        if joined and isinstance(part, Plain) and isinstance(joined[-1], Plain):
            joined[-1] = Plain(size=joined[-1].size + part.size)
        elif part.size:
            joined.append(part)
    return joined
