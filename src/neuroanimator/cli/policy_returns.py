"""What a policy that `policy` learnt does: its returns on the true environment and inside its emulator, and a motion."""

from __future__ import annotations

from json import dumps
from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.control.policies.state_policy import StatePolicy, load_state_policy
from neuroanimator.definitions.task import TaskTable
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.evaluation.held_out import system_of
from neuroanimator.gym.bodies import environment_returns, motion_of, returns_of
from neuroanimator.gym.learn_policy import LearningReport
from neuroanimator.gym.locomotion import locomotion_rules, task_of
from neuroanimator.gym.state_rows import emulator_stepper, physics_stepper
from neuroanimator.systems.loading import trust_files
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase, print_rows
from neuroanimator.training.train import METRICS, read_reports, run_folder

MAX_EPISODES = 100_000


def _loaded(path: Path, toml: Path | None) -> tuple[StatePolicy, System, TaskTable]:
    """Return (the policy, its physics, what it is to do)."""
    with phase("loading"):
        policy = load_state_policy(path)
        if toml:
            trust_files(toml)
        system = system_of(policy.emulator)
        return policy, system, task_of(policy.emulator.definition, str(path))


def policy_motion(
    path: Path, toml: Path | None, seconds: float | None, seed: int
) -> tuple[Emulator, Float[np.ndarray, "K S"]]:
    """Return (the policy's emulator, the states of an episode on the true physics, at most `seconds` of it)."""
    policy, system, task = _loaded(path, toml)
    rules = locomotion_rules(task, system.structure, system.rest, system.parameters)
    steps = task.steps
    if seconds is not None:
        if not policy.dt <= seconds <= task.steps * policy.dt:
            raise ArgumentError(
                f"seconds: wanted between {policy.dt:g} and {task.steps * policy.dt:g}, the length of an episode, came "
                f"{seconds:g}."
            )
        steps = round(seconds / policy.dt)
    with phase("simulating"):
        stepper = physics_stepper(system, system.scheme, policy.dt)
        return policy.emulator, motion_of(policy, stepper, rules, steps, seed)


def evaluate_policy(
    path: Path,
    toml: Path | None,
    episodes: int,
    seed: int,
    *,
    as_json: bool,
    report: Path | None = None,
) -> None:
    """Print the returns of `episodes` episodes without noise, and write them with the curve of learning to the page `report`."""
    if not 1 <= episodes <= MAX_EPISODES:
        raise ArgumentError(f"episodes: wanted 1 to {MAX_EPISODES:,}, came {episodes:,}.")
    policy, system, task = _loaded(path, toml)
    rules = locomotion_rules(task, system.structure, system.rest, system.parameters)
    where = task.environment or "the physics"
    with phase(f"{episodes} episodes in {where}"):
        stepper = physics_stepper(system, system.scheme, policy.dt)
        if task.environment:
            returns = environment_returns(policy, task.environment, episodes, seed)
        else:
            returns = returns_of(policy, stepper, rules, episodes, seed)
    of_family = None
    if task.environment and system.parameters:
        with phase(f"{episodes} episodes of random bodies"):
            of_family = returns_of(policy, stepper, rules, episodes, seed)
    with phase(f"{episodes} episodes in the emulator"):
        leaps = emulator_stepper(policy.emulator, np.inf, 0.0)
        inside = returns_of(policy, leaps, rules, episodes, seed)
    rows: list[tuple[str, object]] = [
        ("policy", path),
        ("episodes", f"{episodes:,} in {where}"),
        ("mean return", f"{returns.mean():.0f}"),
        ("least, most", f"{returns.min():.0f}, {returns.max():.0f}"),
        ("in the emulator", f"{inside.mean():.0f}"),
    ]
    if of_family is not None:
        shown = f"{of_family.mean():.0f}, {of_family.min():.0f} to {of_family.max():.0f}"
        rows.append(("random bodies of the family", shown))
    if report:
        from neuroanimator.evaluation.policy_report import write_policy_report  # with Matplotlib

        told = read_reports(run_folder(path) / METRICS, LearningReport)
        curve = [(point.steps, point.mean_return) for point in told]
        write_policy_report(report, rows, curve, returns, inside)
    if as_json:
        found = {
            "environment": where,
            "episodes": episodes,
            "mean_return": float(returns.mean()),
            "least_return": float(returns.min()),
            "largest_return": float(returns.max()),
            "mean_return_inside": float(inside.mean()),
        }
        if of_family is not None:
            found["mean_return_of_family"] = float(of_family.mean())
        print(dumps(found, indent=2))
        return
    if report:
        rows.append(("report", report))
    print_rows(rows)
