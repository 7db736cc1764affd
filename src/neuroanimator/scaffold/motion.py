"""Controls, starts and super step that make a model's motions learnable, found by trial runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.model import Definition
from neuroanimator.errors import BadFileError
from neuroanimator.files.tables import check_table
from neuroanimator.physics.rigid.actuators import actuators_of_controls
from neuroanimator.physics.rigid.bones import joint_kind
from neuroanimator.physics.rigid.joints import JointView, joint_name
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.physics.rigid.mujoco_system import DIVERGED_VELOCITY
from neuroanimator.physics.rigid.touching import is_limited
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.scaffold.defaults import (
    ANGLE_SPREAD,
    BEARABLE,
    FASTEST,
    MAX_TURN,
    SHARES,
    SHORT_SUPER_STEP,
    WANTED_SUPER_STEP,
    rounded,
)
from neuroanimator.scaffold.holding import Hold, Stance, are_upright, stance_of
from neuroanimator.scaffold.root_invariance import (
    actuated_joint,
    aims,
    has_free_root,
    has_servo,
    has_spring,
    obstacle,
)
from neuroanimator.scaffold.trials import (
    ROOM,
    STIFF_INTEGRATORS,
    ModelTrial,
    fastest_turning,
    occurring_range,
    run_trial,
    usual_velocities,
)
from neuroanimator.state.rotation import rotate_back
from neuroanimator.terminal import progress_bar

SUPER_STEPS = (0.1, 0.08, 0.06, 0.05, 0.04, 0.03, SHORT_SUPER_STEP)
"""Approximate lengths of the super steps tried, the longest first [s]."""

MAX_GROWTH = 0.5
"""Maximum growth exponent of a fall over one super step; above it control comes too late, and errors grow as fast."""

HOPEFUL = 2.5
"""Maximum factor by which angles turn too far, at the last speeds, for a shorter super step to be tried."""

ENOUGH = 0.04
"""Length of the super step [s] up to which the controls of a model that only they hold are narrowed."""

MOST = 0.5
"""Minimum share of the time that a root should be upright in the data."""

FEW = 0.05
"""Minimum share of the time that a root is upright for starts to be spread by upright states alone."""

HOVER_HEIGHT = 2.0
"""Highest random start, over its rest, of a body that only its controls hold in the air [m]."""

OFF_MIDDLE = 0.02
"""Minimum distance of a holding control from the middle of its range, as a share of the range, to count."""

MIN_ROOM = 0.1
"""Minimum room on either side of a holding control, as a share of half the range, for the range to be centred there."""

BALL_SPREAD = 0.5
"""Standard deviation of the random starts of a ball joint [rad]."""

TILTS = (0.1, 0.5)
"""Minimum and maximum standard deviation of the tilt with which a free root starts [rad]."""

REACHES = (0.05, 2.0)
"""Minimum and maximum distance from rest along x and y [m] of starts of a free body whose position matters."""

UNDRIVEN_REACH = 1.0
"""Distance from rest [m] within which an undriven slide starts, such as that of an object to push."""

FAR = 10.0
"""Distance [m] at which a slide counts as run away in a trial run."""

TURNS = np.linspace(0, 2 * np.pi, 24, endpoint=False)
"""Angles to which a hinge or a ball is turned to see whether something is in its way [rad]."""

MIN_DEPTH = 1e-3
"""Overlap of geoms that counts as being in the way, as a share of the model's extent."""

SMALLER_STEPS = (2, 5, 10)
"""Numbers of parts into which the step of an exploding model is divided, so that the error can name one that works."""

EXPLOSION_STEPS = 2000
"""Number of steps for which an exploding model is watched, to find the first joint that does so."""

Draft = dict[str, Any]
"""The table of a definition that is being drafted."""


class TriedMotion(NamedTuple):
    """A model's motion under controls over a share of their range."""

    values: Draft
    """The definition's table, with controls, sampling and super step filled in."""
    trial: ModelTrial
    joint: str
    """Name of the joint that turns fastest."""
    speed: float
    """Its angular velocity [rad/s]."""
    share: float
    upright: float
    """Share of the time in which the root is upright."""

    @property
    def turn(self) -> float:
        """Angle by which the fastest joint turns in a super step [rad]."""
        return self.speed * self.trial.dt


@dataclass(frozen=True)
class MotionSearch:
    """A search for a model's controls, starts and super step, and its bounds."""

    model: mujoco.MjModel
    hold: Hold
    longest: float
    """Maximum length of a super step [s]."""
    stance: Stance | None
    resets: Float[np.ndarray, "B S"] | None
    """States after an environment's resets, without sensors, which random starts cover; None if there are none."""

    def is_good(self, motion: TriedMotion) -> bool:
        """Return whether the controls need not be narrowed further.

        A model that only its controls hold must not be flung about: it needs super steps of some length.
        """
        if has_free_root(self.model) and self.hold.source:
            return motion.turn <= MAX_TURN and motion.trial.dt >= min(ENOUGH, self.longest)
        return motion.turn <= BEARABLE * MAX_TURN


def choose_motion(
    values: Draft,
    model: mujoco.MjModel,
    hold: Hold,
    growth: float,
    resets: Float[np.ndarray, "B S"] | None = None,
) -> TriedMotion:
    """Return controls, sampling and super step that make the model's motions learnable.

    Controls keep their full range if the super step need not become too short, and if a root that may fall is then upright
    most of the time; else a smaller share. A root that falls is not driven before recording, and starts higher if it
    hovers. `growth` is the rate of a fall from rest [1/s]; starts cover the states `resets`. Raises BadFileError if the model
    always explodes.
    """
    longest = WANTED_SUPER_STEP
    if growth > 0:
        longest = max(SUPER_STEPS[-1], min(longest, MAX_GROWTH / growth))
    stance = stance_of(system_of(values, model), hold)
    search = MotionSearch(model, hold, longest, stance, resets)
    tried: list[TriedMotion] = []
    lengths = len(SUPER_STEPS)
    with progress_bar("controls and super steps tried, at most", len(SHARES) * lengths) as bar:
        for number, share in enumerate(SHARES):

            def on_try(tries: int, before: int = number * lengths) -> None:
                bar.advance_to(before + tries)

            motion = _motion_under(search, values, share, on_try)
            if stance is not None and motion is not None and motion.upright < MOST:
                tried.append(motion)
                values = _before_it_falls(values, stance)
                motion = _motion_under(search, values, share, on_try)
            if motion is not None:
                tried.append(motion)
                is_upright = motion.upright >= MOST or not stance or not stance.is_held
                if is_upright and search.is_good(motion):
                    return motion
            on_try(lengths)
    if not tried:
        raise BadFileError(_explosion(values, model))
    upright = [motion for motion in tried if motion.upright >= MOST]
    good = [motion for motion in tried if search.is_good(motion)]
    best = upright or good or tried
    # If narrowing does not help, the controls are at least used in full.
    fullest = [motion for motion in best if motion.share == best[0].share]
    return max(fullest, key=lambda motion: motion.upright)


def _before_it_falls(values: Draft, stance: Stance) -> Draft:
    """Return the table with runs recorded from the start, and from higher up if the body hovers."""
    sampling = values["sampling"] | {"warm_up": 0.0}
    if stance.hovers:
        sampling["height"] = (0.0, HOVER_HEIGHT)
    return values | {"sampling": sampling}


def _motion_under(
    search: MotionSearch, values: Draft, share: float, on_try: Callable[[int], None]
) -> TriedMotion | None:
    """Return the motion under a share of the controls, in the longest super step in which nothing turns too far.

    None if half the trial runs diverge. `on_try` is called with the number of lengths tried.
    """
    step = float(search.model.opt.timestep)
    counts = [max(1, round(min(dt, search.longest) / step)) for dt in SUPER_STEPS]
    controls = _narrowed(search, values["control"], share)
    motion = None
    for number, substeps in enumerate(dict.fromkeys(counts)):
        on_try(number)
        if motion is not None and motion.speed * substeps * step > HOPEFUL * MAX_TURN:
            continue
        draft = values | {"control": controls, "substeps": substeps}
        trial = _fill_sampling(draft, search)
        if trial is None:
            return None
        system = system_of(draft, search.model)
        joint, speed = fastest_turning(system, trial)
        upright = float(are_upright(system, search.stance, trial.states).mean())
        motion = TriedMotion(draft, trial, joint, speed, share, upright)
        if motion.turn <= MAX_TURN:
            break
    return motion


def _narrowed(
    search: MotionSearch, bounds: dict[str, tuple[float, float]], share: float
) -> dict[str, tuple[float, float]]:
    """Return `share` of the range of each control, around the holding control if the root may fall.

    A servo of a fixed model keeps its range: the model is held in any pose.
    """
    may_fall = has_free_root(search.model)
    narrowed = {}
    for control, (name, (low, high)) in enumerate(bounds.items()):
        center = (low + high) / 2
        half = (high - low) / 2
        reach = share * half
        held = float(search.hold.controls[control])
        is_off = bool(search.hold.source) and abs(held - center) > OFF_MIDDLE * half
        room = half - abs(held - center)
        if may_fall and is_off and room >= MIN_ROOM * half:
            center = held
            reach = min(reach, room)
        elif not may_fall and aims(search.model, control):
            reach = half
        narrowed[name] = (low, high)
        if reach < half:
            least = max(low, rounded(center - reach, 4))
            narrowed[name] = (least, min(high, rounded(center + reach, 4)))
    return narrowed


def _fill_sampling(values: Draft, search: MotionSearch) -> ModelTrial | None:
    """Fill in the spread of random starts, and return trial runs from there; None if half of them diverge.

    First runs begin at rest, where the ground, springs or servos matter, and show positions and velocities; those
    returned begin at the positions and velocities of these while upright.
    """
    sampling = values["sampling"] | {"velocity": {}}
    sampling["position"] = dict(sampling["position"])
    values["sampling"] = sampling
    system = system_of(values, search.model)
    trial = run_trial(system, values["substeps"])
    if 2 * trial.diverged >= trial.runs:
        return None
    is_upright = are_upright(system, search.stance, trial.states)
    if FEW <= is_upright.mean() < 1:
        trial = trial._replace(states=trial.states[is_upright][None])
    for view in system.views:
        _fill_joint(sampling, system, trial, view)
        if search.resets is not None and view.name in sampling["position"]:
            _cover(sampling["position"], system, search.resets, view)
    velocities = usual_velocities(system, trial.states)
    if search.resets is not None:
        for name, reset in usual_velocities(system, search.resets).items():
            velocities[name] = tuple(map(max, velocities[name], reset))
    sampling["velocity"] = velocities
    trial = run_trial(system_of(values, search.model), values["substeps"])
    return None if 2 * trial.diverged >= trial.runs else trial


def _fill_joint(sampling: Draft, system: ModelSystem, trial: ModelTrial, view: JointView) -> None:
    """Fill in the spread of one joint's random starts from `trial`, unless it is given."""
    position = sampling["position"]
    first = view.position_entry
    if view.feature == "placed":
        level = slice(first, first + 2)
        distances = np.abs(trial.states[..., level] - system.rest[level])
        reach = float(np.clip(np.percentile(distances, FASTEST), *REACHES))
        position[view.name] = rounded(reach, 2)
    if view.kind == "free" and view.index == 0:
        orientation = slice(first + 3, first + 7)
        tilt = _usual_tilt(trial.states[..., orientation], system.rest[orientation])
        sampling["tilt"] = rounded(float(np.clip(tilt, *TILTS)), 2)
    if view.name in position:
        return
    if view.kind == "ball":
        position[view.name] = BALL_SPREAD
    elif view.feature in ("sine", "plain"):
        limits = (-FAR, FAR)
        if is_limited(system.model, view.index):
            limits = tuple(system.model.jnt_range[view.index])
        ends = occurring_range(trial, first, limits)
        is_all_round = view.feature == "sine" and ends[1] - ends[0] > 2 * np.pi
        position[view.name] = ANGLE_SPREAD if is_all_round else ends


def _cover(
    position: Draft, system: ModelSystem, resets: Float[np.ndarray, "B S"], view: JointView
) -> None:
    """Widen the spread of a hinge's or a slide's random starts so that it covers `resets`."""
    if view.kind not in ("hinge", "slide"):
        return
    entry = view.position_entry
    ends = position[view.name]
    if not isinstance(ends, tuple):
        ends = (system.rest[entry] - ends, system.rest[entry] + ends)
    first = resets[:, entry].min()
    last = resets[:, entry].max()
    if first < ends[0] or last > ends[1]:
        room = ROOM * (last - first)
        position[view.name] = (
            round(float(min(ends[0], first - room)), 4),
            round(float(max(ends[1], last + room)), 4),
        )


def _usual_tilt(orientations: Float[np.ndarray, "B T 4"], rest: Float[np.ndarray, " 4"]) -> float:
    """Return the standard deviation of the tilt of `orientations` from upright, as at rest [rad]."""
    # The world's vertical in the body's own frame, at rest and later.
    vertical = np.array([0.0, 0.0, 1.0])
    up = rotate_back(orientations, np.broadcast_to(vertical, (*orientations.shape[:2], 3)))
    tilt = np.arccos(np.clip(up @ rotate_back(rest, vertical), -1, 1))
    # The tilt is two angles, about two level axes.
    return float(np.sqrt(np.mean(tilt**2) / 2))


def _explosion(values: Draft, model: mujoco.MjModel) -> str:
    """Return the error about a model whose trial runs diverge, with a step that works if one does."""
    step = float(model.opt.timestep)
    fault = (
        f"{values['model']}: most trial runs under random controls diverged at the model's own step of {step:g} s, "
        f"even with {SHARES[-1]:.3g} of the controls' range."
    )
    for integrator in (values["physics"]["integrator"], *STIFF_INTEGRATORS):
        for parts in SMALLER_STEPS:
            smaller = rounded(step / parts, 12)
            physics = values["physics"] | {"step": smaller, "integrator": integrator}
            system = system_of(values | {"physics": physics}, model)
            is_able = integrator in system.integrators
            if is_able and not run_trial(system, values["substeps"] * parts).diverged:
                option = f'<option timestep="{smaller:g}" integrator="{integrator}"/>'
                if is_urdf(values):
                    option = f"<mujoco>{option}</mujoco>"
                return f"{fault} None did with {option}: set that in the model."
    joint = _wildest_joint(values, model)
    return f"{fault} {joint} diverges first: use weaker actuators, more damping, or heavier bodies there."


def _wildest_joint(values: Draft, model: mujoco.MjModel) -> str:
    """Return the name of the fastest joint when the model has exploded under random controls from rest."""
    system = system_of(values, model)
    rng = np.random.default_rng(0)
    data = mujoco.MjData(model)
    system.put(data, system.rest)
    with warnings_counted:
        for _ in range(EXPLOSION_STEPS):
            data.ctrl[:] = rng.uniform(system.bounds.low, system.bounds.high)
            mujoco.mj_step(model, data)
            if not np.abs(data.qvel).max() < DIVERGED_VELOCITY:
                break
    # Of several that are NaN the first counts.
    return joint_name(model, int(model.dof_jntid[np.argmax(np.abs(data.qvel))]))


def is_urdf(values: Draft) -> bool:
    """Return whether a drafted definition is of a URDF, in which fewer values are the model's own."""
    return values["model"].lower().endswith(".urdf")


def free_spread(model: mujoco.MjModel, joint: int) -> float | tuple[float, float] | None:
    """Return the spread of a joint's random starts, as in `Sampling.position`; None if trial runs should show it.

    Springs, servos and what a joint hits decide its positions; else it is its range, or a whole turn.
    """
    kind = joint_kind(model, joint)
    if kind in ("hinge", "ball") and turns_freely(model, joint):
        return ANGLE_SPREAD
    # No plane is invariant along all three axes.
    is_decided = obstacle(model, joint, np.eye(3)) or has_spring(model, joint)
    if kind == "free" or is_decided or has_servo(model, joint):
        return None
    if kind == "ball":
        return BALL_SPREAD
    if is_limited(model, joint):
        low, high = model.jnt_range[joint]
        if kind == "slide" and not _is_driven(model, joint):
            rest = model.qpos0[model.jnt_qposadr[joint]]
            low = max(low, rest - UNDRIVEN_REACH)
            high = min(high, rest + UNDRIVEN_REACH)
        return round(float(low), 4), round(float(high), 4)
    return None


def turns_freely(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether a hinge or a ball may turn all the way round: no stop, spring, servo or other body is in its way.

    Tried from the reference pose, about every axis of its own.
    """
    if is_limited(model, joint) or has_spring(model, joint) or has_servo(model, joint):
        return False
    data = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, data)
    usual = _depth(data)
    for axis in np.flatnonzero(model.dof_jntid == joint):
        for angle in TURNS:
            turn = np.zeros(model.nv)
            turn[axis] = angle
            data.qpos[:] = model.qpos0
            mujoco.mj_integratePos(model, data.qpos, turn, 1.0)
            mujoco.mj_fwdPosition(model, data)
            if _depth(data) < usual - MIN_DEPTH * model.stat.extent:
                return False
    return True


def _depth(data: mujoco.MjData) -> float:
    """Return the smallest distance at a contact [m], negative if geoms overlap; 0 without any."""
    return float(data.contact.dist.min(initial=0.0))


def _is_driven(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether an actuator drives a joint of the same tree of bodies; one without a joint counts for all."""
    tree_of = model.body_rootid[model.jnt_bodyid]
    driven = np.array(
        [actuated_joint(model, actuator) for actuator in actuators_of_controls(model).tolist()]
    )
    return bool(((driven < 0) | (tree_of[driven] == tree_of[joint])).any())


def system_of(values: Draft, model: mujoco.MjModel) -> ModelSystem:
    """Return the system of a drafted definition."""
    return ModelSystem(check_table(values, values["model"], Definition), model)
