"""Returns of a policy learnt by `policy`, on the true environment and inside its emulator, and its motions."""

from __future__ import annotations

from dataclasses import replace
from json import dumps
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.control.policies.pilot import Pilot
from neuroanimator.control.policies.state_policy import StatePolicy, load_state_policy
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.export.programs.definition import commands_of
from neuroanimator.files.numbers import number_in
from neuroanimator.gym.bodies import (
    WholeEpisodes,
    environment_returns,
    episodes_of,
    motion_of,
)
from neuroanimator.gym.learn_policy import LearningReport
from neuroanimator.gym.policy_task import PolicyTask, task_of_policy
from neuroanimator.gym.state_rows import EmulatorStepper, physics_stepper
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.learn.training.train import METRICS, read_reports, run_folder
from neuroanimator.physics.loading import trust_files
from neuroanimator.systems.named_files import MissingPhysicsError
from neuroanimator.systems.system import System
from neuroanimator.terminal import Rows, phase, print_rows
from neuroanimator.text import quoted

MAX_EPISODES = 100_000

TRUE_RETURN = 0.1
"""Maximum error of the return inside an emulator that can stand in for the physics, as a share of the return there."""

MAX_SECONDS = 3600.0
"""Maximum duration of a command [s]."""

COMMANDS_NEED_NO_PHYSICS = (
    "Inside its emulator the policy walks on command without it, such as --command 3,0.7,0.4."
)
"""Advice where the physics that gives the start of an episode inside an emulator is missing."""


def loaded_policy(path: Path, toml: Path | None) -> tuple[StatePolicy, System, PolicyTask]:
    """Return (the policy, its physics, its task)."""
    with phase("loading"):
        policy = load_state_policy(path)
        if toml:
            trust_files(toml)
        system = system_of(policy.emulator)
        return policy, system, task_of_policy(policy, path, system)


def policy_motion(
    path: Path, toml: Path | None, seconds: float | None, seed: int, *, is_inside: bool = False
) -> tuple[Emulator, Float[np.ndarray, "K S"]]:
    """Return (the policy's emulator, the states of an episode on the true physics, at most `seconds` of it).

    With `is_inside` the episode is in the emulator. A recorded motion is followed from its beginning.
    """
    try:
        policy, system, task = loaded_policy(path, toml)
    except MissingPhysicsError as error:
        if is_inside and commands_of(load_state_policy(path)) is not None:
            raise MissingPhysicsError(f"{error} {COMMANDS_NEED_NO_PHYSICS}") from error
        raise
    steps = task.steps
    if seconds is not None:
        if not policy.dt <= seconds <= task.steps * policy.dt:
            raise ArgumentError(
                f"seconds: wanted between {policy.dt:g} and {task.steps * policy.dt:g}, the length of an episode, got "
                f"{seconds:g}."
            )
        steps = round(seconds / policy.dt)
    with phase("simulating"):
        stepper = physics_stepper(system, system.scheme, policy.dt)
        if is_inside:
            stepper = EmulatorStepper(policy.emulator, np.inf, 0.0)
        rules = task.rules
        if task.motion is not None and task.motion.commands is None:
            first = np.asarray(task.motion.frames[0], float)
            rules = replace(rules, draw_start=lambda _: first)
        return policy.emulator, motion_of(policy, stepper, rules, steps, seed)


def commanded_motion(
    path: Path, toml: Path | None, commands: list[str], *, is_inside: bool = False
) -> tuple[Emulator, Float[np.ndarray, "K S"]]:
    """Return (the policy's emulator, the states of a body given `commands`, SECONDS,SPEED,TURN each, on the true physics).

    With `is_inside` the body moves in the emulator.
    """
    system = None
    if is_inside:
        with phase("loading"):
            policy = load_state_policy(path)
    else:
        policy, system, _ = loaded_policy(path, toml)
    with phase("simulating"):
        pilot = Pilot(policy, system)
        states = [pilot.reset().state]
        for text in commands:
            seconds, speed, turn = _read_command(text)
            for _ in range(max(round(seconds / policy.dt), 1)):
                frame = pilot.step(speed=speed, turn=turn, dt=policy.dt)
                states.append(frame.state)
    return policy.emulator, np.array(states)


def _read_command(text: str) -> tuple[float, float, float]:
    try:
        seconds, speed, turn = (number_in(cell) for cell in text.split(","))
    except ValueError:
        raise ArgumentError(
            f"command: wanted SECONDS,SPEED,TURN such as 3,0.7,0.4, got {quoted(text)}."
        ) from None
    if not 0 < seconds <= MAX_SECONDS:
        raise ArgumentError(
            f"command: wanted more than 0 s and at most {MAX_SECONDS:g} s, got {seconds:g}."
        )
    return seconds, speed, turn


def evaluate_policy(
    path: Path,
    toml: Path | None,
    episodes: int,
    seed: int,
    *,
    as_json: bool,
    report: Path | None = None,
) -> None:
    """Print the returns of `episodes` episodes without noise, and write them with the learning curve to the page `report`."""
    if not 1 <= episodes <= MAX_EPISODES:
        raise ArgumentError(f"episodes: wanted 1 to {MAX_EPISODES:,}, got {episodes:,}.")
    policy, system, task = loaded_policy(path, toml)
    if task.motion is not None and report is not None:
        raise ArgumentError("report: a policy that follows a motion has none yet. Leave it out.")
    returns = _returns(policy, system, task, episodes, seed)
    rows = _rows(path, task, returns, policy.dt)
    if report:
        with phase("drawing"):
            # Imports Matplotlib.
            from neuroanimator.learn.evaluation.policy_report import write_policy_report

            told = read_reports(run_folder(path) / METRICS, LearningReport)
            curve = [(point.steps, point.mean_return) for point in told]
            outside, inside, _ = returns
            write_policy_report(report, rows, curve, outside.returns, inside.returns)
    if as_json:
        print(dumps(_as_json(task, returns), indent=2))
        return
    if report:
        rows.append(("report", report))
    print_rows(rows)


class _Returns(NamedTuple):
    """Whole episodes without noise."""

    outside: WholeEpisodes
    """Episodes in the environment, or on the physics if there is none."""
    inside: WholeEpisodes
    """Episodes inside the policy's emulator."""
    of_family: Float[np.ndarray, " E"] | None
    """Returns of random bodies on the physics, if the environment's body is one of a family."""


def _returns(
    policy: StatePolicy, system: System, task: PolicyTask, episodes: int, seed: int
) -> _Returns:
    stepper = physics_stepper(system, system.scheme, policy.dt)
    of_family = None
    with phase(f"{episodes} episodes in {task.environment or 'the physics'}"):
        if task.environment:
            returns = environment_returns(policy, task.environment, episodes, seed)
            outside = WholeEpisodes(returns, np.zeros(episodes, bool))
        else:
            outside = episodes_of(policy, stepper, task.rules, episodes, seed)
    if task.environment and system.parameters:
        with phase(f"{episodes} episodes of random bodies"):
            of_family = episodes_of(policy, stepper, task.rules, episodes, seed).returns
    with phase(f"{episodes} episodes in the emulator"):
        leaps = EmulatorStepper(policy.emulator, np.inf, 0.0)
        inside = episodes_of(policy, leaps, task.rules, episodes, seed)
    return _Returns(outside, inside, of_family)


def _rows(path: Path, task: PolicyTask, returns: _Returns, dt: float) -> Rows:
    outside, inside, bodies = returns
    earned = outside.returns
    asked = f"{len(earned):,} in {task.environment or 'the physics'}"
    mean = f"{earned.mean():.0f}"
    emulated = f"{inside.returns.mean():.0f}"
    kept: Rows = []
    if task.motion is not None:
        asked = f"{len(earned):,} on the physics, of {task.steps * dt:.3g} s at most"
        mean += f" of {task.steps}"
        emulated += f", {inside.finished:,} on the motion at its end"
        kept = [("on the motion", f"{outside.finished:,} of them at its end")]
    rows: Rows = [
        ("policy", path),
        ("episodes", asked),
        *kept,
        ("mean return", mean),
        ("minimum, maximum", f"{earned.min():.0f}, {earned.max():.0f}"),
        ("in the emulator", emulated),
        *emulator_rows(earned, inside.returns),
    ]
    if bodies is not None:
        shown = f"{bodies.mean():.0f}, {bodies.min():.0f} to {bodies.max():.0f}"
        rows.append(("random bodies of the family", shown))
    return rows


def emulator_rows(outside: Float[np.ndarray, " E"], inside: Float[np.ndarray, " E"]) -> Rows:
    """Return what to do about an emulator that cannot stand in for the physics, if it cannot."""
    error = inside.mean() - outside.mean()
    if abs(error) <= TRUE_RETURN * abs(outside.mean()):
        return []
    advice = (
        f"useless as physics: returns are too {'high' if error > 0 else 'low'} in it; 'neuroanimator train' makes one from the "
        "policy's motions, a better one with more --updates"
    )
    return [("the emulator", advice)]


def _as_json(task: PolicyTask, returns: _Returns) -> dict[str, object]:
    """Return the figures by their published names."""
    outside, inside, of_family = returns
    earned = outside.returns
    figures: dict[str, object] = {
        "environment": task.environment or "the physics",
        "episodes": len(earned),
        "mean_return": float(earned.mean()),
        "least_return": float(earned.min()),
        "largest_return": float(earned.max()),
        "mean_return_inside": float(inside.returns.mean()),
    }
    if task.motion is not None:
        figures["largest_possible_return"] = task.steps
        figures["on_the_motion_at_its_end"] = outside.finished
        figures["on_the_motion_at_its_end_inside"] = inside.finished
    if of_family is not None:
        figures["mean_return_of_family"] = float(of_family.mean())
    return figures
