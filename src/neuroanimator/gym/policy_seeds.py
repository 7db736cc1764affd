"""Train a policy from several seeds in parallel, and find the best: only validation shows which seed is good."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.executor.executor import Executor
from neuroanimator.files.atomic import SIZE_LIMIT, read_bounded, write_whole
from neuroanimator.files.unfinished import temporary_folder
from neuroanimator.files.zoo import find_emulator
from neuroanimator.gym.policy_training import PolicyReport, PolicyTraining, train_policy
from neuroanimator.learn.training.train import METRICS, read_reports, run_folder
from neuroanimator.physics import carried_system
from neuroanimator.systems.named_files import named_model
from neuroanimator.systems.trusted_files import (
    NO_FILES,
    TrustedFiles,
    trust_as_told,
    trusted_so_far,
)


@dataclass(frozen=True)
class SeedTask:
    """One training of a policy."""

    emulator: bytes
    """Content of the emulator's file."""
    training: PolicyTraining
    path: str
    """Path of the policy's file, if the worker can access this disk; empty if not."""
    trusted: TrustedFiles = NO_FILES
    """Files that the submitting process may use."""

    @property
    def label(self) -> str:
        """Its name in error messages."""
        return f"policy, seed {self.training.seed}"


class TrainedPolicy(NamedTuple):
    """The outcome of a training."""

    content: bytes
    """Content of the policy's file."""
    validation: float
    """Least validation loss, from starts and to targets unseen in training."""


class PolicyRow(NamedTuple):
    """One policy of several."""

    seed: int
    validation: float
    path: Path
    best: bool


def run_policy_task(task: SeedTask) -> TrainedPolicy:
    """Return a trained policy: a function of the task alone."""
    trust_as_told(task.trusted)
    with temporary_folder() as folder:
        source = folder / "trained.emulator.safetensors"
        source.write_bytes(task.emulator)
        emulator = Emulator.load(source)
        system = carried_system(emulator.spec.system, emulator.spec.definition)
        path = Path(task.path or f"{folder}/trained.policy.safetensors")
        train_policy(emulator, system, path, task.training)
        reports = read_reports(run_folder(path) / METRICS, PolicyReport)
        least = min(report.validation for report in reports)
        return TrainedPolicy(path.read_bytes(), least)


def train_policies(
    emulator: str | Path,
    out: str | Path,
    seeds: Sequence[int],
    executor: Executor,
    training: PolicyTraining | None = None,
    *,
    on_policy: Callable[[], None] = lambda: None,
) -> list[PolicyRow]:
    """Train a policy through `emulator`, a name or a file, from each of `seeds`; return them in that order.

    Their files go to the folder `out`, as `seed-3.policy.safetensors`; existing ones are not trained again
    if the executor's workers can access this disk. The best has the least validation loss.
    """
    if not seeds or len(set(seeds)) < len(seeds):
        raise ArgumentError(f"seeds: wanted one or more, each once; got {list(seeds)}.")
    source = find_emulator(str(emulator))
    content = read_bounded(source, SIZE_LIMIT)
    # Workers have only the emulator's bytes, without files beside them.
    named_model(Emulator.load(source).definition)
    paths = [Path(out) / f"seed-{seed}.policy.safetensors" for seed in seeds]
    training = training or PolicyTraining()
    tasks = []
    for seed, path in zip(seeds, paths, strict=True):
        seen = str(path.resolve()) if executor.shares_disk else ""
        task = SeedTask(content, replace(training, seed=seed), seen, trusted_so_far())
        tasks.append(task)
    found = executor.map(run_policy_task, tasks, on_done=lambda outcome: on_policy())
    least = min(trained.validation for trained in found)
    rows = []
    for seed, path, trained in zip(seeds, paths, found, strict=True):
        write_whole(path, trained.content)
        rows.append(PolicyRow(seed, trained.validation, path, trained.validation == least))
    return rows
