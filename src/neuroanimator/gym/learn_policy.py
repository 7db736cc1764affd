"""Learn a policy: short rollouts on the true physics, and gradients from an emulator that learns from them too.

Learner.advance, update by update  →  now and then evaluated by whole episodes without noise
                                   →  the best is kept, a checkpoint written, a report given
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from neuroanimator.control.policies.reference_motion import ReferenceMotion
from neuroanimator.control.policies.state_policy import StatePolicy
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.tensors import emulator_tensors, to_numpy
from neuroanimator.files.atomic import Metadata, append_line, canonical_json, digest, locked
from neuroanimator.files.numbers import number, whole
from neuroanimator.gym.bodies import episodes_of
from neuroanimator.gym.learner import Counters, Learner, PolicyLearning
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.gym.state_rows import physics_stepper
from neuroanimator.learn.training.checkpoint import read_tree, write_tree
from neuroanimator.learn.training.train import METRICS, trim_metrics
from neuroanimator.systems.system import System

EVALUATED = 8
"""Number of bodies for each episode that evaluates a policy during learning."""

MAX_UPDATES = 10_000_000
"""Maximum number of updates in a checkpoint."""

MAX_CHECKPOINT = 500_000_000
"""Maximum size of a checkpoint [bytes]: most of it is the replay buffer."""

LARGEST = 1e30


class LearningReport(NamedTuple):
    """Progress of a policy."""

    update: int
    steps: int
    """Number of super steps of the physics, without evaluations."""
    mean_return: float
    """Mean return of whole episodes without noise."""
    spread: float
    """Standard deviation of the noise, averaged over controls."""
    gradient_weight: float
    """Weight of the emulator's gradients beside likelihoods, from 0 to 1."""
    emulator_error: float
    """Error of the emulator on the super steps it learns from; 0 if none learns."""
    seconds: float


def learn_policy(
    system: System,
    emulator: Emulator,
    rules: EpisodeRules,
    learning: PolicyLearning = PolicyLearning(),
    *,
    reference: ReferenceMotion | None = None,
    start: StatePolicy | None = None,
    seconds: float | None = None,
    folder: str | Path | None = None,
    on_share: Callable[[float], None] = lambda share: None,
    on_report: Callable[[LearningReport], None] = lambda report: None,
) -> StatePolicy:
    """Return the best policy found during learning, by whole episodes on the true physics.

    `emulator` leaps one step of the episodes; a copy of it learns from them. `reference` is the motion to follow, if any,
    and `start` the initial policy: with the same controls, its inputs the first of this one's. Given `seconds`, learning
    ends after that time, not after a number of updates, and the policy depends on the machine. Checkpoints and
    `metrics.jsonl` lie in `folder`, if one is given, and a run found there is continued; by number of updates it ends
    with the same bytes. `on_share` is called with the share done. BadFileError if the run in `folder` has another
    emulator, start or other settings.
    """
    place = None if folder is None else Path(folder)
    with nullcontext() if place is None else locked(place):
        run = _Run(system, emulator, rules, learning, reference, start, place)
        return run.finish(seconds, on_share, on_report)


class _Run:
    """Learning between two reports."""

    def __init__(
        self,
        system: System,
        emulator: Emulator,
        rules: EpisodeRules,
        learning: PolicyLearning,
        reference: ReferenceMotion | None,
        start: StatePolicy | None,
        folder: Path | None,
    ):
        self.learner = Learner(system, emulator, rules, learning, reference, start)
        self.stepper = physics_stepper(system, system.scheme, emulator.dt)
        self.folder = folder
        settings = asdict(learning)
        del settings["updates"], settings["reports"]  # a run may be extended
        # The definition holds the task: a run with other rewards is another run.
        settings["definition"] = emulator.definition
        if reference is not None:
            settings["reference"] = digest({"frames": np.asarray(reference.frames)})
        if start is not None:
            settings["start"] = digest(to_numpy(start.leaves()))
        self.identity = f"{digest(emulator_tensors(emulator))[:16]}-{canonical_json(settings)}"
        if folder is None:
            return
        found = read_tree(folder, self.identity, self.learner.progress, _counters, MAX_CHECKPOINT)
        if found is not None:
            self.learner.resume(*found)
        trim_metrics(folder, self.learner.counters.update)

    def finish(
        self,
        seconds: float | None,
        on_share: Callable[[float], None],
        on_report: Callable[[LearningReport], None],
    ) -> StatePolicy:
        """Return the best policy once `seconds` or all updates are over."""
        learner = self.learner
        learning = learner.learning
        spent = learner.counters.seconds
        began = time.monotonic()
        reported = None
        while True:
            elapsed = spent + time.monotonic() - began
            done = learner.counters.update / learning.updates
            if seconds is not None:
                done = elapsed / seconds
            on_share(min(done, 1.0))
            report = int(done * learning.reports)
            if reported is not None and report > reported:
                learner.counters = learner.counters._replace(seconds=elapsed)
                on_report(self._evaluate())
            reported = report
            if done >= 1 and learner.counters.best_return is not None:
                return learner.best
            learner.advance()

    def _evaluate(self) -> LearningReport:
        """Evaluate the policy, write a checkpoint and log."""
        learner = self.learner
        learning = learner.learning
        policy = learner.policy
        episodes = learning.bodies // EVALUATED
        returns = episodes_of(policy, self.stepper, learner.rules, episodes, learning.seed).returns
        learner.keep_if_best(float(returns.mean()))
        counters = learner.counters
        report = LearningReport(
            update=counters.update,
            steps=counters.update * learning.bodies * learning.horizon,
            mean_return=float(returns.mean()),
            spread=float(np.exp(np.asarray(learner.progress.actor.log_spread)).mean()),
            gradient_weight=counters.gradient_weight,
            emulator_error=learner.emulator_error,
            seconds=counters.seconds,
        )
        if self.folder is not None:
            append_line(self.folder / METRICS, json.dumps(report._asdict()))
            write_tree(self.folder, self.identity, learner.progress, counters._asdict())
        return report


def _counters(metadata: Metadata) -> Counters:
    """Return the counters of a checkpoint; ValueError names the one at fault."""
    return Counters(
        update=whole(metadata.get("update"), "update", 0, MAX_UPDATES),
        observed=whole(metadata.get("observed"), "observed", 0, MAX_UPDATES),
        gradient_weight=number(metadata.get("gradient_weight"), "gradient_weight", 0, 1),
        best_return=number(metadata.get("best_return"), "best_return", -LARGEST, LARGEST),
        seconds=number(metadata.get("seconds"), "seconds", 0, LARGEST),
    )
