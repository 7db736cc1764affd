"""Make the policies that ship in the package, and measure them on the true physics.

python -m tools.train_policies          all, a quarter of an hour on 2 cores, and policies*.csv of dolphin and fish
python -m tools.train_policies trout    one of them, without measuring it: benchmarks/soft_bodies/swimming.py does
python -m tools.train_policies measure  the shipped ones, without training
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from benchmarks.harness import ROOT
from neuroanimator import load_emulator, load_system
from neuroanimator.control.policies.behaviours import Tank, shoal
from neuroanimator.control.policies.closed_loop import rollout_on_emulator, rollout_on_physics
from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.policy_loss import LossWeights
from neuroanimator.control.policies.steering import (
    SteeringTarget,
    command_toward,
    leftward,
    steer_forward,
    unit,
    upright,
)
from neuroanimator.files.zoo import POLICIES, find_policy, shipped_policy
from neuroanimator.gym.policy_training import PolicyTraining, train_policy
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.learn.evaluation.csv_table import write_csv
from neuroanimator.learn.tasks.swimmers import body_length
from neuroanimator.state.pose import Pose
from neuroanimator.systems.system import System
from neuroanimator.terminal import print_table

TRAININGS = {
    "dolphin": PolicyTraining(deeper=0.0),
    "fish": PolicyTraining(updates=8000, seed=3),
    "trout": PolicyTraining(updates=6000),
    "orca": PolicyTraining(weights=LossWeights(speed=4.0)),
}
"""How each is trained. A fish comes to its speed slowly: with the usual 5,000 updates it swam at 0.09 to 0.13 m/s on the physics
where 0.08 was asked for. Of two seeds with 8,000 one left its tank by more than its length for a moment. With the usual weight of
speed an orca swam 3 % too slow."""

MEASURED = ("dolphin", "fish")
"""Those that go anywhere, also up and down."""

WORKPLACE = Path("out/policies")
"""Training writes its files to this folder."""

TRIALS = 100
"""Number of bodies sent to random targets."""

SECONDS = 6.0
"""Time each of them swims [s]."""

MAX_YAW = 2.1
"""Random targets lie at most this far to the left or right [rad]."""

MAX_PITCH = 0.8
"""Random targets lie at most this far up or down [rad]."""

MIN_SPEED = 0.2
"""The least random speed commanded, as a share of the highest."""

SHARES = (0.3, 0.5, 0.7, 0.9)
"""The speeds commanded straight ahead, as shares of the highest."""

STRAIGHT_SECONDS = 3.0
"""The heading of a body told to swim straight ahead is measured after this time, its speed after twice that [s]."""

SCHOOL = 12
"""Number of fish in a school."""

SCHOOL_SECONDS = 30.0
"""Time a school swims [s]."""

SCHOOLS = 3
"""Number of schools measured, each from a seed of its own."""

SCHOOL_SPEED = 0.9
"""Commanded speed of a school, as a share of the highest speed."""

TANK_LENGTHS = (4.6, 4.6, 2.7)
"""Half the extent of a school's tank, in body lengths."""

START_DISTANCE = 1.5
"""No two fish of a school start with their middles nearer than this, in body lengths."""

TOO_NEAR = 0.5
"""Two fish touch whose middles are nearer than this, in body lengths."""

QUARTILES = (25, 50, 75)
"""The percentiles reported of every error."""

RESULTS = ROOT / "benchmarks" / "control"
"""The tables are written to this folder."""


def trial_targets(
    policy: Policy, starts: Float[np.ndarray, "B S"], rng: np.random.Generator
) -> SteeringTarget:
    """Return a random target for each of `starts`."""
    pose = policy.pose(policy.emulator.encode(starts))
    count = len(starts)
    yaw = rng.uniform(-MAX_YAW, MAX_YAW, (count, 1))
    pitch = rng.uniform(-MAX_PITCH, MAX_PITCH, (count, 1))
    level = np.cos(yaw) * pose.forward + np.sin(yaw) * leftward(pose)
    direction = unit(np.cos(pitch) * level + np.sin(pitch) * upright(pose))
    speed = policy.ranges.high[0] * rng.uniform(MIN_SPEED, 1, count)
    return SteeringTarget(jnp.asarray(direction, jnp.float32), jnp.asarray(speed, jnp.float32))


def gait_alone(
    policy: Policy,
    system: System,
    starts: Float[np.ndarray, "B S"],
    target: SteeringTarget,
    steps: int,
) -> Float[np.ndarray, "B T+1 S"]:
    """Return the motions of the gait without a policy, as strong as the speed commanded."""
    assert system.gait is not None
    controls = []
    for strength in np.asarray(target.speed) / policy.ranges.high[0]:
        motion = system.gait.controls(steps, policy.dt, system.bounds, strength=float(strength))
        controls.append(motion)
    return system.simulate_fastest(starts, np.stack(controls), policy.dt).states


def errors(
    policy: Policy, states: Float[np.ndarray, "B T S"], target: SteeringTarget
) -> dict[str, float]:
    """Return quartiles of how far the last two periods of motions are from their targets."""
    last = round(2 * policy.rhythm.period / policy.dt)
    pose = pose_of(policy, states[:, -last:])
    speed = np.sum(pose.velocity * pose.forward, axis=-1).mean(axis=1)
    rolls = command_toward(steer_forward(pose, 0.0), pose)[..., 3].mean(axis=1)
    row = {"highest_speed_mps": policy.ranges.high[0]}
    add_quartiles(row, "speed_error_mps", np.abs(speed - np.asarray(target.speed)))
    add_quartiles(row, "heading_error_deg", heading_error(pose.forward.mean(axis=1), target))
    add_quartiles(row, "roll_deg", np.degrees(np.abs(rolls)))
    return row


def pose_of(policy: Policy, states: ArrayLike) -> Pose:
    """Return the pose of the body in each of `states` (..., S)."""
    latent = policy.emulator.encode(np.asarray(states, float))
    return policy.pose(np.asarray(latent))


def heading_error(forward: Float[np.ndarray, "B 3"], target: SteeringTarget) -> np.ndarray:
    """Return the angle between where each body points and where it should (B,) [degrees]."""
    cosine = np.sum(unit(forward) * np.asarray(target.direction), axis=-1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def pitch_of(pose: Pose) -> np.ndarray:
    """Return how far each body points up [degrees]."""
    return np.degrees(np.arcsin(np.clip(pose.forward[..., 2], -1, 1)))


def add_quartiles(row: dict[str, float], name: str, values: np.ndarray) -> None:
    """Add the quartiles of `values` (B,) to `row`."""
    for percent in QUARTILES:
        row[f"{name}_p{percent}"] = float(np.percentile(values, percent))


def measure(name: str) -> list[dict[str, Any]]:
    """Return a row per start (anyhow, at rest) and driver, all from the same unseen starts to the same targets."""
    policy = Policy.load(find_policy(name))
    system = load_system(name)
    rng = np.random.default_rng([5, 2**31])
    anyhow = sample_starts(system, rng, TRIALS)
    at_rest = np.tile(system.rest, (TRIALS, 1))
    rows = measure_from(policy, system, "anyhow", anyhow, rng)
    return rows + measure_from(policy, system, "at rest, upright", at_rest, rng)


def measure_from(
    policy: Policy,
    system: System,
    label: str,
    starts: Float[np.ndarray, "B S"],
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """Return a row per driver of bodies from `starts`, which are called `label`."""
    target = trial_targets(policy, starts, rng)
    steps = round(SECONDS / policy.dt)
    physics_runs, _ = rollout_on_physics(policy, system, starts, target, steps)
    emulator_states = rollout_on_emulator(policy, lambda pose, time: target, starts, steps)
    motions = {
        "policy on physics": physics_runs.states,
        "policy on emulator": np.asarray(emulator_states),
        "gait alone on physics": gait_alone(policy, system, starts, target, steps),
    }
    alive = int((~physics_runs.has_diverged).sum())
    rows = []
    for driver, states in motions.items():
        row = {
            "system": system.name,
            "starts": label,
            "policies_alive": alive,
            "driver": driver,
        }
        rows.append(row | errors(policy, states, target))
    return rows


def measure_straight(name: str) -> list[dict[str, Any]]:
    """Return a row per speed: how straight and level the true body swims from rest, told to swim straight ahead."""
    policy = Policy.load(find_policy(name))
    system = load_system(name)
    starts = np.tile(system.rest, (len(SHARES), 1))
    pose = policy.pose(policy.emulator.encode(starts))
    speeds = policy.ranges.high[0] * np.array(SHARES)
    target = steer_forward(pose, jnp.asarray(speeds, jnp.float32))
    steps = round(2 * STRAIGHT_SECONDS / policy.dt)
    runs, _ = rollout_on_physics(policy, system, starts, target, steps)
    path = pose_of(policy, runs.states)
    period = round(policy.rhythm.period / policy.dt)
    then = round(STRAIGHT_SECONDS / policy.dt)
    off = heading_error(path.forward[:, then - period : then].mean(axis=1), target)
    speed = np.sum(path.velocity * path.forward, axis=-1)[:, -2 * period :].mean(axis=1)
    pitch = np.abs(pitch_of(path))
    roll = np.degrees(np.abs(path.roll))
    rows = []
    for body in range(len(SHARES)):
        row = {
            "system": name,
            "speed_commanded_mps": float(speeds[body]),
            "speed_mps": float(speed[body]),
            "heading_off_after_3s_deg": float(off[body]),
            "pitch_max_deg": float(pitch[body].max()),
            "roll_max_deg": float(roll[body].max()),
        }
        rows.append(row)
    return rows


def measure_school(name: str) -> list[dict[str, Any]]:
    """Return a row per school: how near bodies come to each other, and how level they keep."""
    policy = Policy.load(find_policy(name))
    system = load_system(name)
    length = body_length(system)
    half = length * np.array(TANK_LENGTHS)
    tank = Tank(tuple(-half), tuple(half))
    return [school_row(policy, system, tank, length, seed) for seed in range(SCHOOLS)]


def school_row(
    policy: Policy, system: System, tank: Tank, length: float, seed: int
) -> dict[str, Any]:
    """Return the row of one school that lives on the emulator."""
    speed = SCHOOL_SPEED * policy.ranges.high[0]
    starts = spread_out(system, np.random.default_rng([seed, 3]), SCHOOL, tank, length)
    steps = round(SCHOOL_SECONDS / policy.dt)
    behaviour = shoal(tank, length=length, speed=speed, seed=seed)
    motions = rollout_on_emulator(policy, behaviour, starts, steps, seed=seed)
    pose = pose_of(policy, motions)
    distances = np.linalg.norm(pose.position[:, None] - pose.position[None], axis=-1) / length
    fish = np.arange(SCHOOL)
    distances[fish, fish] = np.inf  # from itself
    nearest = distances.min(axis=1)
    pitch = np.abs(pitch_of(pose))
    roll = np.degrees(np.abs(pose.roll))
    return {
        "system": system.name,
        "seed": seed,
        "time_any_pair_too_near": float((nearest < TOO_NEAR).any(axis=0).mean()),
        "nearest_lengths": float(nearest.min()),
        "median_neighbour_lengths": float(np.median(nearest)),
        "speed_mps": float(np.sum(pose.velocity * pose.forward, axis=-1).mean()),
        "pitch_p99_deg": float(np.percentile(pitch, 99)),
        "pitch_max_deg": float(pitch.max()),
        "roll_p99_deg": float(np.percentile(roll, 99)),
    }


def spread_out(
    system: System, rng: np.random.Generator, count: int, tank: Tank, length: float
) -> np.ndarray:
    """Return `count` bodies (count, S) at rest about the tank's middle, no two nearer than `START_DISTANCE`."""
    half = np.array(tank.high) / 2
    positions: list[np.ndarray] = []
    while len(positions) < count:
        position = rng.uniform(-half, half)
        distances = [float(np.linalg.norm(position - other)) for other in positions]
        if all(distance > START_DISTANCE * length for distance in distances):
            positions.append(position)
    starts = np.tile(system.rest, (count, 1))
    if system.structure.cloud:
        points = len(system.structure.cloud.masses)
        starts[:, : 3 * points] += np.tile(np.array(positions), points)
    return starts


def train(name: str) -> None:
    """Train the policy of a system and put it where the package ships it."""
    out = WORKPLACE / shipped_policy(name).name
    train_policy(load_emulator(name), load_system(name), out, TRAININGS[name], on_report=print)
    shipped_policy(name).write_bytes(out.read_bytes())


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "what",
        nargs="?",
        choices=["measure", *POLICIES],
        help="train nothing, or one without measuring",
    )
    what = parser.parse_args().what
    if what in POLICIES:
        train(what)
        return
    if what is None:
        for name in POLICIES:
            train(name)
    trials: list[dict[str, Any]] = []
    for name in MEASURED:
        trials += measure(name)
    straight: list[dict[str, Any]] = []
    for name in MEASURED:
        straight += measure_straight(name)
    tables = {
        "policies": trials,
        "policies_straight": straight,
        "policies_school": measure_school("fish"),
    }
    for name, rows in tables.items():
        print_table(rows)
        write_csv(RESULTS / f"{name}.csv", rows)


if __name__ == "__main__":
    main()
