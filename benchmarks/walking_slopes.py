"""How right slopes through contact are: an emulator's beside the physics', at states of a policy before and after it learnt.

python benchmarks/walking_slopes.py                     Hopper-v5, Walker2d-v5, Ant-v5
python benchmarks/walking_slopes.py Hopper-v5 --dry

Each row is of one task and one horizon: the cosine between slopes of the return by all controls on the way, median and least over
some starts. The truth is that of the physics under noise (antithetic random controls, thousands of rollouts); how well two halves
of these agree bounds what can be seen. The emulator's slope is taken at the states of the true rollout (decoupled), or along its
own (imagined); beside it central differences of the physics without noise. A policy learns for some updates in between, and the
emulator with it.

Writes results/walking_slopes.csv.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from walking import prepared

from neuroanimator.control.policies.state_policy import StatePolicy
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.gym.learner import Learner, PolicyLearning
from neuroanimator.gym.policy_gradient import noisy_controls
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.systems.system import System
from neuroanimator.terminal import print_table

RESULTS = Path(__file__).parent / "results"

ENVIRONMENTS = ("Hopper-v5", "Walker2d-v5", "Ant-v5")

HORIZONS = (0.064, 0.128, 0.25, 0.5)
"""[s]"""

STARTS = 6

ROLLOUTS = 512
"""Pairs of rollouts, of noise and its opposite."""

SPREAD = 0.12
"""Standard deviation of the noise, as a share of half the controls' range."""

STEP = 1e-3
"""Change of a control for central differences, as a share of half its range."""

UPDATES = 100

BANK = 64
"""Bodies among whose states starts are drawn."""

AGE = 0.8
"""Time up to which these go on [s]."""


def rows_of(env_id: str) -> list[dict[str, Any]]:
    """Return the rows of one task."""
    with TemporaryDirectory() as place:
        system, rules, emulator = prepared(env_id, Path(place), 0)
        learner = Learner(system, emulator, rules, PolicyLearning())
        rows = measured(env_id, 0, system, rules, learner.policy)
        for _ in range(UPDATES):
            learner.advance()
        return rows + measured(env_id, UPDATES, system, rules, learner.policy)


def measured(
    env_id: str, updates: int, system: System, rules: EpisodeRules, policy: StatePolicy
) -> list[dict[str, Any]]:
    """Return a row for each horizon."""
    rng = np.random.default_rng(1)
    starts = starts_of(system, rules, policy, rng)
    rows = []
    controls = states = np.empty(0)
    for horizon in HORIZONS:
        steps = max(1, round(horizon / policy.dt))
        slopes = {"decoupled": sloped(rules, policy, steps, is_true=True)}
        slopes["imagined"] = sloped(rules, policy, steps, is_true=False)
        cosines: dict[str, list[float]] = {name: [] for name in (*slopes, "differences", "halves")}
        seconds = 0.0
        for start in starts:
            controls, states = rolled_out(system, policy, start, steps)
            began = time.perf_counter()
            halves = smoothed(system, rules, policy, start, controls, rng)
            seconds += time.perf_counter() - began
            truth = halves.mean(axis=0)
            cosines["halves"].append(cosine(*halves))
            cosines["differences"].append(
                cosine(differences(system, rules, policy, start, controls), truth)
            )
            for name, slope in slopes.items():
                found = slope(jnp.asarray(controls, jnp.float32), jnp.asarray(states, jnp.float32))
                cosines[name].append(cosine(np.asarray(found, float), truth))
        row: dict[str, Any] = {
            "environment": env_id,
            "updates": updates,
            "horizon_s": horizon,
            "steps": steps,
        }
        for name, found in cosines.items():
            row[name] = float(np.median(found))
            row[f"{name}_least"] = float(np.min(found))
        row["seconds_physics"] = seconds / len(starts)
        row["seconds_emulator"] = timed(slopes["decoupled"], controls, states)
        rows.append(row)
    return rows


def starts_of(
    system: System, rules: EpisodeRules, policy: StatePolicy, rng: np.random.Generator
) -> np.ndarray:
    """Return states (N, S) that bodies are in under the policy and noise, none of them fallen."""
    assert rules.draw_start is not None
    states = np.stack([rules.draw_start(rng) for _ in range(BANK)])
    bank = [states]
    for _ in range(round(AGE / policy.dt)):
        noise = jnp.asarray(SPREAD * rng.normal(size=(BANK, system.control.size)), jnp.float32)
        controls = np.asarray(
            noisy_controls(policy, jnp.asarray(states, jnp.float32), noise), float
        )
        runs = system.simulate(states, controls[:, None], policy.dt, scheme=system.scheme)
        states = runs.states[:, 1]
        bank.append(states)
    every = np.concatenate(bank)
    every = every[~np.asarray(rules.is_over(every))]
    return every[rng.choice(len(every), STARTS, replace=False)]


def rolled_out(
    system: System, policy: StatePolicy, start: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return (controls (T, C), states (T+1, S)) of the policy without noise on the physics."""
    states = [start]
    controls = []
    for _ in range(steps):
        row = jnp.asarray(states[-1][None], jnp.float32)
        control = np.asarray(policy.control_of(row), float)
        runs = system.simulate(states[-1][None], control[:, None], policy.dt, scheme=system.scheme)
        controls.append(control[0])
        states.append(runs.states[0, 1])
    return np.array(controls), np.array(states)


def sloped(
    rules: EpisodeRules, policy: StatePolicy, steps: int, *, is_true: bool
) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """Return what gives the emulator's slopes (T, C) of the return, at the true states or along its own."""
    emulator = policy.emulator
    reward: Any = rules.reward

    def total(controls: jax.Array, states: jax.Array) -> jax.Array:
        def advance(carry: tuple, moment: tuple) -> tuple[tuple, None]:
            state, earned, goes_on = carry
            control, true = moment
            following = emulator.step(state, control)
            if is_true:
                following = following + jax.lax.stop_gradient(true - following)
            earned += goes_on * reward(state[None], control[None], following[None], policy.dt)[0]
            is_over = rules.is_over(jax.lax.stop_gradient(following)[None])[0]
            return (following, earned, goes_on * (1 - is_over)), None

        carry = (states[0], jnp.zeros(()), jnp.ones(()))
        (_, earned, _), _ = jax.lax.scan(advance, carry, (controls, states[1:]))
        return earned

    return jax.jit(jax.grad(total))


def smoothed(
    system: System,
    rules: EpisodeRules,
    policy: StatePolicy,
    start: np.ndarray,
    controls: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return two estimates (2, T, C) of the slope of the mean return under noise, each by half of the rollouts."""
    noise = rng.normal(size=(ROLLOUTS, *controls.shape))
    shaken = SPREAD * policy.emulator.bounds.half * noise
    gained = gains(system, rules, policy, start, controls, shaken)[:, None, None] * noise
    return gained.reshape(2, -1, *controls.shape).mean(axis=1)


def differences(
    system: System,
    rules: EpisodeRules,
    policy: StatePolicy,
    start: np.ndarray,
    controls: np.ndarray,
) -> np.ndarray:
    """Return central differences (T, C) of the return by each control."""
    moved = np.eye(controls.size).reshape(-1, *controls.shape) * STEP * policy.emulator.bounds.half
    return gains(system, rules, policy, start, controls, moved).reshape(controls.shape)


def gains(
    system: System,
    rules: EpisodeRules,
    policy: StatePolicy,
    start: np.ndarray,
    controls: np.ndarray,
    changes: np.ndarray,
) -> np.ndarray:
    """Return by how much more (N,) controls earn with each of `changes` (N, T, C) than with its opposite."""
    bounds = policy.emulator.bounds
    shaken = np.clip(
        np.concatenate([controls + changes, controls - changes]), bounds.low, bounds.high
    )
    many = np.repeat(start[None], len(shaken), axis=0)
    states = system.simulate_fastest(many, shaken, policy.dt, system.scheme).states
    rewards = np.asarray(rules.reward(states[:, :-1], shaken, states[:, 1:], policy.dt))
    is_over = np.asarray(rules.is_over(states[:, 1:]))
    goes_on = np.cumsum(is_over, axis=1) - is_over == 0
    more, less = np.split((rewards * goes_on).sum(axis=1), 2)
    return more - less


def cosine(one: np.ndarray, other: np.ndarray) -> float:
    return float((one * other).sum() / (np.linalg.norm(one) * np.linalg.norm(other) + 1e-30))


def timed(slope: Callable[..., jax.Array], controls: np.ndarray, states: np.ndarray) -> float:
    """Return how long a slope takes [s], the least of some."""
    arguments = (jnp.asarray(controls, jnp.float32), jnp.asarray(states, jnp.float32))
    found = []
    for _ in range(20):
        began = time.perf_counter()
        slope(*arguments).block_until_ready()
        found.append(time.perf_counter() - began)
    return min(found)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("environments", nargs="*", default=list(ENVIRONMENTS))
    parser.add_argument("--dry", action="store_true", help="write no file")
    arguments = parser.parse_args()
    print(describe_machine())
    rows: list[dict[str, Any]] = []
    for env_id in arguments.environments:
        rows += rows_of(env_id)
        print_table(rows)
    if not arguments.dry:
        write_csv(RESULTS / "walking_slopes.csv", rows)


if __name__ == "__main__":
    main()
