"""The verb `policy`: learn to walk, run or hop, as the task in a TOML file says."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from neuroanimator.cli.usage import SECONDS_A_MINUTE, check_minutes
from neuroanimator.control.policies.state_policy import load_state_policy
from neuroanimator.emulator.emulator import Emulator, load_emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.learn_policy import (
    LearningReport,
    learn_policy,
)
from neuroanimator.gym.learner import PolicyLearning
from neuroanimator.gym.policy_task import PolicyTask, check_task, task_to_learn
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.learn.training.train import METRICS, read_reports, run_folder, train
from neuroanimator.physics import load_system
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.systems.system import System
from neuroanimator.terminal import Rows, phase, print_rows, progress_bar

EXAMPLE = "neuroanimator policy Hopper-v5.toml --minutes 3 --out hopper.policy.safetensors"

SAMPLES_A_RUN = 36

MIN_SECONDS = 1e-3

MAX_UPDATES = 1_000_000

PERCENT = 100

TINY = 1e-6
"""Relative difference up to which two super steps count as equal."""


def run(
    system: Annotated[
        str,
        typer.Argument(
            help="TOML file with a [task], as 'new Hopper-v5' writes, or with a motion to [follow]."
        ),
    ],
    out: Annotated[Path, typer.Option(help="File for the policy.")],
    emulator: Annotated[
        Path | None,
        typer.Option(help="Initial emulator of one step of the task; if not given, one is made."),
    ] = None,
    start: Annotated[
        Path | None,
        typer.Option(help="Initial policy, such as one that follows the motion to be commanded."),
    ] = None,
    updates: Annotated[
        int, typer.Option(help="Number of policy updates, each from 32 steps of every body.")
    ] = PolicyLearning.updates,
    bodies: Annotated[
        int,
        typer.Option(
            help="Number of bodies that learn in parallel, a multiple of 16. More cores simulate more in the same time."
        ),
    ] = PolicyLearning.bodies,
    minutes: Annotated[
        float | None,
        typer.Option(
            help="Minutes to learn, instead of --updates; the result depends on the machine."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of weights, starts and noise.")] = 0,
) -> None:
    """Learn a policy on the true physics, with the help of gradients from an emulator; needs the extra [gym].

    The rules are those of [task] or [follow]. The policy with the best returns of whole episodes is kept. A stopped run goes
    on where it was, and a finished one goes on for more --updates or --minutes.
    """
    if minutes is not None:
        check_minutes(minutes)
    if not 1 <= updates <= MAX_UPDATES:
        raise ArgumentError(f"updates: wanted 1 to {MAX_UPDATES:,}, got {updates:,}.")
    with phase("loading"):
        name, definition, _ = resolve(system)
        check_task(definition, system)
        trust_files(system)
        body = load_system(system)
        task = task_to_learn(definition, Path(system), body)
    began = time.monotonic()
    if emulator is None:
        leaps = first_emulator(name, definition, task, out, seed)
    else:
        leaps = load_emulator(emulator)
    _check_emulator(leaps, body, task.hold)
    first = load_state_policy(start) if start is not None else None
    learning = replace(task.learning, updates=updates, bodies=bodies, seed=seed)
    limit = None
    if minutes is not None:
        # At least one update, even if making the emulator took all the time.
        limit = max(SECONDS_A_MINUTE * minutes - (time.monotonic() - began), MIN_SECONDS)
    folder = run_folder(out)
    with progress_bar("learning", PERCENT) as bar:
        note = ""

        def on_report(report: LearningReport) -> None:
            nonlocal note
            note = f"mean return {report.mean_return:,.0f}"

        policy = learn_policy(
            body,
            leaps,
            task.rules,
            learning,
            reference=task.motion,
            start=first,
            seconds=limit,
            folder=folder,
            on_share=lambda share: bar.advance_to(round(PERCENT * share), note),
            on_report=on_report,
        )
    policy.save(out, {"seed": seed})
    rows: Rows = [("policy", out), ("metrics", folder / METRICS)]
    told = read_reports(folder / METRICS, LearningReport)
    if told:
        best = max(report.mean_return for report in told)
        rows += [
            ("super steps", f"{told[-1].steps:,} on the physics"),
            ("mean return", f"{best:,.0f}, the best while learning"),
        ]
    print_rows([*rows, ("next", f"neuroanimator evaluate {out} --episodes 100")])


def first_emulator(name: str, definition: str, task: PolicyTask, out: Path, seed: int) -> Emulator:
    """Return an emulator of one step of the task, trained on random controls; its file is in the run folder of policy `out`."""
    path = run_folder(out) / f"{name}.emulator.safetensors"
    if path.exists():
        kept = load_emulator(path)
        if kept.definition == definition:
            return kept
    config = DatasetConfig(
        system=name,
        definition=definition,
        substeps=task.hold,
        count=task.emulator.transitions,
        samples_per_run=SAMPLES_A_RUN,
        seed=seed,
    )
    with phase("simulating random motions"):
        data = simulate_transitions(config)
    training = TrainingConfig.usual(
        data.system.structure,
        widths=task.emulator.widths,
        updates=task.emulator.updates,
        unroll_share=0.0,
        seed=seed,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with progress_bar("training its emulator", task.emulator.updates) as bar:
        return train(data, training, path, on_chunk=bar.advance_to)


def _check_emulator(emulator: Emulator, system: System, hold: int) -> None:
    """Refuse an emulator of another system, or whose super step is not one step of the task."""
    wanted = hold * system.physics_dt
    if emulator.state != system.state or abs(emulator.dt - wanted) > TINY * wanted:
        raise ArgumentError(
            f"emulator: wanted one of {system.name} in super steps of {wanted:g} s, got one of {emulator.system} in "
            f"{emulator.dt:g} s. Leave it out, or train one with --substeps {hold}."
        )
