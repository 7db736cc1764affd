"""Words about a proposal: a comment on each value of the TOML file, and what the user should look at."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import mujoco
import numpy as np

from neuroanimator.data.config import USUAL_COUNT
from neuroanimator.parsing.names import model_name
from neuroanimator.scaffold.holding import Hold
from neuroanimator.scaffold.motion import FAR, MOST, OFF_MIDDLE, Motion, free_spread, system_of
from neuroanimator.scaffold.surroundings import (
    LEVEL,
    can_touch_ground,
    gravity_of,
    has_free_root,
    what_tells_place,
    world_axis_actuators,
)
from neuroanimator.scaffold.teacher import (
    Teacher,
    in_words,
)
from neuroanimator.state.contacts import Contacts
from neuroanimator.state.symmetry import Symmetry
from neuroanimator.systems.rigid.actuators import actuator_name, control_range
from neuroanimator.systems.rigid.joints import joint_name, sensor_name
from neuroanimator.systems.rigid.limbs import acts_on
from neuroanimator.systems.rigid.model_system import ModelSystem, keyframe_name
from neuroanimator.systems.rigid.touching import is_limited
from neuroanimator.text import listed

SETTLING = "something can touch something: let contacts settle first"
"""Why runs are driven before they are recorded."""

SLOW = 0.05
"""A fall from rest that grows at most by e to this in a super step is not worth a word."""


class Findings(NamedTuple):
    """What was found out about a model."""

    motion: Motion
    """How it moves under the controls that are proposed."""
    hold: Hold
    growth: float
    """How fast a fall from rest grows [1/s]."""
    whole: dict[str, tuple[float, float]]
    """The whole range of each control."""
    teacher: Teacher
    symmetries: dict[Symmetry, float]
    """What leaves the motion what it is, to which share of a usual change."""
    lost: list[str]
    """Which of rest and keyframes runs diverge from."""


def comments_on(system: ModelSystem, found: Findings) -> dict[str, str]:
    """Return the comments on the values proposed for `system`, by key of the TOML file."""
    model = system.model
    values = found.motion.values
    sensors = [sensor_name(model, sensor) for sensor in range(model.nsensor)]
    keyframes = [keyframe_name(model, keyframe) for keyframe in range(model.nkey)]
    notes = {
        "substeps": _substeps_note(found.motion, found.growth),
        "passive": "joints with an effort that no motor drives all the same",
        "base": "of a URDF: fixed to the world, or free to move over a floor",
        "keyframe": f"the state of rest, of: {listed(keyframes) or 'none; the reference pose'}",
        "physics.step": "the model's own [s]",
        "physics.integrator": "the model's own",
        "sensors": f"those to be emulated too, of: {listed(filter(None, sensors)) or 'none'}",
        "frame.contacts": _contacts_note(system.structure.contacts),
        "frame.symmetries": _symmetries_note(found.symmetries),
        "sampling.reset_share": "random starts may never be there, and motions begin there",
        "sampling.warm_up": _warm_up_note(found.motion),
        "sampling.above_ground": "lifts starts that would lie in the ground",
    }
    if values["sampling"]["tilt"]:
        notes["sampling.tilt"] = "as in trial runs, within bounds"
    if values["sampling"]["reset_noise"]:
        notes["sampling.reset_noise"] = "as the environment resets"
    if is_urdf(found):
        notes["physics.step"] = notes["physics.integrator"] = "the model's own, or MuJoCo's"
    for actuator in range(model.nu):
        name = actuator_name(model, actuator)
        notes[f"control.{name}"] = _control_note(model, found, actuator)
    for joint in range(model.njnt):
        name = joint_name(model, joint)
        notes[f"sampling.position.{name}"] = _spread_note(model, values, joint)
        notes[f"state.{name}"] = _feature_note(model, values, joint)
    notes["physics.truth_step"] = _teacher_note(found.teacher)
    return {key: note for key, note in notes.items() if note}


def _substeps_note(motion: Motion, growth: float) -> str:
    """Return why the super step is as long as it is."""
    note = f"a super step of {motion.dt:g} s"
    if motion.joint:
        note += f"; {motion.joint} turns at {motion.speed:.2g} rad/s, {motion.speed * motion.dt:.2g} rad in it"
    if growth * motion.dt > SLOW:
        note += f"; a fall from rest grows {np.exp(growth * motion.dt):.2g} times in it"
    return note


def _control_note(model: mujoco.MjModel, found: Findings, actuator: int) -> str:
    """Return where the bounds of an actuator come from."""
    name = actuator_name(model, actuator)
    low, high = found.whole[name]
    proposed = found.motion.values["control"][name]
    notes = []
    if is_urdf(found):
        notes.append(f"a motor of <limit effort>; new --passive {name} leaves it out")
    if control_range(model, actuator) is None:
        notes.append("the model gives no range: say what your motor can do")
    if found.hold.source and abs(found.hold.controls[actuator]) > OFF_MIDDLE * (high - low):
        notes.append(f"{found.hold.controls[actuator]:.3g} {found.hold.source}")
    if proposed != (low, high):
        why = "as far to either side"
        if found.motion.share < 1:
            why = f"with all of which {found.motion.joint} would turn too fast to learn; widen if need be"
            if found.motion.stance is not None:
                why = "with all of which it would fall, or turn too fast to learn; widen if need be"
        notes.append(f"of {low:.4g} to {high:.4g}, {why}")
    return "; ".join(notes)


def is_urdf(found: Findings) -> bool:
    """Return whether the model is a URDF, of which less is the model's own."""
    return str(found.motion.values["model"]).lower().endswith(".urdf")


def told_of(model: mujoco.MjModel, found: Findings) -> tuple[tuple[str, str], ...]:
    """Return what is told on the screen of a proposal, as rows."""
    rows = []
    if is_urdf(found):
        motors = listed(actuator_name(model, actuator) for actuator in range(model.nu))
        added = f"motors on {motors}, of <limit effort>; one that nothing drives: --passive JOINT"
        if found.motion.values["base"] == "free":
            added += "; a floor, as slippery as MuJoCo's usually are"
        rows.append(
            ("added", f"{added}; a step of {model.opt.timestep:g} s, if the file sets none")
        )
    if found.motion.stance is not None:
        rows.append(("trial runs", found.motion.in_words()))
    seconds = in_words(found.teacher.seconds)
    rows.append(("data", f"{USUAL_COUNT:,} transitions take about {seconds}"))
    return tuple(rows)


def _warm_up_note(motion: Motion) -> str:
    """Return why runs are or are not driven before they are recorded."""
    if motion.stance is None:
        is_driven = motion.values["sampling"]["warm_up"]
        return SETTLING if is_driven else "nothing can touch anything"
    if motion.values["sampling"]["warm_up"]:
        return f"{SETTLING}; {motion.in_words()}"
    return f"none, as it falls; {motion.in_words()}"


def _contacts_note(contacts: Contacts | None) -> str:
    """Return what the network is shown of contacts."""
    if contacts is None:
        return "nothing touches a fixed plane, and no joint has a stop"
    points = len(contacts.points)
    stops = len(contacts.stops)
    return f"shows the network where {points} points and {stops} joints are going, to the ground and to their stops"


def _symmetries_note(symmetries: dict[Symmetry, float]) -> str:
    """Return what the symmetries of a model are good for."""
    if not symmetries:
        return "no mirror or exchange of like limbs leaves the motion what it is"
    return (
        f"every example stands for {len(symmetries) + 1}: mirrored, or with like limbs exchanged, "
        f"it is true to {max(symmetries.values()):.1g} of a usual change"
    )


def _spread_note(model: mujoco.MjModel, values: dict[str, Any], joint: int) -> str:
    """Return where the spread of a joint's random positions comes from."""
    name = joint_name(model, joint)
    if name not in values["sampling"]["position"]:
        return ""
    if free_spread(model, joint) is None:
        return "as in trial runs"
    if is_limited(model, joint):
        return "the joint's range"
    return "all the way round, as nothing limits it"


def _feature_note(model: mujoco.MjModel, values: dict[str, Any], joint: int) -> str:
    """Return why a joint is seen as it is, where that is not plain."""
    feature = values["state"][joint_name(model, joint)]
    if feature == "cyclic":
        return "nothing can tell where it stands"
    if feature == "planar":
        return "a root that moves in the plane"
    if feature == "placed":
        return _place_note(model, joint)
    if feature == "sine":
        return "may turn more than half round"
    return ""


def _place_note(model: mujoco.MjModel, joint: int) -> str:
    """Return why it matters where a free joint stands."""
    note = "where it stands matters"
    if np.sum(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE) > 1:
        return f"{note}: it is not the only free body"
    pushing = [actuator_name(model, actuator) for actuator in world_axis_actuators(model)]
    if pushing:
        return f"{note}: {listed(pushing)} push it along the world's axes"
    reason = what_tells_place(model, joint, LEVEL)
    if reason:
        return f"{note}: '{model_name(reason, reason)}' can tell"
    return f"{note}: it is not the first joint"


def _teacher_note(teacher: Teacher) -> str:
    """Return the comment on the teacher's step."""
    note = (
        f"teaches with an error of {teacher.error:.2g} of a super step's change; the model's own: {teacher.own_error:.2g}; "
        f"{USUAL_COUNT:,} transitions take about {in_words(teacher.seconds)}"
    )
    if teacher.passed_over is not None:
        scheme = teacher.passed_over
        note += f"; {scheme.integrator} at {scheme.dt:g} s would be better and take too long"
    return note


def warnings_about(model: mujoco.MjModel, found: Findings) -> Iterator[str]:
    """Yield what the user should look at, one line each."""
    unlimited = []
    for actuator in range(model.nu):
        if control_range(model, actuator) is None:
            unlimited.append(actuator_name(model, actuator))
    if unlimited:
        yield (
            f"control: the model gives no range for {listed(unlimited)}; the proposed ones are guesses. "
            "Set them in the TOML file, or ctrlrange in the model."
        )
    held = [model.body(body).name for body in np.flatnonzero(model.body_mocapid >= 0).tolist()]
    if held:
        named = listed(model_name(name, "a body without a name") for name in held)
        yield (
            f"mocap: {named} stays where it is, as no control moves a mocap body. Give the model actuators for what it should "
            "move."
        )
    idle = _actuators_without_effect(model)
    if idle:
        yield f"control: {listed(idle)} move no joint. Check the joint, the site and the gear, or take them out."
    yield from _root_warnings(model, found.hold)
    yield from _trial_warnings(model, found)


def _trial_warnings(model: mujoco.MjModel, found: Findings) -> Iterator[str]:
    """Yield what trial runs gave reason to say: roots that go away or fall, poses and runs that diverge."""
    for view in system_of(found.motion.values, model).views:
        if view.kind != "slide" or view.feature == "planar" or is_limited(model, view.index):
            continue
        reach = float(np.abs(found.motion.trial.states[..., view.position_entry]).max())
        if reach > FAR:
            yield (
                f"state.{view.name}: neither a range nor a spring keeps it near; it went {reach:.0f} m away in trial "
                "runs. Give the joint a range or stiffness in the model, or weaken what drives it."
            )
    if found.motion.upright < MOST:
        yield (
            f"{joint_name(model, 0)}: {found.motion.in_words()}, whatever was tried, so most of the data are of falls. "
            "Narrow [control], or let servos or a keyframe's ctrl hold it."
        )
    if found.lost:
        yield (
            f"{listed(found.lost)}: runs that begin there diverge, so none is in the data. Correct the pose, or use a "
            "smaller timestep in the model."
        )
    trial = found.motion.trial
    if trial.diverged:
        yield (
            f"{trial.diverged} of {trial.runs} trial runs diverged. Such runs are dropped from the data; a "
            "smaller timestep in the model, or narrower control bounds, would keep them."
        )


def _actuators_without_effect(model: mujoco.MjModel) -> list[str]:
    """Return the actuators that drive no degree of freedom; those of bodies act on contacts, which there may not be now."""
    is_driven = acts_on(model).any(axis=1)
    acts_on_contacts = model.actuator_trntype == mujoco.mjtTrn.mjTRN_BODY
    without = np.flatnonzero(~is_driven & ~acts_on_contacts)
    return [actuator_name(model, int(actuator)) for actuator in without]


def _root_warnings(model: mujoco.MjModel, hold: Hold) -> Iterator[str]:
    """Yield what is to be said of a free root: what it may fall through, and what its place would tell it."""
    if not has_free_root(model):
        return
    name = joint_name(model, 0)
    weight = gravity_of(model)
    if np.any(weight) and not can_touch_ground(model):
        if hold.source:
            yield (
                f"{name}: there is no floor, so nothing stops a fall but the controls. Add a plane to the model if it "
                "should land."
            )
        else:
            yield (
                f"{name}: there is no floor and no control holds it, so it falls for ever. Add a plane, or set "
                'gravity="0 0 0" if it floats.'
            )
