"""Make the policies that ship in the package, and measure them on the true physics.

python benchmarks/train_policies.py                    both, ten minutes on 2 cores, and results/policies.csv
python benchmarks/train_policies.py measure            the shipped ones, without training
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from neuroanimator import Emulator, find_emulator, load_system
from neuroanimator.bench import write_csv
from neuroanimator.control.physics import play
from neuroanimator.control.policies.course import Course, command, forward, leftward, unit, upright
from neuroanimator.control.policies.drive import drive, live
from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.policy_training import train_policy
from neuroanimator.data.sampling import sample_starts
from neuroanimator.shipped import POLICIES, find_policy, shipped_policy
from neuroanimator.systems.system import System
from neuroanimator.terminal import print_table

WORKPLACE = Path("out/policies")
TRIALS, SECONDS = 100, 6.0
WIDEST, STEEPEST = 2.1, 0.8
"""[rad] Of the random turns to the left or right, and up or down."""
LEAST_SPEED = 0.2
"""Of the random commands, as a share of the highest."""


def trial_courses(policy: Policy, starts: np.ndarray, rng: np.random.Generator) -> Course:
    """Return a random course for each of `starts` (B, S)."""
    pose, count = policy.pose(policy.emulator.encode(starts)), len(starts)
    aside, above = rng.uniform(-WIDEST, WIDEST, (count, 1)), rng.uniform(-STEEPEST, STEEPEST, (count, 1))
    level = np.cos(aside) * pose.forward + np.sin(aside) * leftward(pose)
    direction = unit(np.cos(above) * level + np.sin(above) * upright(pose))
    speed = policy.ranges.high[0] * rng.uniform(LEAST_SPEED, 1, count)
    return Course(jnp.asarray(direction, jnp.float32), jnp.asarray(speed, jnp.float32))


def gait_alone(policy: Policy, system: System, starts: np.ndarray, course: Course, steps: int) -> np.ndarray:
    """Return what the gait does without a policy, as strong as the speed commanded: (B, T+1, S)."""
    assert system.gait is not None
    strengths = np.asarray(course.speed) / policy.ranges.high[0]
    controls = [system.gait.controls(steps, policy.dt, system.bounds, strength=float(each)) for each in strengths]
    return play(system, starts, np.stack(controls), policy.dt).states


def errors(policy: Policy, states: np.ndarray, course: Course) -> dict[str, float]:
    """Return quartiles of how far the last two periods of motions (B, T+1, S) are from their courses."""
    last = round(2 * policy.rhythm.period / policy.dt)
    pose = policy.pose(np.asarray(policy.emulator.encode(np.asarray(states[:, -last:], float))))
    speed = np.sum(pose.velocity * pose.forward, axis=-1).mean(axis=1)
    cosine = np.sum(unit(pose.forward.mean(axis=1)) * np.asarray(course.direction), axis=-1)
    rolls = command(forward(pose, 0.0), pose)[..., 3].mean(axis=1)
    found = {
        "speed_error_mps": np.abs(speed - np.asarray(course.speed)),
        "heading_error_deg": np.degrees(np.arccos(np.clip(cosine, -1, 1))),
        "roll_deg": np.degrees(np.abs(rolls)),
    }
    quartiles = {f"{name}_p{p}": float(np.percentile(each, p)) for name, each in found.items() for p in (25, 50, 75)}
    return {"highest_speed_mps": policy.ranges.high[0], **quartiles}


def measure(name: str) -> list[dict[str, Any]]:
    """Return a row per kind of start and driver, all from the same unseen starts to the same courses."""
    policy, system, rng = Policy.load(find_policy(name)), load_system(name), np.random.default_rng([5, 2**31])
    kinds = {"anyhow": sample_starts(system, rng, TRIALS), "at rest, upright": np.tile(system.rest, (TRIALS, 1))}
    return [each for kind, starts in kinds.items() for each in measure_from(policy, system, kind, starts, rng)]


def measure_from(
    policy: Policy, system: System, kind: str, starts: np.ndarray, rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Return a row per driver of bodies from `starts` (B, S)."""
    course, steps = trial_courses(policy, starts, rng), round(SECONDS / policy.dt)
    physical, _ = drive(policy, system, starts, course, steps)
    emulated = np.asarray(live(policy, lambda pose, time: course, starts, steps))
    alone = gait_alone(policy, system, starts, course, steps)
    found = {"policy on physics": physical.states, "policy on emulator": emulated, "gait alone on physics": alone}
    about = {"system": system.name, "starts": kind, "policies_alive": int(physical.is_alive.sum())}
    return [{**about, "driver": label, **errors(policy, states, course)} for label, states in found.items()]


if __name__ == "__main__":
    for name in POLICIES if sys.argv[1:] != ["measure"] else ():
        out = WORKPLACE / shipped_policy(name).name
        train_policy(Emulator.load(find_emulator(name)), load_system(name), out, on_report=print)
        shipped_policy(name).write_bytes(out.read_bytes())
    rows = [each for name in POLICIES for each in measure(name)]
    print_table(rows)
    write_csv(Path("benchmarks/results/policies.csv"), rows)
