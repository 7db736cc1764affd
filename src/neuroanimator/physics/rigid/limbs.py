"""Groups of a MuJoCo model's joints, such as limbs, each with its own network in a hierarchy."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Bool

from neuroanimator.errors import ArgumentError
from neuroanimator.physics.groups import check_groups
from neuroanimator.physics.rigid.actuators import actuators_of_controls, moment_arms
from neuroanimator.physics.rigid.joints import JointView
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.state.structure import BodyGroup
from neuroanimator.text import listed

POSE_SEED = 0
"""Seed of the pose in which muscles are examined."""

POSE_SPREAD = 0.1
"""Spread about the reference pose at which muscles are examined [rad or m], so that none pulls through a joint's axis."""


def groups_of(
    model: mujoco.MjModel, views: list[JointView], groups: dict[str, tuple[str, ...]]
) -> tuple[BodyGroup, ...]:
    """Return each group of joints with its state entries and the controls that act on it.

    Raises ArgumentError for a group without joints, an unknown or repeated joint, and for the root's joint.
    """
    if not groups:
        return ()
    _check(views, groups)
    moved = acts_on(model)
    limbs = []
    for name, joints in groups.items():
        members = [view for view in views if view.name in joints]
        limbs.append(_group(model, name, members, moved))
    return tuple(limbs)


def _check(views: list[JointView], groups: dict[str, tuple[str, ...]]) -> None:
    of_root = [view.name for view in views if view.feature in ("free", "planar")]
    names = [view.name for view in views if view.name not in of_root]
    for group, joints in groups.items():
        if not joints:
            raise ArgumentError(
                f"groups.{group}: wanted one or more joints, got none. Joints: {listed(names)}."
            )
        for joint in joints:
            if joint in of_root:
                raise ArgumentError(
                    f"groups.{group}: '{joint}' is the root's; it belongs to no group. Leave it out."
                )
    check_groups(groups, names, "joint")


def _group(
    model: mujoco.MjModel, name: str, views: list[JointView], moved: Bool[np.ndarray, "C V"]
) -> BodyGroup:
    """Return the group of the joints `views`: its state entries, and the controls that drive any of them."""
    entries: list[int] = []
    rates: list[int] = []
    for view in views:
        entries += view.positions
        rates += view.velocities
    entries += rates
    dofs = np.array(rates) - model.nq
    controls = np.flatnonzero(moved[:, dofs].any(axis=1)).tolist()
    return BodyGroup(name, tuple(sorted(entries)), tuple(controls))


def acts_on(model: mujoco.MjModel) -> Bool[np.ndarray, "C V"]:
    """Return which control drives which degree of freedom, directly or through a tendon or a site."""
    data = mujoco.MjData(model)
    rng = np.random.default_rng(POSE_SEED)
    mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), POSE_SPREAD)
    with warnings_counted:
        mujoco.mj_forward(model, data)
    of_forces = moment_arms(model, data) != 0
    of_actuators = np.zeros((model.nactuator, model.nv), bool)
    np.logical_or.at(
        of_actuators, np.repeat(np.arange(model.nactuator), model.actuator_outnum), of_forces
    )
    return of_actuators[actuators_of_controls(model)]
