"""Texts about a proposal for a model: comments on its values, rows for the screen, and warnings."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from neuroanimator.files.names import model_name
from neuroanimator.learn.data.config import USUAL_COUNT
from neuroanimator.physics.rigid.actuators import actuators_of_controls, control_names
from neuroanimator.physics.rigid.joints import FEATURES, joint_name, sensor_name
from neuroanimator.physics.rigid.limbs import acts_on
from neuroanimator.physics.rigid.model_system import ModelSystem, keyframe_name
from neuroanimator.physics.rigid.touching import is_limited
from neuroanimator.scaffold.actuators import controls_without_range
from neuroanimator.scaffold.holding import Hold
from neuroanimator.scaffold.motion import FAR, MOST, OFF_MIDDLE, TriedMotion, is_urdf
from neuroanimator.scaffold.root_invariance import (
    can_touch_ground,
    gravity_of,
    has_free_root,
    why_root_is_placed,
)
from neuroanimator.scaffold.teacher import Teacher, data_row, in_words
from neuroanimator.text import listed

SLOW = 0.05
"""Growth exponent of a fall over one super step below which it is not mentioned."""

STILL = 0.01
"""Motion in a run up to which a joint hardly moves: of a hinge [rad], and of a slide as a share of the model's extent."""

MANY = 90
"""Percentile of the runs in which it must hardly move for that to be told."""

COMMENTS = {
    "base": "of a URDF: fixed to the world, or free to move over a floor",
    "passive": "joints with an effort limit but without a motor",
    "physics": "How the physics is stepped. Speed-ups are measured against step and integrator.\n"
    "truth teaches; fine is the reference of every error, at most a tenth of the step.",
    "physics.step": "the model's own, or MuJoCo's [s]",
    "state": "How the network sees each joint.\n"
    f"hinge: {', '.join(FEATURES['hinge'][:3])}; slide: {', '.join(FEATURES['slide'][:2])}; ball: ball; free: free, placed.\n"
    "cyclic: where it stands does not matter, how fast it moves does; free: nor which way it faces; placed: both matter.",
    "frame": "What of the root's position matters. ground: its height; probes: x, y, z, radius of feet [m];\n"
    "contacts: what of the whole body may touch the ground, and joints that may reach their stops;\n"
    "symmetries: mirrors and like limbs, by which every example stands for several;\n"
    "planar: joints x, y, heading of a root that moves in a plane, where position and heading do not matter.",
    "control": "The least and the largest value of each control.",
    "holding": "The control that holds the model at rest, to which controls return when they end.",
    "sampling": "Random starts of training runs, around the state of rest; a share of them near it.\n"
    "reset_share: of runs that begin just at rest or at a keyframe, but for reset_noise;\n"
    "warm_up: random driving before the others are recorded [s]; tilt: of a free root [rad].",
    "task": "What 'neuroanimator policy' rewards: going forward along X and staying healthy; the numbers are the environment's.\n"
    "hold: physics steps a control is held; steps: controls in an episode.",
    "sampling.above_ground": "lifts starts that would lie in the ground",
    "sampling.position": "Where they begin [rad or m]: from the first to the second number,\n"
    "or as far as one number to either side of rest: over a joint's range, all the way round, or as in trial runs;\n"
    "an environment's own resets lie within.",
    "sampling.velocity": "Standard deviation [rad/s or m/s], as seen in trial runs, or in an environment's own resets.",
}
"""Titles of tables, and comments on values that are the same for every model."""


class TrialFindings(NamedTuple):
    """Results of a model's trial runs."""

    motion: TriedMotion
    """Its motion under the proposed controls."""
    hold: Hold
    growth: float
    """Rate at which a fall from rest grows [1/s]."""
    whole: dict[str, tuple[float, float]]
    """Full range of each control."""
    teacher: Teacher
    lost: list[str]
    """Names of rest and keyframes from which runs diverge."""


def comments_on(system: ModelSystem, found: TrialFindings) -> dict[str, str]:
    """Return the comments on the values proposed for `system`, by key of the TOML file."""
    model = system.model
    sensors = [sensor_name(model, sensor) for sensor in range(model.nsensor)]
    keyframes = [keyframe_name(model, keyframe) for keyframe in range(model.nkey)]
    comments = COMMENTS | {
        "substeps": _substeps_note(found),
        "keyframe": f"the state of rest, of: {listed(keyframes) or 'none; the reference pose'}",
        "physics.truth_step": _teacher_note(found.teacher),
        "sensors": f"those to be emulated too, of: {listed(filter(None, sensors)) or 'none'}",
        "sampling.warm_up": _warm_up_note(system, found.motion),
    }
    for control, name in enumerate(control_names(model)):
        comments[f"control.{name}"] = _control_note(model, found, control, name)
    root = system.views[0]
    if root.feature == "placed":
        why = why_root_is_placed(model)
        comments[f"state.{root.name}"] = f"where it stands matters: {why}"
    return comments


def _substeps_note(found: TrialFindings) -> str:
    """Return the reason for the length of the super step."""
    motion = found.motion
    exponent = found.growth * motion.trial.dt
    note = f"a super step of {motion.trial.dt:g} s"
    if motion.joint:
        note += f"; {motion.joint} turns at {motion.speed:.2g} rad/s, {motion.turn:.2g} rad in it"
    if exponent > SLOW:
        note += f"; a fall from rest grows {np.exp(exponent):.2g} times in it"
    return note


def _control_note(model: mujoco.MjModel, found: TrialFindings, control: int, name: str) -> str:
    """Return the origin of a control's bounds."""
    low, high = found.whole[name]
    held = found.hold.controls[control]
    notes = []
    if is_urdf(found.motion.values):
        notes.append(f"a motor of <limit effort>; new --passive {name} leaves it out")
    if control in controls_without_range(model):
        notes.append("the model gives no range: set what your motor can do")
    if found.hold.source and abs(held) > OFF_MIDDLE * (high - low):
        notes.append(f"{held:.3g}: {found.hold.source}")
    if found.motion.values["control"][name] != (low, high):
        why = "as far to either side"
        if found.motion.share < 1:
            why = "at full range it would fall, or turn too fast to learn; widen if needed"
        notes.append(f"of {low:.4g} to {high:.4g}, {why}")
    return "; ".join(notes)


def _warm_up_note(system: ModelSystem, motion: TriedMotion) -> str:
    """Return why runs are or are not driven before they are recorded."""
    note = "none: nothing can collide"
    if system.warm_up:
        note = "bodies can collide: let contacts settle first"
    elif system.sampling.above_ground:
        note = "none, as it falls"
    if system.sampling.above_ground:
        note += f"; {_posture(motion)}"
    return note


def _posture(motion: TriedMotion) -> str:
    return f"upright for {motion.upright:.0%} of the time"


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


def told_of(model: mujoco.MjModel, found: TrialFindings) -> tuple[tuple[str, str], ...]:
    """Return the rows shown on the screen about a proposal."""
    values = found.motion.values
    rows = []
    if is_urdf(values):
        motors = listed(control_names(model))
        added = (
            f"motors on {motors}, of <limit effort>; for a joint without a motor: --passive JOINT"
        )
        if values["base"] == "free":
            added += "; a floor, with MuJoCo's default friction"
        added += f"; a step of {model.opt.timestep:g} s, if the file sets none"
        rows.append(("added", added))
    if values["sampling"]["above_ground"]:
        rows.append(("trial runs", _posture(found.motion)))
    rows.append(data_row(USUAL_COUNT, found.teacher.seconds))
    return tuple(rows)


def warnings_about(system: ModelSystem, found: TrialFindings) -> Iterator[str]:
    """Yield warnings for the user, one line each."""
    model = system.model
    names = control_names(model)
    unlimited = [names[i] for i in controls_without_range(model)]
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
    # Those of bodies act on contacts, and there may be none now.
    is_idle = ~acts_on(model).any(axis=1)
    is_idle &= model.actuator_trntype[actuators_of_controls(model)] != mujoco.mjtTrn.mjTRN_BODY
    idle = [names[i] for i in np.flatnonzero(is_idle).tolist()]
    if idle:
        yield f"control: {listed(idle)} move no joint. Check the joint, the site and the gear, or take them out."
    still = still_joints(system, found.motion)
    if still:
        yield (
            f"state: {listed(still)} hardly move in trial runs, so an emulator learns little of how they do. Start them within "
            "reach of what moves them ([sampling.position]), or widen [control]; leave it so if they should stay."
        )
    yield from _fall_warnings(model, found)
    for view in system.views:
        if view.kind != "slide" or view.feature == "planar" or is_limited(model, view.index):
            continue
        reach = float(np.abs(found.motion.trial.states[..., view.position_entry]).max())
        if reach > FAR:
            yield (
                f"state.{view.name}: neither a range nor a spring keeps it near; it went {reach:.0f} m away in trial "
                "runs. Give the joint a range or stiffness in the model, or weaken what drives it."
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


def still_joints(system: ModelSystem, motion: TriedMotion) -> list[str]:
    """Return the names of the hinges and slides that hardly move in nine of ten trial runs."""
    still = []
    for view in system.views:
        if view.kind in ("hinge", "slide"):
            moves = np.ptp(motion.trial.states[..., view.position_entry], axis=1)
            unit = 1.0 if view.kind == "hinge" else float(system.model.stat.extent)
            if np.percentile(moves, MANY) < STILL * unit:
                still.append(view.name)
    return still


def _fall_warnings(model: mujoco.MjModel, found: TrialFindings) -> Iterator[str]:
    """Yield warnings about a root that falls, onto a floor or for ever."""
    name = joint_name(model, 0)
    if has_free_root(model) and gravity_of(model).any() and not can_touch_ground(model):
        if found.hold.source:
            yield (
                f"{name}: there is no floor, so nothing stops a fall but the controls. Add a plane to the model if it "
                "should land."
            )
        else:
            yield (
                f"{name}: there is no floor and no control holds it, so it falls forever. Add a plane, or set "
                'gravity="0 0 0" if it floats.'
            )
    if found.motion.upright < MOST:
        yield (
            f"{name}: {_posture(found.motion)}, whatever was tried, so most of the data are of falls. "
            "Narrow [control], or let servos or a keyframe's ctrl hold it."
        )
