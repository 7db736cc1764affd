"""Tasks of fish, trout, dolphin and orca."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.control.objective.costs import (
    effort,
    reach_heading,
    reach_position,
    smoothness,
    stay_upright,
    travel,
)
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.policies.steering import leftward, rotated_toward
from neuroanimator.files.zoo import SHIPPED_SYSTEMS
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.learn.tasks.task import FREE, Aim, Task, Trial, three
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.state.pose import Pose, read_pose
from neuroanimator.systems.system import System

FASTER_THAN_GAIT = 1.2
"""Multiple of the gait's distance, from the same start, at which a motion counts as a success."""

SLOW_START = 0.8
"""Maximum speed at the start, as a share of the gait's mean speed from there: at full speed no stroke gets farther."""

MIN_LENGTHS = 0.1
"""Minimum distance assumed for a gait [body lengths]."""

HEADING_WITHIN = math.radians(10.0)
"""Maximum deviation from the wanted heading [rad]."""

TURNS = (30.0, 90.0)
"""Minimum and maximum turn, to the left or right [degrees]."""

TARGET_WITHIN = 0.5
"""Maximum distance from the target that counts as reached [body lengths]."""

TARGET_SHARES = (0.7, 1.0)
"""Minimum and maximum distance of a target, as a share of the gait's in the time."""

TARGET_ASIDE = 60.0
"""Maximum angle of a target to the left or right [degrees]."""

ERRORS_PER_TOLERANCE = 3
"""Error of a cost per tolerance: a third of a tolerance is an error of one."""

LEAP_HEIGHT = 0.15
"""Minimum height of a leap: that of the body's centroid above the surface [body lengths]."""

LEAP_MARGIN = 1.5
"""Ratio of the height a leap aims at to the height it must reach."""

LEAP_TIME = 0.8
"""Time of a leap's highest point, as a share of the motion."""

FIRST_STRENGTH = 0.7
"""Strength of the gait in first guesses: at full strength its muscles are at their bounds."""

DEPTHS = (1.5 / 2.6, 3.0 / 2.6)
"""Minimum and maximum depth at the start of bodies that live under a surface, from 1.5 to 3 m of the dolphin [body lengths]."""

STARTS_AT_ONCE = 16
"""Number of starts drawn side by side for flesh under a surface: most are at another depth, and its physics is expensive."""

ROLL_WITHIN = math.radians(30.0)
"""Maximum roll of a successful motion [rad]."""

SWIMMING_UPRIGHT = 0.3
"""Weight of staying upright with one pattern for the whole motion: with 1, few fish get farther than by their gait."""

LEVEL_WITHIN = 0.3
"""Maximum slope of starts up or down: the vertical component of the heading's unit vector."""

UPRIGHT_WITHIN = 0.9
"""Minimum vertical component of the unit vector of a start's back."""


def swim(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a swimmer that is not yet at full speed; it is to swim as far ahead as it can."""
    length = body_length(system)
    gait = gait_controls(system, steps, dt)
    while True:
        start = swimming_start(system, rng)
        pose = read_pose(system.structure, start)
        usual = distance_ahead(system, pose, simulate_one(system, start, gait, dt))
        if pose.velocity @ pose.forward < SLOW_START * usual / (steps * dt):
            break
    objective = Objective.of(
        effort(0.1),
        smoothness(0.001),
        stay_upright(system, weight=SWIMMING_UPRIGHT),
        travel(system, pose.forward, 2 * max(usual, length), within=0.2 * length),
    )
    wanted = FASTER_THAN_GAIT * max(usual, MIN_LENGTHS * length)

    def is_far(states: np.ndarray) -> bool:
        distance = distance_ahead(system, pose, states)
        return distance > wanted and ends_upright(system, states, dt)

    aim = Aim(direction=three(pose.forward))
    return Trial(start, objective, is_far, FIRST_STRENGTH * gait, aim)


def turn(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a swimmer and a heading 30° to 90° to its left or right."""
    start = swimming_start(system, rng)
    pose = read_pose(system.structure, start)
    angle = rng.uniform(*TURNS) * rng.choice([-1, 1])
    heading = ahead(pose, math.radians(angle))
    objective = Objective.of(
        effort(0.1),
        smoothness(0.001),
        stay_upright(system),
        reach_heading(system, heading, within=HEADING_WITHIN / ERRORS_PER_TOLERANCE),
    )

    def is_turned(states: np.ndarray) -> bool:
        forward = read_pose(system.structure, states[-1]).forward
        points_there = bool(forward @ heading > math.cos(HEADING_WITHIN))
        return points_there and ends_upright(system, states, dt)

    first = FIRST_STRENGTH * gait_controls(system, steps, dt)
    return Trial(start, objective, is_turned, first, Aim(direction=three(heading)))


def reach(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a swimmer and a target as far away as it gets in the time, up to 60° to its left or right."""
    start = swimming_start(system, rng)
    length = body_length(system)
    pose = read_pose(system.structure, start)
    gait = gait_controls(system, steps, dt)
    share = rng.uniform(*TARGET_SHARES)
    end = read_pose(system.structure, simulate_one(system, start, gait, dt)[-1])
    usual = float(np.linalg.norm(end.position - pose.position))
    far = share * max(usual, length)
    angle = rng.uniform(-TARGET_ASIDE, TARGET_ASIDE)
    target = pose.position + far * ahead(pose, math.radians(angle))
    within = TARGET_WITHIN * length
    objective = Objective.of(
        effort(0.1),
        smoothness(0.001),
        stay_upright(system),
        reach_position(system, target, within=within / ERRORS_PER_TOLERANCE),
    )

    def is_there(states: np.ndarray) -> bool:
        off = np.linalg.norm(read_pose(system.structure, states[-1]).position - target)
        return bool(off < within) and ends_upright(system, states, dt)

    return Trial(start, objective, is_there, FIRST_STRENGTH * gait, Aim(three(target)))


def leap(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a swimmer under the surface; near the end it is to be in the air, back up. It may pitch freely."""
    start = swimming_start(system, rng)
    length = body_length(system)
    height = LEAP_HEIGHT * length
    aimed = height * LEAP_MARGIN
    objective = Objective.of(
        effort(0.1),
        smoothness(0.001),
        stay_upright(system, may_pitch=True),
        reach_position(system, [aimed], within=0.1 * length, axes="z", at=LEAP_TIME * steps * dt),
    )

    def is_flying(states: np.ndarray) -> bool:
        pose = read_pose(system.structure, states)
        top = int(np.argmax(pose.position[:, 2]))
        return bool(pose.position[top, 2] > height and abs(pose.roll[top]) < ROLL_WITHIN)

    first = FIRST_STRENGTH * gait_controls(system, steps, dt)
    return Trial(start, objective, is_flying, first, Aim((FREE, FREE, aimed)))


def simulate_one(
    system: System, start: Float[np.ndarray, " S"], controls: Float[np.ndarray, "T C"], dt: float
) -> Float[np.ndarray, "T+1 S"]:
    """Return the states from `start` (S,) under `controls` (T, C), each held for `dt` [s]."""
    return system.simulate_fastest(start[None], controls[None], dt).states[0]


def swimming_start(system: System, rng: np.random.Generator) -> np.ndarray:
    """Return a state (S,) in the midst of random swimming, nearly level; under the surface, if there is one.

    A system without weight has no up and down and swims at any orientation: it is turned upright as a whole, which changes
    nothing else.
    """
    is_dear = system.structure.swimmer is not None and system.water_surface is not None
    while True:
        for start in sample_starts(system, rng, STARTS_AT_ONCE if is_dear else 1):
            if not system.structure.has_gravity:
                assert isinstance(system, DeformableSystem)
                return turned_upright(system, start)
            pose = read_pose(system.structure, start)
            is_level = abs(pose.forward[2]) < LEVEL_WITHIN and pose.upward[2] > UPRIGHT_WITHIN
            if is_level and is_deep(system, pose):
                return start


def is_deep(system: System, pose: Pose) -> bool:
    """Return whether a swimmer is at one of the `DEPTHS`; at any, if its water has no surface."""
    if system.water_surface is None:
        return True
    depth = (system.water_surface - pose.position[2]) / body_length(system)
    return bool(DEPTHS[0] < depth < DEPTHS[1])


def turned_upright(system: DeformableSystem, state: np.ndarray) -> np.ndarray:
    """Return `state` (S,) turned about its centroid until it points along X in the world, its back up."""
    pose = read_pose(system.structure, state)
    left = np.cross(pose.upward, pose.forward)
    left /= np.linalg.norm(left)
    turn = np.stack([pose.forward, left, np.cross(pose.forward, left)])
    positions, velocities, activations = system.unpack(state)
    return system.pack(
        (positions - pose.position) @ turn.T + pose.position,
        velocities @ turn.T,
        activations,
        state[..., system.parameter_entries],
    )


def ends_upright(system: System, states: np.ndarray, dt: float) -> bool:
    """Return whether `states` (T+1, S), `dt` [s] apart, roll by less than `ROLL_WITHIN` over the last period."""
    last = steps_of_a_period(system, dt)
    return bool(np.abs(read_pose(system.structure, states[-1 - last :]).roll).max() < ROLL_WITHIN)


def steps_of_a_period(system: System, dt: float) -> int:
    """Return the number of super steps of `dt` [s] in a period of a swimmer's gait."""
    assert system.gait is not None
    return math.ceil(system.gait.period / dt)


def body_length(system: System) -> float:
    """Return the length of a deformable body at rest [m]."""
    assert system.body_length is not None
    return system.body_length


def gait_controls(system: System, steps: int, dt: float) -> np.ndarray:
    """Return the controls (T, C) of the system's own gait."""
    assert system.gait is not None
    return system.gait.controls(steps, dt, system.bounds)


def distance_ahead(system: System, pose: Pose, states: np.ndarray) -> float:
    """Return the distance [m] that `states` (T+1, S) cover in the direction of `pose`."""
    return float((read_pose(system.structure, states[-1]).position - pose.position) @ pose.forward)


def ahead(pose: Pose, angle: float) -> np.ndarray:
    """Return the direction (3,) `angle` [rad] to the left of where a body points, in the body's own XY plane."""
    return rotated_toward(leftward(pose), pose.forward, angle)


def upright_tasks(
    system: str, swim_by: dict[str, Any], turn_by: dict[str, Any], reach_by: dict[str, Any]
) -> tuple[Task, ...]:
    """Return the tasks shared by all swimmers; the arguments are the fields of `Task` that differ, such as what each varies."""
    upright = f"rolled by less than {math.degrees(ROLL_WITHIN):.0f}° over the last period"
    turned = (
        f"points within {math.degrees(HEADING_WITHIN):.0f}° of the heading at the end, {upright}"
    )
    farther = f"gets {FASTER_THAN_GAIT} times as far as by its gait, {upright}"
    near = f"ends within {TARGET_WITHIN} body lengths of the target, {upright}"
    given = {"seconds": SECONDS, "system": system, "substeps": SHIPPED_SYSTEMS[system].substeps[0]}
    return (
        Task(f"{system}-swim", success=farther, draw=swim, **(given | swim_by)),
        Task(f"{system}-turn", success=turned, draw=turn, **(given | turn_by)),
        Task(f"{system}-reach", success=near, draw=reach, **(given | reach_by)),
    )


def fish_tasks(system: str, turn_by: dict[str, Any]) -> tuple[Task, ...]:
    """Return the tasks of a small swimmer."""
    return upright_tasks(
        system,
        swim_by={"is_periodic": True, "method": "adam"},
        turn_by=turn_by,
        reach_by={"is_periodic": True},
    )


def leap_task(system: str, seconds: float) -> Task:
    """Return the task of a swimmer that leaves the water."""
    success = f"its centroid rises {LEAP_HEIGHT} body lengths out of the water, there rolled by less than 30°"
    substeps = SHIPPED_SYSTEMS[system].substeps[0]
    return Task(f"{system}-leap", system, substeps, seconds, success, leap, method="adam")


SECONDS = 3.0
"""Duration of motions [s]: long enough for the dolphin to rise from its initial depth, and for the fish to swim its length."""

SWIMMER_TASKS = (
    *fish_tasks("fish", turn_by={"knots": 16}),
    # Flesh bends more slowly: a turn of 90° takes more than 3 s.
    *fish_tasks("trout", turn_by={"is_periodic": True, "seconds": 4.0}),
    *upright_tasks(
        "dolphin",
        swim_by={"method": "adam"},
        turn_by={"knots": 30},
        reach_by={"is_periodic": True},
    ),
    leap_task("dolphin", SECONDS),
    leap_task("orca", 5.0),
)
