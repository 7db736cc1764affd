"""A URDF as a model that moves: with a motor for each joint with an effort, and a fixed or free base."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Literal

import mujoco
import numpy as np

from neuroanimator.files.names import check_known
from neuroanimator.files.numbers import number_in
from neuroanimator.systems.model_xml import refuse
from neuroanimator.text import quoted

FLOOR = "floor"
"""Name of the ground under a free base."""

FLOOR_SIZE = (5.0, 5.0, 0.1)
"""Distance to which the infinite ground is drawn to either side, and the size of its squares [m]."""

ROOT = "root"
"""Name of the free joint of a base."""

MOVERS = ("planar", "floating")
"""Types of joints by which a robot as a whole moves."""

MAX_SHOWN = 40
"""Maximum number of characters of a joint's name shown in an error."""


def add_what_moves(
    spec: mujoco.MjSpec,
    file: str,
    robot: ET.Element,
    base: Literal["fixed", "free"],
    passive: tuple[str, ...] = (),
) -> None:
    """Add to the `spec` of the URDF `robot` in `file` the parts that MuJoCo does not read.

    Each joint with `<limit effort>` above 0 that is not among the `passive` ones gets a motor of its name, from minus to
    plus that effort. `<limit velocity>` is not physics and is ignored. A free base gets a floor, which it just touches.
    Raises BadFileError for an invalid effort and for a `<mimic>` that MuJoCo ignores, ArgumentError for a missing passive joint.
    """
    joints = {joint.name: joint for joint in spec.joints}
    check_known(passive, joints, "joint", "passive")
    for element in robot.iter("joint"):
        joint = joints.get(element.get("name", ""))
        if joint is None:
            continue
        if joint.name not in passive:
            _add_motor(spec, file, joint, element)
        _check_mimic(spec, file, joint, element)
    if base == "free":
        _free_base(spec, file, robot)


def _add_motor(spec: mujoco.MjSpec, file: str, joint: mujoco.MjsJoint, element: ET.Element) -> None:
    """Add the motor of a joint that has an effort and mimics no other."""
    effort = _effort(file, element)
    is_single = joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    if effort <= 0 or not is_single or element.find("mimic") is not None:
        return
    motor = spec.add_actuator(name=joint.name, target=joint.name)
    motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    motor.ctrllimited = True
    motor.ctrlrange = [-effort, effort]


def _check_mimic(
    spec: mujoco.MjSpec, file: str, joint: mujoco.MjsJoint, element: ET.Element
) -> None:
    """Refuse a `<mimic>` of which MuJoCo has made no equality: it only warns."""
    mimic = element.find("mimic")
    followers = [equality.name1 for equality in spec.equalities]
    if mimic is None or joint.name in followers:
        return
    leader = quoted(mimic.get("joint", "")[:MAX_SHOWN])
    fault = f"mimics the joint {leader}, which does not exist, or one of them neither turns nor slides. Correct it"
    refuse(file, f"joint {quoted(joint.name)}", fault)


def _effort(file: str, element: ET.Element) -> float:
    """Return the effort of a joint; 0 if it has none."""
    limit = element.find("limit")
    if limit is None or "effort" not in limit.attrib:
        return 0.0
    try:
        value = number_in(limit.attrib["effort"])
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        name = quoted(element.get("name", "")[:MAX_SHOWN])
        refuse(file, f"joint {name}", "<limit effort>: wanted a finite number")
    return value


def _free_base(spec: mujoco.MjSpec, file: str, robot: ET.Element) -> None:
    """Let the root move freely, just above a floor; BadFileError if there is no root, or if the file joins it to the world."""
    mover = _mover(robot)
    if mover is not None:
        name = quoted(mover.get("name", "")[:MAX_SHOWN])
        fault = f"moves already by the {mover.get('type')} joint {name}. Use base = fixed"
        refuse(file, "robot", fault)
    root = spec.worldbody.first_body()
    if root is None or root.joints:
        refuse(
            file,
            "robot",
            "no root link that could be free. Use base = fixed, or take out the link 'world'",
        )
    root.add_freejoint(name=ROOT)
    spec.worldbody.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=list(FLOOR_SIZE))
    model = spec.compile()
    root.pos = np.array(root.pos) - [0.0, 0.0, lowest_point(model)]


def _mover(robot: ET.Element) -> ET.Element | None:
    """Return the planar or floating joint right below the root, by which the whole robot moves; None without one."""
    joints = {_link(joint, "child"): joint for joint in robot.iter("joint")}
    fixed = {link: joint for link, joint in joints.items() if joint.get("type") == "fixed"}
    for joint in joints.values():
        if joint.get("type") not in MOVERS:
            continue
        parent = _link(joint, "parent")
        for _ in fixed:
            if parent in fixed:
                parent = _link(fixed[parent], "parent")
        if parent not in joints:
            return joint
    return None


def _link(joint: ET.Element, end: str) -> str:
    """Return the link at one end of a joint; empty if it is missing."""
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def lowest_point(model: mujoco.MjModel) -> float:
    """Return the height of the lowest point that can touch the ground, in the reference pose [m]; 0 if none can.

    It is computed from the geoms' bounding boxes, along their own axes.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lowest = []
    for geom in range(model.ngeom):
        is_solid = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if model.geom_bodyid[geom] == 0 or not is_solid:
            continue
        center, half = np.split(model.geom_aabb[geom], 2)
        upward = data.geom_xmat[geom].reshape(3, 3)[2]
        height = data.geom_xpos[geom][2] + upward @ center - np.abs(upward) @ half
        lowest.append(float(height))
    return min(lowest, default=0.0)
