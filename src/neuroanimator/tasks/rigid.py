"""Tasks of pendulum, truck and lander."""

from __future__ import annotations

import math

import numpy as np

from neuroanimator.control.objective.costs import (
    effort,
    keep_velocity,
    reach_position,
    smoothness,
    stand_up,
)
from neuroanimator.control.objective.goals import (
    goal_state,
    is_reached,
    is_upright,
    reach_goal,
    stand_upright,
)
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.obstacles import Zone, avoid, distances, footprint, zone_rows
from neuroanimator.state.pose import Pose, read_pose
from neuroanimator.state.rotation import facing
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.system import System
from neuroanimator.tasks.task import FREE, Aim, Task, Trial

HOLD_SECONDS = 0.5
"""The pendulum must be upright throughout the last half second."""

TRUCK_LENGTH, TRUCK_WIDTH = 4.2, 1.64
"""[m]"""
TRUCK_PROBES = ((-1.4, 0.0), (-0.47, 0.0), (0.47, 0.0), (1.4, 0.0))
TRUCK_MARGIN = 1.05
"""[m] Discs of this radius about the probes cover the truck with a hand's breadth to spare."""
PARKED_PLACE, PARKED_TURN, PARKED_SPEED = 0.2, math.radians(5.0), 0.3
"""[m], [rad] and [m/s] off that still count as parked."""
AISLE = (6.5, 2.0)
"""[m] Half the extent of where the truck starts."""

TOUCHDOWN_SPEED, TOUCHDOWN_LEAN, PAD_RADIUS = 1.0, math.radians(10.0), 1.0
"""[m/s], [rad] and [m] at or below which a landing is soft, and on the pad."""
CONE = (8.0, 14.0, 0.35)
"""[m] Least and greatest height of the lander's start over its pad, and how far aside it may be, over the height."""
FEET = ((2.0, 2.0, -1.8), (-2.0, 2.0, -1.8), (-2.0, -2.0, -1.8), (2.0, -2.0, -1.8))
FOOT_RADIUS = 0.2
"""[m] Of the lander, in its own frame."""


def swing_up(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a start below the horizontal, slowly moving; the arm must stand throughout the last half second."""
    start = np.concatenate(
        [rng.uniform(-1, 1, 3) * [math.pi / 2, 0.8, 0.8], rng.normal(size=3) * 0.5]
    )
    hold = round(HOLD_SECONDS / dt)
    times = tuple(float((steps - i) * dt) for i in range(hold, -1, -2))
    return Trial(
        start, stand_upright(times=times), lambda states: all(map(is_upright, states[-hold - 1 :]))
    )


def park(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a place and a heading in the aisle, and a bay; nothing may be touched on the way."""
    assert isinstance(system, MujocoSystem)
    zones = lot_zones(system)
    start = np.array(system.rest)
    while True:
        start[:2] = rng.uniform(-1, 1, 2) * AISLE
        start[3:7] = facing(np.array(rng.uniform(-np.pi, np.pi)))
        if clearance(system, zones, start[None]) > 0.5:
            break
    goal = system.goals[f"bay_{rng.integers(1, 7)}"]
    costs = (
        effort(0.02),
        smoothness(0.02),
        reach_goal(system.structure, system.rest, goal),
        avoid(system, zones, probes=TRUCK_PROBES, margin=TRUCK_MARGIN, weight=300.0),
    )

    def is_parked(states: np.ndarray) -> bool:
        return is_reached(system, goal, states[-1]) and clearance(system, zones, states) > 0

    bay = read_pose(system.structure, goal_state(system.rest, goal))
    x, y, _ = bay.position
    ahead_x, ahead_y, _ = bay.forward
    return Trial(
        start,
        Objective.of(*costs),
        is_parked,
        aim=Aim(
            (float(x), float(y), FREE),
            (float(ahead_x), float(ahead_y), 0.0),
            is_in_a_fixed_world=True,
        ),
        has_failed=lambda states: clearance(system, zones, states[-2:]) <= 0,
    )


def lot_zones(system: MujocoSystem) -> list[Zone]:
    """Return the keep-out zones of the truck's lot: its geoms of group 2."""
    model, zones = system.model, []
    for geom in np.flatnonzero(model.geom_group == 2):
        x, y = model.geom_pos[geom, :2]
        size = model.geom_size[geom]
        is_post = model.geom_type[geom] == POST
        zones.append(Zone((x, y), radius=size[0]) if is_post else Zone((x, y), (size[0], size[1])))
    return zones


POST = 5
"""MuJoCo's number for cylinders."""


def clearance(system: System, zones: list[Zone], states: np.ndarray) -> float:
    """Return how close [m] the truck's border comes to any zone in `states` (T, S); negative if it touches one."""
    along, aside = (
        np.linspace(-0.5, 0.5, 13) * TRUCK_LENGTH,
        np.linspace(-0.5, 0.5, 7) * TRUCK_WIDTH,
    )
    sides = [(x, y) for x in along for y in aside if x in along[[0, -1]] or y in aside[[0, -1]]]
    points = footprint(system.structure, states, np.array(sides))
    return float(distances(zone_rows(zones), points).min())


def land(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a start in a cone over the pad, slowly moving and leaning; the feet must touch down softly."""
    pad, start = system.goals["pad"], np.array(system.rest)
    height, azimuth = rng.uniform(*CONE[:2]), rng.uniform(-np.pi, np.pi)
    aside = height * CONE[2] * math.sqrt(rng.uniform())
    start[:3] += [aside * math.cos(azimuth), aside * math.sin(azimuth), height]
    start[3:7] = facing(np.array(rng.uniform(-0.5, 0.5)))
    start[7:13] = rng.normal(size=6) * [0.4, 0.4, 0.4, 0.05, 0.05, 0.05]
    end = steps * dt
    costs = (
        effort(0.05),
        reach_goal(system.structure, system.rest, pad),
        reach_position(system, [*system.rest[:2], system.rest[2] + 0.7], within=0.3, at=end - 1.5),
        stand_up(system, within=0.05, at=end - 1.5),
        keep_velocity(system, [0.0, 0.0, -0.5], within=0.2, since=end - 1.5, weight=0.2),
    )
    x, y, z = (float(number) for number in system.rest[:3])
    return Trial(
        start,
        Objective.of(*costs),
        lambda states: is_soft_landing(system, states),
        aim=Aim((x, y, z)),
        has_failed=lambda states: (
            has_touched(system, states) and not is_soft_landing(system, states)
        ),
    )


def has_touched(system: System, states: np.ndarray) -> bool:
    """Return whether a foot has touched the ground in `states` (T, S)."""
    return bool((lowest_foot(read_pose(system.structure, states)) <= 0.0).any())


def is_soft_landing(system: System, states: np.ndarray) -> bool:
    """Return whether the lander ends on its pad, and was slow and upright from just before the first contact on."""
    pose = read_pose(system.structure, states)
    heights = lowest_foot(pose)
    touching = np.flatnonzero(heights <= 0.0)
    if not len(touching):
        return False
    since = max(0, touching[0] - 1)
    speed = np.linalg.norm(pose.velocity[since:], axis=1).max()
    lean = np.arccos(np.clip(pose.upward[since:, 2], -1, 1)).max()
    aside = np.linalg.norm(pose.position[-1, :2] - system.rest[:2])
    return bool(speed < TOUCHDOWN_SPEED and lean < TOUCHDOWN_LEAN and aside < PAD_RADIUS)


def lowest_foot(pose: Pose) -> np.ndarray:
    """Return (T,) [m] how high the lowest foot's sole is over the ground."""
    left = np.cross(pose.upward, pose.forward)
    rises = [x * pose.forward[:, 2] + y * left[:, 2] + z * pose.upward[:, 2] for x, y, z in FEET]
    return pose.position[:, 2] + np.min(rises, axis=0) - FOOT_RADIUS


RIGID_TASKS = (
    Task(
        "pendulum-swing-up", "pendulum", 50, 2.0,
        f"each link within 10° of upright and below 1 rad/s throughout the last {HOLD_SECONDS} s",
        swing_up, starts=16,
    ),
    Task(
        "truck-park", "truck", 100, 12.0, "within 0.2 m, 5° and 0.3 m/s of the bay, nothing touched",
        park, starts=8, knots=16,
    ),
    Task(
        "lander-land", "lander", 50, 8.0, "from just before touchdown below 1 m/s and 10°, within 1 m of the pad",
        land, starts=4, knots=20,
    ),
)  # fmt: skip
