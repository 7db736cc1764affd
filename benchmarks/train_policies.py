"""Make the policies that ship in the package, and measure them on the true physics.

python benchmarks/train_policies.py                    both, ten minutes on 2 cores, and results/policies*.csv
python benchmarks/train_policies.py measure            the shipped ones, without training
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from neuroanimator import load_emulator, load_system
from neuroanimator.bench.csv_table import write_csv
from neuroanimator.control.policies.behaviours import Tank, shoal
from neuroanimator.control.policies.closed_loop import rollout_on_emulator, rollout_on_physics
from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.policy_training import train_policy
from neuroanimator.control.policies.steering import (
    SteeringTarget,
    command_toward,
    leftward,
    steer_forward,
    unit,
    upright,
)
from neuroanimator.data.sampling import sample_starts
from neuroanimator.systems.system import System
from neuroanimator.tasks.swimmers import body_length
from neuroanimator.terminal import print_table
from neuroanimator.zoo import POLICIES, find_policy, shipped_policy

WORKPLACE = Path("out/policies")
TRIALS, SECONDS = 100, 6.0
WIDEST, STEEPEST = 2.1, 0.8
"""[rad] Of the random turns to the left or right, and up or down."""
MIN_SPEED = 0.2
"""Of the random commands, as a share of the highest."""
SHARES = (0.3, 0.5, 0.7, 0.9)
"""Of the highest speed, commanded straight ahead."""
STRAIGHT_SECONDS = 3.0
"""After which a body told to swim straight ahead is looked at."""
SCHOOL, SCHOOL_SECONDS, SCHOOLS = 12, 30.0, 3
TANK_LENGTHS = (4.6, 4.6, 2.7)
"""Half the extent of a school's tank, in body lengths."""
TOO_NEAR = 0.5
"""Body lengths between middles: two fish nearer than this touch."""


def trial_targets(policy: Policy, starts: np.ndarray, rng: np.random.Generator) -> SteeringTarget:
    """Return a random target for each of `starts` (B, S)."""
    pose, count = policy.pose(policy.emulator.encode(starts)), len(starts)
    aside, above = (
        rng.uniform(-WIDEST, WIDEST, (count, 1)),
        rng.uniform(-STEEPEST, STEEPEST, (count, 1)),
    )
    level = np.cos(aside) * pose.forward + np.sin(aside) * leftward(pose)
    direction = unit(np.cos(above) * level + np.sin(above) * upright(pose))
    speed = policy.ranges.high[0] * rng.uniform(MIN_SPEED, 1, count)
    return SteeringTarget(jnp.asarray(direction, jnp.float32), jnp.asarray(speed, jnp.float32))


def gait_alone(
    policy: Policy, system: System, starts: np.ndarray, target: SteeringTarget, steps: int
) -> np.ndarray:
    """Return what the gait does without a policy, as strong as the speed commanded: (B, T+1, S)."""
    assert system.gait is not None
    strengths = np.asarray(target.speed) / policy.ranges.high[0]
    controls = [
        system.gait.controls(steps, policy.dt, system.bounds, strength=float(each))
        for each in strengths
    ]
    return system.simulate_fastest(starts, np.stack(controls), policy.dt).states


def errors(policy: Policy, states: np.ndarray, target: SteeringTarget) -> dict[str, float]:
    """Return quartiles of how far the last two periods of motions (B, T+1, S) are from their targets."""
    last = round(2 * policy.rhythm.period / policy.dt)
    pose = policy.pose(np.asarray(policy.emulator.encode(np.asarray(states[:, -last:], float))))
    speed = np.sum(pose.velocity * pose.forward, axis=-1).mean(axis=1)
    cosine = np.sum(unit(pose.forward.mean(axis=1)) * np.asarray(target.direction), axis=-1)
    rolls = command_toward(steer_forward(pose, 0.0), pose)[..., 3].mean(axis=1)
    found = {
        "speed_error_mps": np.abs(speed - np.asarray(target.speed)),
        "heading_error_deg": np.degrees(np.arccos(np.clip(cosine, -1, 1))),
        "roll_deg": np.degrees(np.abs(rolls)),
    }
    quartiles = {
        f"{name}_p{p}": float(np.percentile(each, p))
        for name, each in found.items()
        for p in (25, 50, 75)
    }
    return {"highest_speed_mps": policy.ranges.high[0], **quartiles}


def measure(name: str) -> list[dict[str, Any]]:
    """Return a row per kind of start and driver, all from the same unseen starts to the same targets."""
    policy, system, rng = (
        Policy.load(find_policy(name)),
        load_system(name),
        np.random.default_rng([5, 2**31]),
    )
    kinds = {
        "anyhow": sample_starts(system, rng, TRIALS),
        "at rest, upright": np.tile(system.rest, (TRIALS, 1)),
    }
    return [
        each
        for kind, starts in kinds.items()
        for each in measure_from(policy, system, kind, starts, rng)
    ]


def measure_from(
    policy: Policy, system: System, kind: str, starts: np.ndarray, rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Return a row per driver of bodies from `starts` (B, S)."""
    target, steps = trial_targets(policy, starts, rng), round(SECONDS / policy.dt)
    physics_states, _ = rollout_on_physics(policy, system, starts, target, steps)
    emulator_states = np.asarray(
        rollout_on_emulator(policy, lambda pose, time: target, starts, steps)
    )
    alone = gait_alone(policy, system, starts, target, steps)
    found = {
        "policy on physics": physics_states.states,
        "policy on emulator": emulator_states,
        "gait alone on physics": alone,
    }
    about = {
        "system": system.name,
        "starts": kind,
        "policies_alive": int((~physics_states.has_diverged).sum()),
    }
    return [
        {**about, "driver": label, **errors(policy, states, target)}
        for label, states in found.items()
    ]


def measure_straight(name: str) -> list[dict[str, Any]]:
    """Return a row per speed: how straight and level the true body swims from rest, told to swim straight ahead."""
    policy, system = Policy.load(find_policy(name)), load_system(name)
    starts = np.tile(system.rest, (len(SHARES), 1))
    pose = policy.pose(policy.emulator.encode(starts))
    velocities = policy.ranges.high[0] * np.array(SHARES)
    target = steer_forward(pose, jnp.asarray(velocities, jnp.float32))
    runs, _ = rollout_on_physics(
        policy, system, starts, target, round(2 * STRAIGHT_SECONDS / policy.dt)
    )
    path = policy.pose(np.asarray(policy.emulator.encode(runs.states)))
    period = round(policy.rhythm.period / policy.dt)
    then = round(STRAIGHT_SECONDS / policy.dt)
    pointing = unit(path.forward[:, then - period : then].mean(axis=1))
    off = np.degrees(
        np.arccos(np.clip(np.sum(pointing * np.asarray(target.direction), axis=-1), -1, 1))
    )
    speed = np.sum(path.velocity * path.forward, axis=-1)[:, -2 * period :].mean(axis=1)
    pitch = np.degrees(np.arcsin(np.clip(path.forward[..., 2], -1, 1)))
    return [
        {
            "system": name,
            "speed_commanded_mps": float(velocities[row]),
            "speed_mps": float(speed[row]),
            "heading_off_after_3s_deg": float(off[row]),
            "pitch_max_deg": float(np.abs(pitch[row]).max()),
            "roll_max_deg": float(np.degrees(np.abs(path.roll[row]).max())),
        }
        for row in range(len(SHARES))
    ]


def measure_school(name: str) -> list[dict[str, Any]]:
    """Return a row per school: how near bodies come to each other, and how level they keep."""
    policy, system = Policy.load(find_policy(name)), load_system(name)
    length = body_length(system)
    half = length * np.array(TANK_LENGTHS)
    tank = Tank(tuple(-half), tuple(half))
    return [school_row(policy, system, tank, length, seed) for seed in range(SCHOOLS)]


def school_row(
    policy: Policy, system: System, tank: Tank, length: float, seed: int
) -> dict[str, Any]:
    """Return the row of one school that lives on the emulator."""
    speed = 0.9 * policy.ranges.high[0]
    starts = spread_out(system, np.random.default_rng([seed, 3]), SCHOOL, tank, length)
    steps = round(SCHOOL_SECONDS / policy.dt)
    lives = rollout_on_emulator(
        policy, shoal(tank, length=length, speed=speed, seed=seed), starts, steps, seed=seed
    )
    pose = policy.pose(np.asarray(policy.emulator.encode(np.asarray(lives, float))))
    apart = np.linalg.norm(pose.position[:, None] - pose.position[None], axis=-1) / length
    apart[np.arange(SCHOOL), np.arange(SCHOOL)] = np.inf
    nearest = apart.min(axis=1)
    pitch = np.degrees(np.abs(np.arcsin(np.clip(pose.forward[..., 2], -1, 1))))
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
    """Return `count` bodies (count, S) at rest about the tank's middle, no two nearer than a length and a half."""
    half = np.array(tank.high) / 2
    positions: list[np.ndarray] = []
    while len(positions) < count:
        position = rng.uniform(-half, half)
        if all(np.linalg.norm(position - other) > 1.5 * length for other in positions):
            positions.append(position)
    starts = np.tile(system.rest, (count, 1))
    points = len(system.structure.cloud.masses) if system.structure.cloud else 0
    starts[:, : 3 * points] += np.tile(np.array(positions), points)
    return starts


if __name__ == "__main__":
    for name in POLICIES if sys.argv[1:] != ["measure"] else ():
        out = WORKPLACE / shipped_policy(name).name
        train_policy(load_emulator(name), load_system(name), out, on_report=print)
        shipped_policy(name).write_bytes(out.read_bytes())
    rows = [each for name in POLICIES for each in measure(name)]
    straight = [each for name in POLICIES for each in measure_straight(name)]
    schools = measure_school("fish")
    for kind, table in (
        ("policies", rows),
        ("policies_straight", straight),
        ("policies_school", schools),
    ):
        print_table(table)
        write_csv(Path(f"benchmarks/results/{kind}.csv"), table)
