"""From a MuJoCo model's joints to layouts and structure."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from neuroanimator.definitions.model import FrameTable
from neuroanimator.errors import ArgumentError
from neuroanimator.parsing.names import model_name
from neuroanimator.state.layout import Layout, Slice
from neuroanimator.state.segments import (
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
from neuroanimator.systems.rigid.bones import JOINT_NAMES
from neuroanimator.text import quoted

FEATURES = {
    "hinge": ("sine", "plain", "cyclic", "planar"),
    "slide": ("plain", "cyclic", "planar"),
    "ball": ("ball",),
    "free": ("free",),
}
"""The features each kind of joint may be represented by, the proposed one first."""


@dataclass(frozen=True)
class JointView:
    """One joint, where it is in the state, and by what it is represented."""

    index: int
    """Its number in the model."""
    name: str
    kind: str
    feature: str
    position_entry: int
    """State entry where its position begins."""
    rate: int
    """State entry where its velocity begins."""


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return what a joint is called; `joint_3` if the model does not say."""
    return model_name(model.joint(joint).name, f"joint_{joint}")


def sensor_name(model: mujoco.MjModel, sensor: int) -> str:
    """Return what a sensor is called; empty if the model does not say, for then it cannot be asked for."""
    return model_name(model.sensor(sensor).name, "")


def sensor_numbers(model: mujoco.MjModel, names: tuple[str, ...]) -> list[int]:
    """Return the numbers in the model of the sensors called `names`; ArgumentError lists those there are."""
    known = [sensor_name(model, i) for i in range(model.nsensor)]
    for name in names:
        if name not in known:
            listed = ", ".join(filter(None, known)) or "none"
            raise ArgumentError(f"sensors: no sensor called {quoted(name)}. Sensors: {listed}.")
    return [known.index(name) for name in names]


def joint_views(
    model: mujoco.MjModel, features: dict[str, str], planar: tuple[str, ...] = ()
) -> list[JointView]:
    """Return the joints in the model's order.

    `features` names what represents each, the first of its kind's `FEATURES` if it is not there.
    """
    views = []
    for joint in range(model.njnt):
        kind = JOINT_NAMES[int(model.jnt_type[joint])]
        name = joint_name(model, joint)
        is_planar = name in planar
        feature = features.get(name) or FEATURES[kind][0]
        if is_planar:
            feature = "planar"
        if feature not in FEATURES[kind] or (feature == "planar") != is_planar:
            valid = ", ".join(way for way in FEATURES[kind] if way != "planar")
            raise ArgumentError(
                f"state.{name}: a {kind} joint cannot be '{feature}'. Ways: {valid}."
            )
        rate = model.nq + int(model.jnt_dofadr[joint])
        views.append(JointView(joint, name, kind, feature, int(model.jnt_qposadr[joint]), rate))
    _check(views, features, planar)
    return views


def _check(views: list[JointView], features: dict[str, str], planar: tuple[str, ...]) -> None:
    names = [view.name for view in views]
    for name in [*features, *planar]:
        if name not in names:
            raise ArgumentError(f"No joint called '{name}'. Joints: {', '.join(names)}.")
    if any(view.kind == "free" for view in views[1:]):
        raise ArgumentError(
            "A free joint must be the model's first joint, and the only free one. Fix the other bodies in place."
        )
    if planar and (
        len(planar) != 3
        or names[names.index(planar[0]) + 1] != planar[1]
        or views[0].kind == "free"
    ):
        raise ArgumentError(
            "frame.planar: wanted three joints x, y, heading, of which x and y follow each other."
        )


def state_layout(
    model: mujoco.MjModel, views: list[JointView], sensors: tuple[str, ...] = ()
) -> Layout:
    """Return the named parts of (qpos, qvel, act, sensors)."""
    positions = [part for view in views for part in _position_slices(view)]
    rates = [part for view in views for part in _rate_slices(view)]
    activation = [Slice("activation", model.na, "1")] if model.na else []
    numbered = zip(sensors, sensor_numbers(model, sensors), strict=True)
    sensed = [
        Slice(f"sensor.{name}", int(model.sensor_dim[number]), "1") for name, number in numbered
    ]
    parts = [*positions, *rates, *activation, *sensed]
    names = [part.name for part in parts]
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(
                f"Two parts of the state would be called '{name}'. Rename one of the joints."
            )
    return Layout(tuple(parts))


def _position_slices(view: JointView) -> list[Slice]:
    return {
        "free": [
            Slice(f"{view.name}.position", 3, "m"),
            Slice(f"{view.name}.orientation", 4, "quaternion"),
        ],
        "ball": [Slice(f"{view.name}.orientation", 4, "quaternion")],
        "slide": [Slice(view.name, 1, "m")],
        "hinge": [Slice(view.name, 1, "rad")],
    }[view.kind]


def _rate_slices(view: JointView) -> list[Slice]:
    return {
        "free": [
            Slice(f"{view.name}.velocity", 3, "m/s"),
            Slice(f"{view.name}.angular_velocity", 3, "rad/s"),
        ],
        "ball": [Slice(f"{view.name}.angular_velocity", 3, "rad/s")],
        "slide": [Slice(f"{view.name}.velocity", 1, "m/s")],
        "hinge": [Slice(f"{view.name}.velocity", 1, "rad/s")],
    }[view.kind]


def structure_of(
    model: mujoco.MjModel, views: list[JointView], frame: FrameTable, control: Layout, size: int
) -> Structure:
    """Return what an emulator of `model` with states of `size` entries may exploit."""
    if frame.symmetry_order > 1 and [view.kind for view in views] != ["free"]:
        raise ArgumentError(
            "frame.symmetry_order: only a body whose one joint is free may have such a symmetry."
        )
    rates = [
        (v.position_entry + i, v.rate + i)
        for v in views
        for i in range({"free": 3, "ball": 0}.get(v.kind, 1))
    ]
    return Structure(
        angles=tuple(_angle_rows(model, views, size)),
        rates=tuple(rates),
        plain=tuple(_plain(model, views, frame.ground)),
        segments=_segments(views, frame.planar, size),
        probes=frame.probes,
        symmetry_order=frame.symmetry_order,
        symmetry_controls=tuple(
            (control.index(x).start, control.index(y).start) for x, y in frame.symmetry_controls
        ),
    )


def _plain(model: mujoco.MjModel, views: list[JointView], ground: bool) -> list[int]:
    """Return the state entries seen as they are; a free root's velocity is seen along its own axes instead."""
    entries = [view.position_entry for view in views if view.feature == "plain"]
    entries += [views[0].position_entry + 2] if views[0].kind == "free" and ground else []
    for view in views:
        if view.kind == "slide" and view.feature == "planar":
            continue
        sizes = {"free": range(3, 6), "ball": range(3)}
        entries += [view.rate + i for i in sizes.get(view.kind, range(1))]
    return entries + [model.nq + model.nv + i for i in range(model.na)]


def _angle_rows(model: mujoco.MjModel, views: list[JointView], size: int) -> list[tuple[int, ...]]:
    """Return each sine hinge's angle, and its sum with those of parallel hinges above it: gravity sees the sum."""
    hinges = {v.index: v for v in views if v.feature == "sine"}
    rows: list[tuple[int, ...]] = []
    for view in hinges.values():
        alone = np.zeros(size, int)
        alone[view.position_entry] = 1
        chain = alone.copy()
        for above in _parallel_above(model, view, hinges):
            chain[above.position_entry] = 1
        rows += [tuple(int(x) for x in row) for row in (alone, chain)]
    return list(dict.fromkeys(rows))


def _parallel_above(
    model: mujoco.MjModel, view: JointView, hinges: dict[int, JointView]
) -> list[JointView]:
    found, axis = [], model.jnt_axis[view.index]
    body = int(model.body_parentid[model.jnt_bodyid[view.index]])
    while body:
        for joint in range(
            model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]
        ):
            above = hinges.get(joint)
            if above and np.allclose(model.jnt_axis[joint], axis):
                found.append(above)
        body = int(model.body_parentid[body])
    return found


def _segments(views: list[JointView], planar: tuple[str, ...], size: int) -> tuple[Segment, ...]:
    """Return how the state changes, in order; empty if it is plain all through."""
    if not planar and all(view.kind in ("hinge", "slide") for view in views):
        return ()
    parts = [segment for view in views for segment in _place_segments(view, planar)]
    parts += [segment for view in views for segment in _rate_segments(view, planar)]
    rest = size - sum(part.size for part in parts)  # activations and sensors
    return tuple(_merged([*parts, Plain(size=rest)]))


def _place_segments(view: JointView, planar: tuple[str, ...]) -> list[Segment]:
    if view.kind == "free":
        return [Position(rate=view.rate), Quaternion(rate=view.rate + 3)]
    if view.kind == "ball":
        return [Quaternion(rate=view.rate)]
    if view.name in planar:
        kinds = {
            0: [PlanarPosition(rate=view.rate)],
            1: [],
            2: [Heading(rate=view.rate)],
        }
        return kinds[planar.index(view.name)]
    return [Plain(size=1)]


def _rate_segments(view: JointView, planar: tuple[str, ...]) -> list[Segment]:
    if view.kind == "free":
        return [Velocity(), Plain(size=3)]
    if view.kind == "ball":
        return [Plain(size=3)]
    if view.name in planar:
        return {0: [PlanarVelocity()], 1: [], 2: [Plain(size=1)]}[planar.index(view.name)]
    return [Plain(size=1)]


def _merged(parts: list[Segment]) -> list[Segment]:
    """Return `parts` with neighbouring plain segments joined: fewer pieces, fewer copies at every step."""
    joined: list[Segment] = []
    for part in parts:
        if joined and isinstance(part, Plain) and isinstance(joined[-1], Plain):
            joined[-1] = Plain(size=joined[-1].size + part.size)
        elif part.size:
            joined.append(part)
    return joined
