"""How a model moves under its own controls, and so what controls, starts and super step are proposed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.model import Definition
from neuroanimator.errors import BadFileError
from neuroanimator.scaffold.defaults import (
    ANGLE_SPREAD,
    FASTEST,
    MAX_TURN,
    WANTED_SUPER_STEP,
    tidy,
)
from neuroanimator.scaffold.holding import Hold
from neuroanimator.scaffold.stance import Posture, Stance, posture_of, stance_of
from neuroanimator.scaffold.surroundings import (
    actuated_joint,
    has_free_root,
    has_servo,
    has_spring,
    servo_of,
)
from neuroanimator.scaffold.trials import (
    MAX_GROWTH,
    Trial,
    fastest_turning,
    occurring_range,
    run_trial,
    two_digits,
    usual_velocities,
)
from neuroanimator.state.rotation import rotate
from neuroanimator.systems.rigid.bones import JOINT_NAMES
from neuroanimator.systems.rigid.joints import JointView, joint_name
from neuroanimator.systems.rigid.model_system import ModelSystem
from neuroanimator.systems.rigid.mujoco_system import DIVERGED_VELOCITY
from neuroanimator.systems.rigid.touching import is_limited, touching_geoms
from neuroanimator.systems.rigid.warnings import warnings_counted
from neuroanimator.tables import check_table
from neuroanimator.terminal import progress_bar

SUPER_STEPS = (0.1, 0.08, 0.06, 0.05, 0.04, 0.03, 0.02)
"""Super steps of about these lengths are tried, the longest first [s]."""


HOPEFUL = 2.5
"""Maximum factor by which things may turn too far, at the last speeds, for a shorter super step to be tried."""


ENOUGH = 0.04
"""Length of the super step [s] for which controls of a model that only they hold are narrowed."""

BEARABLE = 1.5
"""Minimum factor by which things would turn too far, even in the shortest super step, for others' controls to be narrowed."""

SHARES = (1.0, 0.5, 0.25, 0.125)
"""Controls are tried over these shares of their room, the largest first."""


MOST = 0.5
"""Least share of the time that a root should be upright in the data."""

FEW = 0.05
"""Where the root is upright for less than this share of the time, starts are spread as all trial runs show it."""

HOVER_HEIGHT = 2.0
"""Highest random start, over its rest, of a body that only its controls hold in the air [m]."""

OFF_MIDDLE = 0.02
"""What holds a model is off the middle of a control's range if it is by more than this share of it."""


MIN_ROOM = 0.1
"""Controls are centred on what holds the model if they have at least this share of half their range on either side."""


BALL_SPREAD = 0.5
"""Random starts of a ball joint have this standard deviation [rad]."""


TILTS = (0.1, 0.5)
"""A free root starts with a tilt of at least and at most this standard deviation [rad]."""


REACHES = (0.05, 2.0)
"""Minimum and maximum distance from rest along x and y [m] at which a free body starts whose place matters."""

UNDRIVEN_REACH = 1.0
"""A slide with a range in a part that nothing drives, such as a thing to be pushed, starts within this of rest [m]."""

FAR = 10.0
"""A slide that goes farther than this in a trial run goes away [m]."""


SMALLER_STEPS = (2, 5, 10)
"""If a model explodes, its step cut into these numbers of parts is tried, so that the error can name one that works."""


EXPLOSION_STEPS = 2000
"""Number of steps for which a model that explodes is watched, to see which of its joints does so first."""


class Motion(NamedTuple):
    """How a model moves under controls over some share of their room."""

    values: dict[str, Any]
    """The definition's table, controls, sampling and super step filled in."""
    trial: Trial
    joint: str
    """The joint that turns fastest."""
    speed: float
    """How fast it turns [rad/s]."""
    share: float
    stance: Stance | None
    """How its root stands at rest; none of one that cannot fall."""
    posture: Posture
    """Of the trial's states."""

    @property
    def upright(self) -> float:
        """Share of the time in which the root is upright."""
        return float(self.posture.is_upright.mean())

    def in_words(self) -> str:
        """Return how its root spends the time of trial runs."""
        airborne = float(self.posture.is_airborne.mean())
        return f"upright for {self.upright:.0%} of the time, in the air for {airborne:.0%}"

    @property
    def dt(self) -> float:
        """Time one super step covers [s]."""
        return self.trial.dt

    @property
    def is_slow(self) -> bool:
        """Whether nothing turns too far in a super step to be learned."""
        return self.speed * self.dt <= MAX_TURN

    def is_good(self, must_be_held: bool, longest: float) -> bool:
        """Return whether the controls need not be narrowed further; `longest` is the longest super step there may be [s].

        A model that only its controls hold is not flung about: that takes super steps of some length.
        """
        if must_be_held:
            return self.is_slow and self.dt >= min(ENOUGH, longest)
        return self.speed * self.dt <= BEARABLE * MAX_TURN


def choose_motion(
    values: dict[str, Any], model: mujoco.MjModel, hold: Hold, growth: float
) -> Motion:
    """Return controls, sampling and super step with which the model does what can be learned.

    The whole room of the controls, if the super step need not become too short for that, and if a root that may fall is
    then upright most of the time; else a smaller share of it. Where a root falls, it is not driven before a run is
    recorded, and starts higher if it hovers.
    Raises BadFileError if the model explodes whatever is tried.
    """
    longest = WANTED_SUPER_STEP
    if growth > 0:
        longest = max(SUPER_STEPS[-1], min(longest, MAX_GROWTH / growth))
    must_be_held = has_free_root(model) and bool(hold.source)
    stance = stance_of(system_of(values, model), hold)
    tried: list[Motion] = []
    with progress_bar("shares of the controls tried", len(SHARES)) as bar:
        for number, share in enumerate(SHARES):
            motion = _motion_under(values, model, hold, share, longest, stance)
            if stance is not None and motion is not None and motion.upright < MOST:
                tried.append(motion)
                values = _before_it_falls(values, stance)
                motion = _motion_under(values, model, hold, share, longest, stance)
            if motion is not None:
                tried.append(motion)
                is_upright = motion.upright >= MOST or not stance or not stance.is_held
                if is_upright and motion.is_good(must_be_held, longest):
                    return motion
            bar.advance_to(number + 1)
    if not tried:
        raise BadFileError(_explosion(values, model))
    upright = [motion for motion in tried if motion.upright >= MOST]
    slow = [motion for motion in tried if motion.is_good(must_be_held, longest)]
    best = upright or slow or tried
    # What does not help leaves at least the controls to be used in full.
    fullest = [motion for motion in best if motion.share == best[0].share]
    return max(fullest, key=lambda motion: motion.upright)


def _before_it_falls(values: dict[str, Any], stance: Stance) -> dict[str, Any]:
    """Return the table with runs recorded from their very start, from higher up if the body hovers."""
    sampling = values["sampling"] | {"warm_up": 0.0}
    if stance.hovers:
        sampling["height"] = (0.0, HOVER_HEIGHT)
    return values | {"sampling": sampling}


def _motion_under(
    values: dict[str, Any],
    model: mujoco.MjModel,
    hold: Hold,
    share: float,
    longest: float,
    stance: Stance | None,
) -> Motion | None:
    """Return the motion under a share of the controls, in the longest super step that nothing turns too far in.

    None if half the trial runs diverge.
    """
    controls = _narrowed(model, values["control"], hold, share)
    step = float(model.opt.timestep)
    motion = None
    for substeps in _substeps_to_try(step, longest):
        if motion is not None and motion.speed * substeps * step > HOPEFUL * MAX_TURN:
            continue
        draft = values | {"control": controls, "substeps": substeps}
        trial = _fill_sampling(draft, model, stance)
        if trial is None:
            return None
        system = system_of(draft, model)
        joint, speed = fastest_turning(system, trial)
        posture = posture_of(system, stance, trial.states)
        motion = Motion(draft, trial, joint, speed, share, stance, posture)
        if motion.is_slow:
            break
    return motion


def _substeps_to_try(step: float, longest: float) -> Iterator[int]:
    """Yield numbers of steps in a super step, the largest first; at least one."""
    last = 0
    for dt in SUPER_STEPS:
        substeps = max(1, round(min(dt, longest) / step))
        if substeps != last:
            yield substeps
        last = substeps


def _narrowed(
    model: mujoco.MjModel, bounds: dict[str, tuple[float, float]], hold: Hold, share: float
) -> dict[str, tuple[float, float]]:
    """Return `share` of the range of each control, around what holds the model where that is a root that may fall.

    A servo of a model that stands fixed keeps its range: wherever it goes, the model is held.
    """
    may_fall = has_free_root(model)
    narrowed = {}
    for actuator, (name, (low, high)) in enumerate(bounds.items()):
        center = (low + high) / 2
        half = (high - low) / 2
        reach = share * half
        held = float(hold.controls[actuator])
        is_off = bool(hold.source) and abs(held - center) > OFF_MIDDLE * half
        room = half - abs(held - center)
        if may_fall and is_off and room >= MIN_ROOM * half:
            center = held
            reach = min(reach, room)
        elif not may_fall and servo_of(model, actuator):
            reach = half
        ends = (low, high)
        if reach < half:
            ends = (max(low, tidy(center - reach, 4)), min(high, tidy(center + reach, 4)))
        narrowed[name] = ends
    return narrowed


def _fill_sampling(
    values: dict[str, Any], model: mujoco.MjModel, stance: Stance | None
) -> Trial | None:
    """Fill in how random starts are spread, and return trial runs from there; None if half of them diverge.

    First runs begin at rest, where the ground, springs or servos decide, and show positions and velocities; those
    returned begin where and as fast as these went while upright.
    """
    sampling = values["sampling"] | {
        "velocity": {},
        "position": dict(values["sampling"]["position"]),
    }
    values["sampling"] = sampling
    system = system_of(values, model)
    trial = run_trial(system, values["substeps"])
    if trial.explodes:
        return None
    is_upright = posture_of(system, stance, trial.states).is_upright
    if FEW <= is_upright.mean() < 1:
        trial = trial._replace(states=trial.states[is_upright][None])
    for view in system.views:
        _fill_joint(sampling, system, trial, view)
    sampling["velocity"] = usual_velocities(system, trial)
    trial = run_trial(system_of(values, model), values["substeps"])
    if trial.explodes:
        return None
    return trial


def _fill_joint(
    sampling: dict[str, Any], system: ModelSystem, trial: Trial, view: JointView
) -> None:
    """Fill in how random starts of one joint are spread, as `trial` shows it, unless that is said already."""
    position = sampling["position"]
    if view.feature == "placed":
        position[view.name] = _usual_reach(trial, view.position_entry, system.rest)
    if view.kind == "free" and view.index == 0:
        sampling["tilt"] = _usual_tilt(trial, view.position_entry + 3, system.rest)
    if view.name in position:
        return
    if view.kind == "ball":
        position[view.name] = BALL_SPREAD
    elif view.feature in ("sine", "plain"):
        limits = (-FAR, FAR)
        if is_limited(system.model, view.index):
            limits = tuple(system.model.jnt_range[view.index])
        ends = occurring_range(trial, view.position_entry, limits)
        if view.feature == "sine" and ends[1] - ends[0] > 2 * np.pi:
            position[view.name] = ANGLE_SPREAD
        else:
            position[view.name] = ends


def _usual_reach(trial: Trial, entry: int, rest: Float[np.ndarray, " S"]) -> float:
    """Return how far from rest a free body goes along x or y [m], seldom-reached places left out, within `REACHES`."""
    level = slice(entry, entry + 2)
    distances = np.abs(trial.states[..., level] - rest[level])
    return two_digits(float(np.clip(np.percentile(distances, FASTEST), *REACHES)))


def _usual_tilt(trial: Trial, entry: int, rest: Float[np.ndarray, " S"]) -> float:
    """Return the standard deviation of the tilt of an orientation from its upright at rest [rad], within `TILTS`."""
    upright = np.array([0.0, 0.0, 1.0])
    # What is up at rest, in the body's own axes.
    inverse = rest[entry : entry + 4] * [1, -1, -1, -1]
    own_up = rotate(inverse, upright)
    up = rotate(
        trial.states[..., entry : entry + 4], np.broadcast_to(own_up, (*trial.states.shape[:2], 3))
    )
    tilt = np.arccos(np.clip(up[..., 2], -1, 1))
    # Of two angles, about two level axes.
    deviation = np.sqrt(np.mean(tilt**2) / 2)
    return two_digits(float(np.clip(deviation, *TILTS)))


def _explosion(values: dict[str, Any], model: mujoco.MjModel) -> str:
    """Return the error about a model whose trial runs diverge, with a step that works if one does."""
    step = float(model.opt.timestep)
    fault = (
        f"{values['model']}: most trial runs under random controls diverged at the model's own step of {step:g} s, "
        f"even with {SHARES[-1]:.3g} of the controls' range."
    )
    for integrator in (values["physics"]["integrator"], "implicitfast"):
        for parts in SMALLER_STEPS:
            physics = values["physics"] | {"step": tidy(step / parts), "integrator": integrator}
            system = system_of(values | {"physics": physics}, model)
            trial = run_trial(system, values["substeps"] * parts)
            if not trial.diverged:
                option = f'<option timestep="{tidy(step / parts):g}" integrator="{integrator}"/>'
                if values["model"].lower().endswith(".urdf"):
                    option = f"<mujoco>{option}</mujoco>"
                return f"{fault} None did with {option}: set that in the model."
    joint = _wildest_joint(values, model)
    return f"{fault} {joint} is flung first: use weaker actuators, more damping, or heavier bodies there."


def _wildest_joint(values: dict[str, Any], model: mujoco.MjModel) -> str:
    """Return the name of the joint that is fastest when the model at rest has come apart under random controls."""
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
    speeds = np.nan_to_num(np.abs(data.qvel), nan=np.inf)
    return joint_name(model, int(model.dof_jntid[int(np.argmax(speeds))]))


def free_spread(model: mujoco.MjModel, joint: int) -> float | tuple[float, float] | None:
    """Return the spread of a joint's random starts, as `Sampling.position` says; None if trial runs should show it.

    Springs, servos and the ground decide where a joint occurs; else it is its range, or a whole turn.
    """
    kind = JOINT_NAMES[int(model.jnt_type[joint])]
    is_swung = not (has_spring(model, joint) or has_servo(model, joint) or _meets(model, joint))
    if kind == "free" or not is_swung:
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
    if kind == "hinge":
        return ANGLE_SPREAD
    return None


def _is_driven(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether an actuator drives a joint of the same tree of bodies; one that is on no joint counts as any's."""
    tree = model.body_rootid[model.jnt_bodyid[joint]]
    for actuator in range(model.nu):
        driven = actuated_joint(model, actuator)
        if driven < 0 or model.body_rootid[model.jnt_bodyid[driven]] == tree:
            return True
    return False


def _meets(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether the bodies a joint belongs to can touch anything else than one another."""
    tree = model.body_rootid[model.jnt_bodyid[joint]]
    is_own = model.body_rootid[model.geom_bodyid[touching_geoms(model)]] == tree
    return bool((is_own.any(axis=1) & ~is_own.all(axis=1)).any())


def system_of(values: dict[str, Any], model: mujoco.MjModel) -> ModelSystem:
    """Return the system of a drafted definition."""
    return ModelSystem(check_table(values, values["model"], Definition), model)
