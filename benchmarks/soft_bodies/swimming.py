"""Animals of flesh beside their physics in unseen swimming: shape, path, speed and turning; rest, and a million super steps.

python -m benchmarks.soft_bodies.swimming             trout and orca
python -m benchmarks.soft_bodies.swimming trout       one of them

Runs of 10 s by gaits, smooth and held controls that training never saw, after 2 s of them. Errors of nodes are root mean
squares over all nodes in the body's own frame [% of its length], those of the path distances of the centres [% of the way].
Speeds and turning rates are means over the last 5 s of all runs, by the physics and by the emulator. Where water has a surface,
runs that stay under it are shown alone, too. The policy that ships is told to go anywhere at a random speed, level, from rest:
heading and speed of the last four periods of ten seconds on the physics.
"""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import neuroanimator as na
from benchmarks.harness import Rows, keep_rows, parser_of, show_rows
from benchmarks.soft_bodies.equal_error import shipped
from neuroanimator.control.policies.closed_loop import rollout_on_physics
from neuroanimator.control.policies.steering import SteeringTarget
from neuroanimator.physics.soft.soft_system import SoftSystem
from neuroanimator.state.pose import read_pose

RESULTS = Path(__file__).with_name("swimming.csv")

RUNS = 32

NAMES = ("trout", "orca")

LEAD = 62
"""Number of super steps before the emulator begins."""

STEPS = 312
"""Number of super steps of a run: 10 s."""

SHOWN = (8, 16, 31, 62, 156, STEPS)
"""Numbers of super steps after which errors are shown."""

SEED = 2**31
"""Seed of the runs, above any of a dataset's."""

UNDER = 0.15
"""Minimum depth of the centre of runs that stay under water [body lengths]."""

DEEP = 2.0
"""Depth at which policies begin where water has a surface [body lengths]."""

TRIALS = 100

PERIODS = 4
"""Number of periods of its gait over which the end of a motion is judged."""

MANY = 1_000_000
"""Number of super steps that must stay finite, in blocks of `BLOCK`."""

BLOCK = 10_000


def accuracy_rows(system: SoftSystem, emulator: na.Emulator) -> Rows:
    """Return the errors after each of `SHOWN`, then speeds and turning rates: of all runs, then of those under water."""
    rng = np.random.default_rng(SEED)
    starts = system.sample_starts(rng, RUNS)
    controls = system.sample_paths(rng, RUNS, LEAD + STEPS, emulator.dt)
    truth = system.simulate_fastest(starts, controls, emulator.dt).states[:, LEAD:]
    own = np.asarray(emulator.rollout(truth[:, 0], controls[:, LEAD:]), float)
    length = system.scene.size
    groups = {"": np.ones(RUNS, bool)}
    if system.water_surface is not None:
        is_deep = (truth[..., 2] < system.water_surface - UNDER * length).all(axis=1)
        groups |= {f", {is_deep.sum()} runs under water": is_deep, ", the others": ~is_deep}
    rows: Rows = []
    for which, chosen in groups.items():
        rows += error_rows(system, own[chosen], truth[chosen], emulator.dt, which)
    return rows


def error_rows(
    system: SoftSystem,
    own: Float[np.ndarray, "B T S"],
    truth: Float[np.ndarray, "B T S"],
    dt: float,
    which: str,
) -> Rows:
    """Return the emulator's errors and means beside the physics', of the runs that `which` names."""
    length = system.scene.size
    rows: Rows = []
    for step in SHOWN:
        shapes = [system.shapes.unplaced(states[:, step]) for states in (own, truth)]
        apart = np.sqrt(((shapes[0] - shapes[1]) ** 2).sum(axis=2).mean(axis=1))
        path = np.linalg.norm(own[:, step, :3] - truth[:, step, :3], axis=1)
        way = np.linalg.norm(np.diff(truth[:, : step + 1, :3], axis=1), axis=2).sum(axis=1)
        rows.append(
            {
                "what": f"after {step * dt:.2g} s{which}",
                "nodes_percent": 100 * float(apart.mean()) / length,
                "path_percent": 100 * float(path.sum() / way.sum()),
                "way_lengths": float(way.mean()) / length,
            }
        )
    for what, measure in {"speed": speeds, "turning": turning_rates}.items():
        by_both = [float(measure(system, states[:, STEPS // 2 :], dt)) for states in (own, truth)]
        rows.append({"what": what + which, "emulator": by_both[0], "physics": by_both[1]})
    return rows


def speeds(system: SoftSystem, states: Float[np.ndarray, "B T S"], dt: float) -> np.floating:
    """Return the mean speed of the bodies along their ways [lengths/s]."""
    way = np.linalg.norm(np.diff(states[..., :3], axis=1), axis=2)
    return way.mean() / dt / system.scene.size


def turning_rates(system: SoftSystem, states: Float[np.ndarray, "B T S"], dt: float) -> np.floating:
    """Return the mean size of the bodies' turning rates [rad/s]."""
    headings = np.unwrap(read_pose(system, states).heading, axis=1)
    return (np.abs(headings[:, -1] - headings[:, 0]) / (headings.shape[1] - 1)).mean() / dt


def endurance_rows(system: SoftSystem, emulator: na.Emulator) -> Rows:
    """Return how far a body at rest creeps in a minute, and whether a million random super steps stay finite."""
    idle = np.zeros((round(60 / emulator.dt), emulator.control.size))
    states = np.asarray(emulator.rollout(system.rest, idle), float)
    crept = np.linalg.norm(states[-1, :3] - states[0, :3]) / system.scene.size
    rng = np.random.default_rng(SEED + 1)
    state = np.asarray(system.rest, float)
    widest = 0.0
    for _ in range(MANY // BLOCK):
        controls = system.sample_paths(rng, 1, BLOCK, emulator.dt)[0]
        path = np.asarray(emulator.rollout(state, controls), float)
        widest = max(widest, float(np.abs(path[:, system.shapes.amplitudes]).max()))
        state = path[-1]
        state[:3] = 0
    is_finite = bool(np.isfinite(state).all())
    return [
        {"what": "creeps from rest in a minute [% of its length]", "emulator": 100 * float(crept)},
        {"what": "a million super steps are finite", "emulator": is_finite},
        {
            "what": "largest amplitude in them [% of its length]",
            "emulator": 100 * widest / system.scene.size,
        },
    ]


def policy_rows(name: str, system: SoftSystem) -> Rows:
    """Return in how many of `TRIALS` a policy told to go anywhere, level, from rest, is there on the physics after 10 s."""
    policy = na.Policy.load(name)
    rng = np.random.default_rng(SEED + 2)
    yaw = rng.uniform(-np.pi, np.pi, TRIALS)
    wanted = np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], axis=1)
    speed = policy.ranges.high[0] * rng.uniform(0.4, 0.9, TRIALS)
    target = SteeringTarget(jnp.asarray(wanted, jnp.float32), jnp.asarray(speed, jnp.float32))
    starts = np.repeat(system.rest[None], TRIALS, axis=0)
    if system.water_surface is not None:
        starts[:, 2] = system.water_surface - DEEP * system.scene.size
    runs, _ = rollout_on_physics(policy, system, starts, target, STEPS)
    last = round(PERIODS * policy.rhythm.period / policy.dt)
    forward = read_pose(system, runs.states[:, -last:]).forward.mean(axis=1)
    cosine = (forward * wanted).sum(axis=1) / np.linalg.norm(forward, axis=1)
    off = np.degrees(np.arccos(cosine.clip(-1, 1)))
    swum = np.linalg.norm(runs.states[:, -1, :3] - runs.states[:, -1 - last, :3], axis=1)
    ratio = swum / (last * policy.dt) / speed
    return [
        {"what": "policy: degrees off its heading, median", "physics": float(np.median(off))},
        {"what": "policy: speed over that commanded, median", "physics": float(np.median(ratio))},
        {"what": f"policy: within 5 degrees, of {TRIALS}", "physics": int((off < 5).sum())},
        {
            "what": f"policy: and within 10 % of the speed, of {TRIALS}",
            "physics": int(((off < 5) & (np.abs(ratio - 1) < 0.1)).sum()),
        },
    ]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=" or ".join(NAMES))
    options = parser.parse_args()
    names = options.names or NAMES
    rows: Rows = []
    for name in names:
        system, emulator = shipped(name)
        found = accuracy_rows(system, emulator) + endurance_rows(system, emulator)
        rows += [{"system": name} | row for row in [*found, *policy_rows(name, system)]]
    columns = ["what", "nodes_percent", "path_percent", "way_lengths", "emulator", "physics"]
    whole = [{column: row.get(column, "") for column in ["system", *columns]} for row in rows]
    show_rows(whole)
    keep_rows(RESULTS, whole, options, "system")


if __name__ == "__main__":
    main()
