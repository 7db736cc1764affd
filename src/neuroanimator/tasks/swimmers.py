"""Tasks of fish and dolphin."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from neuroanimator.control.objective.costs import (
    effort,
    reach_heading,
    reach_position,
    smoothness,
    stay_upright,
    travel,
)
from neuroanimator.control.objective.objective import Objective
from neuroanimator.data.sampling import sample_starts
from neuroanimator.state.pose import Pose, read_pose
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.systems.system import System
from neuroanimator.tasks.task import FREE, Aim, Task, Trial

FASTER_THAN_GAIT = 1.2
"""Times the way its gait makes from the same start that a found motion must make."""
HEADING_WITHIN = math.radians(10.0)
"""[rad] Off that still counts as the wanted heading."""
TARGET_WITHIN = 0.5
"""Body lengths off that still count as at the target."""
LEAP_HEIGHT = 0.15
"""Body lengths the dolphin's centroid must rise over the surface."""
FIRST_STRENGTH = 0.7
"""Of the gait, as a first guess: at full strength its muscles are at their bounds."""
DEPTHS = (-3.0, -1.5)
"""[m] Where bodies start that live under a surface."""
ROLL_WITHIN = math.radians(30.0)
"""[rad] Rolled over further, no motion counts as a success."""
SWIMMING_UPRIGHT = 0.3
"""Weight of staying upright where one pattern must do all the way: with 1, few fish come farther than by their gait."""
LEVEL_WITHIN, UPRIGHT_WITHIN = 0.3, 0.9
"""How much starts may point up or down, and how far their backs must point up: heights of unit vectors."""


def swim(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a swimmer; it shall come as far ahead as it can."""
    start, length = swimming_start(system, rng), body_length(system)
    pose = read_pose(system.structure, start)
    gait = gait_controls(system, steps, dt)
    usual = way(system, pose, system.simulate_fastest(start[None], gait[None], dt).states[0])
    far = travel(system, pose.forward, 2 * max(usual, length), within=0.2 * length)
    costs = effort(0.1), smoothness(0.001), stay_upright(system, weight=SWIMMING_UPRIGHT), far

    def is_far(states: np.ndarray) -> bool:
        return way(system, pose, states) > FASTER_THAN_GAIT * max(
            usual, 0.1 * length
        ) and ends_upright(system, states, dt)

    return Trial(
        start,
        Objective.of(*costs),
        is_far,
        FIRST_STRENGTH * gait,
        Aim(direction=three(pose.forward)),
    )


def turn(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a swimmer and a heading 30° to 90° to its left or right."""
    start = swimming_start(system, rng)
    pose, angle = read_pose(system.structure, start), rng.uniform(30, 90) * rng.choice([-1, 1])
    heading = ahead(pose, math.radians(angle))
    aim = reach_heading(system, heading, within=HEADING_WITHIN / 3)
    costs = effort(0.1), smoothness(0.001), stay_upright(system), aim

    def is_turned(states: np.ndarray) -> bool:
        forward = read_pose(system.structure, states[-1]).forward
        return bool(forward @ heading > math.cos(HEADING_WITHIN)) and ends_upright(
            system, states, dt
        )

    first = FIRST_STRENGTH * gait_controls(system, steps, dt)
    return Trial(start, Objective.of(*costs), is_turned, first, Aim(direction=three(heading)))


def reach(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a swimmer and a target as far away as it comes in the time, up to 60° to its left or right."""
    start, length = swimming_start(system, rng), body_length(system)
    pose = read_pose(system.structure, start)
    gait = gait_controls(system, steps, dt)
    far = rng.uniform(0.7, 1.0) * max(
        way(system, pose, system.simulate_fastest(start[None], gait[None], dt).states[0]), length
    )
    target = pose.position + far * ahead(pose, math.radians(rng.uniform(-60, 60)))
    aim = reach_position(system, target, within=TARGET_WITHIN * length / 3)
    costs = effort(0.1), smoothness(0.001), stay_upright(system), aim

    def is_there(states: np.ndarray) -> bool:
        off = np.linalg.norm(read_pose(system.structure, states[-1]).position - target)
        return bool(off < TARGET_WITHIN * length) and ends_upright(system, states, dt)

    return Trial(start, Objective.of(*costs), is_there, FIRST_STRENGTH * gait, Aim(three(target)))


def leap(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a dolphin under the surface; it shall fly near the end, back up. It may pitch as it likes."""
    start, length = swimming_start(system, rng), body_length(system)
    high = reach_position(
        system, [LEAP_HEIGHT * length * 1.5], within=0.1 * length, axes="z", at=0.8 * steps * dt
    )
    costs = effort(0.1), smoothness(0.001), stay_upright(system, may_pitch=True), high

    def is_flying(states: np.ndarray) -> bool:
        pose = read_pose(system.structure, states)
        top = int(np.argmax(pose.position[:, 2]))
        return bool(
            pose.position[top, 2] > LEAP_HEIGHT * length and abs(pose.roll[top]) < ROLL_WITHIN
        )

    first = FIRST_STRENGTH * gait_controls(system, steps, dt)
    return Trial(
        start, Objective.of(*costs), is_flying, first, Aim((FREE, FREE, LEAP_HEIGHT * length * 1.5))
    )


def swimming_start(system: System, rng: np.random.Generator) -> np.ndarray:
    """Return a state (S,) in the midst of random swimming, nearly level; under the surface, if there is one.

    What has neither weight nor up and down swims anyhow: it is turned upright as a whole, which changes nothing else.
    """
    assert isinstance(system, DeformableSystem)
    while True:
        start = sample_starts(system, rng, 1)[0]
        if not system.structure.has_gravity:
            return turned_upright(system, start)
        pose = read_pose(system.structure, start)
        is_deep = DEPTHS[0] < pose.position[2] < DEPTHS[1] or system.water_surface is None
        if is_deep and abs(pose.forward[2]) < LEVEL_WITHIN and pose.upward[2] > UPRIGHT_WITHIN:
            return start


def turned_upright(system: DeformableSystem, state: np.ndarray) -> np.ndarray:
    """Return `state` (S,) turned about its centroid until it points along X in the world, its back up."""
    pose = read_pose(system.structure, state)
    left = np.cross(pose.upward, pose.forward)
    left /= np.linalg.norm(left)
    turn = np.stack([pose.forward, left, np.cross(pose.forward, left)])
    positions, velocities, activations = system.unpack(state)
    return system.pack(
        (positions - pose.position) @ turn.T + pose.position, velocities @ turn.T, activations
    )


def ends_upright(system: System, states: np.ndarray, dt: float) -> bool:
    """Return whether `states` (T+1, S), `dt` [s] apart, are rolled by less than `ROLL_WITHIN` over the last period."""
    assert system.gait is not None
    last = math.ceil(system.gait.period / dt)
    return bool(np.abs(read_pose(system.structure, states[-1 - last :]).roll).max() < ROLL_WITHIN)


def three(vector: np.ndarray) -> tuple[float, float, float]:
    """Return `vector` (3,) as plain numbers."""
    x, y, z = (float(number) for number in vector)
    return x, y, z


def body_length(system: System) -> float:
    """Return how long [m] a deformable body is at rest."""
    assert system.body_length is not None
    return system.body_length


def gait_controls(system: System, steps: int, dt: float) -> np.ndarray:
    """Return (T, C) the system's own gait."""
    assert system.gait is not None
    return system.gait.controls(steps, dt, system.bounds)


def way(system: System, pose: Pose, states: np.ndarray) -> float:
    """Return how far [m] `states` (T+1, S) lead to where `pose` points."""
    return float((read_pose(system.structure, states[-1]).position - pose.position) @ pose.forward)


def ahead(pose: Pose, angle: float) -> np.ndarray:
    """Return the direction (3,) `angle` [rad] to the left of where a body points, level if its up is."""
    left = np.cross(pose.upward, pose.forward)
    return math.cos(angle) * pose.forward + math.sin(angle) * left / np.linalg.norm(left)


def tasks_of(system: str, ways: tuple[dict[str, Any], ...]) -> tuple[Task, ...]:
    """Return the tasks fish and dolphin share; `ways` say what is varied and how for each."""
    upright = f"rolled by less than {math.degrees(ROLL_WITHIN):.0f}° over the last period"
    turned = (
        f"points within {math.degrees(HEADING_WITHIN):.0f}° of the heading at the end, {upright}"
    )
    farther = f"comes {FASTER_THAN_GAIT} times as far as by its gait, {upright}"
    near = f"ends within {TARGET_WITHIN} body lengths of the target, {upright}"
    return (
        Task(f"{system}-swim", system, 50, SECONDS, farther, swim, **ways[0]),
        Task(f"{system}-turn", system, 50, SECONDS, turned, turn, **ways[1]),
        Task(f"{system}-reach", system, 50, SECONDS, near, reach, **ways[2]),
    )


SECONDS = 3.0
"""[s] Long enough for the dolphin to rise from the depth it starts at, and for the fish to come its own length."""

SWIMMER_TASKS = (
    *tasks_of("fish", ({"is_periodic": True, "method": "adam"}, {"knots": 16}, {"is_periodic": True})),
    *tasks_of("dolphin", ({"method": "adam"}, {"knots": 30}, {"is_periodic": True})),
    Task(
        "dolphin-leap", "dolphin", 50, SECONDS,
        f"its centroid rises {LEAP_HEIGHT} body lengths out of the water, there rolled by less than 30°",
        leap, method="adam",
    ),
)  # fmt: skip
