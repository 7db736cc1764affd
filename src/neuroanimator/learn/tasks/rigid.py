"""Tasks of pendulum, truck and lander."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from neuroanimator.control.objective.costs import (
    effort,
    keep_velocity,
    reach_position,
    smoothness,
    stand_up,
)
from neuroanimator.control.objective.goals import goal_state, is_reached, reach_goal
from neuroanimator.control.objective.objective import Moments, Objective
from neuroanimator.control.objective.obstacles import Zone, avoid, distances, footprint, zone_rows
from neuroanimator.learn.tasks.task import FREE, Aim, Task, Trial, three
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.pose import Pose, read_pose
from neuroanimator.state.rotation import facing
from neuroanimator.systems.system import System

HOLD_SECONDS = 0.5
"""Time at the end of its motion throughout which the pendulum must be upright [s]."""

HOLD_STRIDE = 2
"""Stride of the super steps in that end that the cost looks at: every second is enough to hold still, at half the work."""

START_ANGLES = (math.pi / 2, 0.8, 0.8)
"""Maximum magnitude of the pendulum's joint angles at the start, which is below the horizontal [rad]."""

START_VELOCITY = 0.5
"""Standard deviation of the joints' velocities at the start, which is slow [rad/s]."""

TRUCK_LENGTH = 4.2
"""Length of the truck's outline, bumper to bumper [m]."""

TRUCK_WIDTH = 1.64
"""Width of the truck's outline [m]."""

TRUCK_PROBES = ((-1.4, 0.0), (-0.47, 0.0), (0.47, 0.0), (1.4, 0.0))
"""Points along the truck's middle, ahead and to the left, that must keep away from obstacles [m]."""

TRUCK_MARGIN = 1.05
"""Radius of discs around the probes that cover the truck with some 10 cm to spare [m]."""

TRUCK_AVOIDANCE = 300.0
"""Weight of keeping out of obstacles: a truck a centimetre inside one for a second costs the same as an error of 0.2."""

AISLE = (6.5, 2.0)
"""Half the extent along x and y of the area of the truck's starts [m]."""

CLEAR_START = 0.5
"""Minimum distance of the truck's start from every obstacle [m]."""

BAYS = 6
"""Number of parking bays in the lot."""

OUTLINE_POINTS = (13, 7)
"""Number of checked points of the truck's outline, along it and across it: every 35 cm or less."""

POST = 5
"""MuJoCo's type number of the lot's posts, which are cylinders (`mjGEOM_CYLINDER`)."""

OBSTACLE_GROUP = 2
"""Group of the geoms that are obstacles of the truck's lot."""

TOUCHDOWN_SPEED = 1.0
"""Maximum speed of a soft landing [m/s]."""

TOUCHDOWN_LEAN = math.radians(10.0)
"""Maximum lean of a soft landing [rad]."""

PAD_RADIUS = 1.0
"""Maximum distance from the pad's middle of a landing on the pad [m]."""

CONE_HEIGHTS = (8.0, 14.0)
"""Minimum and maximum height of the lander's start above its pad [m]."""

CONE_SLOPE = 0.35
"""Maximum sideways distance of the lander's start, as a share of its height above the pad."""

LANDER_START_HEADING = 0.5
"""Maximum rotation of the lander's starts about the vertical [rad]."""

LANDER_START_VELOCITIES = (0.4, 0.4, 0.4, 0.05, 0.05, 0.05)
"""Standard deviations of the lander's velocities at the start [m/s and rad/s]."""

FINAL_DESCENT_SECONDS = 1.5
"""Time before the end at which the lander is to be above its pad, to sink slowly from there [s]."""

FINAL_DESCENT_HEIGHT = 0.7
"""Height at that time above the height at rest [m]."""

FINAL_DESCENT_VELOCITY = 0.5
"""Velocity of sinking from then on [m/s]."""

FEET = ((2.0, 2.0, -1.8), (-2.0, 2.0, -1.8), (-2.0, -2.0, -1.8), (2.0, -2.0, -1.8))
"""Middles of the lander's feet in its own frame [m]."""

FOOT_RADIUS = 0.2
"""Radius of each of the lander's feet [m]."""


def swing_up(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a start below the horizontal, slowly moving; the arm must stand throughout the last half second."""
    angles = rng.uniform(-1, 1, 3) * START_ANGLES
    velocities = rng.normal(size=3) * START_VELOCITY
    held = round(HOLD_SECONDS / dt)
    times = tuple(float((steps - i) * dt) for i in range(held, -1, -HOLD_STRIDE))
    goal = system.goals["upright"]

    def stands(states: np.ndarray) -> bool:
        return all(is_reached(system, goal, state) for state in states[-held - 1 :])

    objective = Objective.of(effort(), reach_goal(system, goal, when=Moments(times)))
    return Trial(np.concatenate([angles, velocities]), objective, stands)


def park(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a position and a heading in the aisle, and a bay; the truck must not touch anything on the way."""
    assert isinstance(system, MujocoSystem)
    zones = lot_zones(system)
    start = np.array(system.rest)
    while True:
        start[:2] = rng.uniform(-1, 1, 2) * AISLE
        start[3:7] = facing(np.array(rng.uniform(-np.pi, np.pi)))
        if clearance(system, zones, start[None]) > CLEAR_START:
            break
    goal = system.goals[f"bay_{rng.integers(1, BAYS + 1)}"]
    objective = Objective.of(
        effort(0.02),
        smoothness(0.02),
        reach_goal(system, goal),
        avoid(system, zones, probes=TRUCK_PROBES, margin=TRUCK_MARGIN, weight=TRUCK_AVOIDANCE),
    )

    def is_parked(states: np.ndarray) -> bool:
        return is_reached(system, goal, states[-1]) and clearance(system, zones, states) > 0

    def has_touched_something(states: np.ndarray) -> bool:
        return clearance(system, zones, states[-2:]) <= 0

    bay = read_pose(system.structure, goal_state(system, goal))
    x, y, _ = bay.position
    ahead_x, ahead_y, _ = bay.forward
    aim = Aim(
        position=(float(x), float(y), FREE),
        direction=(float(ahead_x), float(ahead_y), 0.0),
        is_in_a_fixed_world=True,
    )
    return Trial(start, objective, is_parked, aim=aim, has_failed=has_touched_something)


def lot_zones(system: MujocoSystem) -> list[Zone]:
    """Return the keep-out zones of the truck's lot: its geoms of `OBSTACLE_GROUP`."""
    model = system.model
    zones = []
    for geom in np.flatnonzero(model.geom_group == OBSTACLE_GROUP):
        x, y = model.geom_pos[geom, :2]
        size = model.geom_size[geom]
        if model.geom_type[geom] == POST:
            zones.append(Zone((x, y), radius=size[0]))
        else:
            zones.append(Zone((x, y), (size[0], size[1])))
    return zones


def clearance(system: System, zones: list[Zone], states: np.ndarray) -> float:
    """Return the minimum distance [m] of the truck's border from any zone in `states` (T, S); negative if it touches one."""
    points = footprint(system.structure, states, truck_outline())
    return float(distances(zone_rows(zones), points).min())


def truck_outline() -> Float[np.ndarray, "P 2"]:
    """Return points on the truck's border [m], ahead and to the left of its position."""
    along = np.linspace(-0.5, 0.5, OUTLINE_POINTS[0]) * TRUCK_LENGTH
    across = np.linspace(-0.5, 0.5, OUTLINE_POINTS[1]) * TRUCK_WIDTH
    ends = along[[0, -1]]
    sides = across[[0, -1]]
    points = [(x, y) for x in along for y in across if x in ends or y in sides]
    return np.array(points)


def landing_objective(system: System, over_pad: float) -> Objective:
    """Return the objective of a soft landing: above the pad and upright at `over_pad` [s], from then on slowly down."""
    x, y, z = three(system.rest[:3])
    return Objective.of(
        effort(0.05),
        reach_goal(system, system.goals["pad"]),
        reach_position(system, [x, y, z + FINAL_DESCENT_HEIGHT], within=0.3, at=over_pad),
        stand_up(system, within=0.05, at=over_pad),
        keep_velocity(
            system, [0.0, 0.0, -FINAL_DESCENT_VELOCITY], within=0.2, since=over_pad, weight=0.2
        ),
    )


def land(system: System, rng: np.random.Generator, steps: int, dt: float) -> Trial:
    """Draw a start in a cone above the pad, slowly moving and leaning; the feet must touch down softly."""
    height = rng.uniform(*CONE_HEIGHTS)
    azimuth = rng.uniform(-np.pi, np.pi)
    aside = height * CONE_SLOPE * math.sqrt(rng.uniform())
    start = np.array(system.rest)
    start[:3] += [aside * math.cos(azimuth), aside * math.sin(azimuth), height]
    heading = rng.uniform(-LANDER_START_HEADING, LANDER_START_HEADING)
    start[3:7] = facing(np.array(heading))
    start[7:13] = rng.normal(size=6) * LANDER_START_VELOCITIES
    over_pad = steps * dt - FINAL_DESCENT_SECONDS
    objective = landing_objective(system, over_pad)

    def has_landed_softly(states: np.ndarray) -> bool:
        return is_soft_landing(system, states)

    def has_crashed(states: np.ndarray) -> bool:
        return has_touched(system, states) and not is_soft_landing(system, states)

    return Trial(
        start, objective, has_landed_softly, aim=Aim(three(system.rest[:3])), has_failed=has_crashed
    )


def has_touched(system: System, states: np.ndarray) -> bool:
    """Return whether a foot has touched the ground in `states` (T, S)."""
    return bool((lowest_foot(read_pose(system.structure, states)) <= 0.0).any())


def is_soft_landing(system: System, states: np.ndarray) -> bool:
    """Return whether the lander ends on its pad, slow and upright from just before the first contact on."""
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
    """Return the height of the lowest foot's sole above the ground (T,) [m]."""
    left = np.cross(pose.upward, pose.forward)
    vertical = np.stack([pose.forward[:, 2], left[:, 2], pose.upward[:, 2]])
    return pose.position[:, 2] + (np.array(FEET) @ vertical).min(axis=0) - FOOT_RADIUS


RIGID_TASKS = (
    Task(
        "pendulum-swing-up", "pendulum", 50, 2.0,
        f"each link within 10° of upright and below 1 rad/s throughout the last {HOLD_SECONDS} s",
        swing_up, starts=16, is_held=True,
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
