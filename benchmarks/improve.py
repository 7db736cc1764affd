"""Samples saved by learning where an emulator is weak, against samples drawn like datasets; results/improve.csv.

python benchmarks/improve.py                 pendulum, truck and lander, half an hour on two cores
python benchmarks/improve.py fish            others; writes no file

A small emulator is trained on a small dataset. Then three arms give it equally many new super steps in rounds, and after each
round equally many weight updates on old and new windows, from the weights of the round before:

random    runs drawn like those of `generate`
anywhere  runs from the distributions of `improve`, usual and shifted, without choosing among them
improve   a quarter of them drawn so; the rest chosen by expected error

All learn like `improve`: large errors count less, and an emulator that forgot usual motions is moved back towards its first
weights. An arm has reached a tolerance after the first round in which the 95th percentile of one-step errors on the shifted test
of benchmarks/trust.py (controls at their bounds that jump or stay, starts 1.2 to 2 times as fast) is that share of its old value,
and on usual motions at most 1.05 times its old value. Samples are super steps by the true physics, including the probes; tests
are not counted. They do not depend on other work on the machine.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from trust import shifted

from neuroanimator import DatasetConfig, Emulator, TrainingConfig, train
from neuroanimator.data.config import RUN_STEPS
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.data.sampling import sample_control_runs, sample_starts
from neuroanimator.data.store import Transitions
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.held_out import HeldOut, held_out_runs
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.evaluation.weakness.config import ImprovementConfig
from neuroanimator.evaluation.weakness.improve import GUARD, TEST_RUNS, known_states, usual_test
from neuroanimator.evaluation.weakness.learning import Learner, error_on
from neuroanimator.evaluation.weakness.sampling import (
    Runs,
    distributions_of,
    draw_runs,
    sample_weak_runs,
    simulate_runs,
)
from neuroanimator.executor.cores import core_count
from neuroanimator.terminal import print_table, progress_bar

TABLE = Path(__file__).parent / "results" / "improve.csv"

SYSTEMS = ("pendulum", "truck", "lander")

WIDTHS = (48, 32)
COUNT = 40_000
"""Transitions of the first dataset."""
FIRST_UPDATES = 12_000
SAMPLES = 1_500
"""New super steps of a round."""
UPDATES = 4_000
"""Weight updates of a round."""
WINDOWS = 36_000
"""Windows learnt from in a round."""
ROUNDS = {"improve": 4, "anywhere": 8, "random": 12}
"""Rounds of each arm: three times as many are needed to see that random samples take three times as many."""
SEEDS = (11, 12, 13)
"""Settings were chosen by seeds 0 to 2; these nobody had looked at."""
TOLERANCES = (0.9, 0.8, 0.7)
"""Shares of the error on the shifted test, as it was."""
KEPT = 1.05
"""Maximum ratio of the error on the usual one to what it was: quantiles of so few super steps are known no better."""


class Task(NamedTuple):
    """A small emulator, what it was trained on, and the tests."""

    emulator: Emulator
    data: Transitions
    usual: HeldOut
    away: HeldOut
    seed: int

    def errors(self, emulator: Emulator) -> tuple[float, float]:
        """Return the error (on usual motions, on the shifted test)."""
        return error_on(emulator, self.usual), error_on(emulator, self.away)


def task_of(system: str, seed: int, folder: Path) -> Task:
    """Return what an arm begins with."""
    data = simulate_transitions(
        DatasetConfig(system=system, count=COUNT, samples_per_run=36, seed=seed)
    )
    config = TrainingConfig(widths=WIDTHS, updates=FIRST_UPDATES, seed=seed)
    emulator = train(data, config, folder / f"{system}-{seed}.safetensors")
    truth = data.system.truth
    usual = held_out_runs(
        emulator, TEST_RUNS, RUN_STEPS * emulator.dt, seed=1000 + seed, scheme=truth
    )
    steps = shifted(data.system, emulator.dt, seed=1000 + seed)
    away = replace(
        usual,
        states=np.stack([steps.states, steps.ends], axis=1),
        controls=steps.controls[:, None],
    )
    return Task(emulator, data, usual, away, seed)


class Arm:
    """New samples, round by round."""

    def __init__(self, task: Task):
        self.task = task
        self.system = task.data.system
        self.distributions = distributions_of(self.system, task.emulator.dt)
        self.config = ImprovementConfig(
            samples=SAMPLES, updates=UPDATES, windows=WINDOWS, seed=task.seed
        )
        guard = usual_test(task.emulator, self.system, task.seed, GUARD)
        self.learner = Learner(task.data, task.emulator, guard, self.config)
        self.samples: list[Runs] = []

    def next_round(self, emulator: Emulator, number: int, folder: Path) -> Emulator:
        """Return the emulator trained on with the samples of one round more."""
        rng = np.random.default_rng([self.task.seed, 77, number])
        known = known_states(rng, self.task.data, self.samples)
        self.samples.append(self.drawn(emulator, known, rng))
        out = folder / f"{type(self).__name__}-{self.system.name}-{self.task.seed}-{number}"
        return self.learner.learn(emulator, self.samples, out.with_suffix(".safetensors"))

    def drawn(self, emulator: Emulator, known: np.ndarray, rng: np.random.Generator) -> Runs:
        raise NotImplementedError


class Improving(Arm):
    """Chosen by the errors to be expected."""

    def drawn(self, emulator: Emulator, known: np.ndarray, rng: np.random.Generator) -> Runs:
        return sample_weak_runs(
            emulator, self.distributions, self.task.usual, known, rng, self.config
        )


class Anywhere(Arm):
    """Drawn from the same distributions, none chosen."""

    def drawn(self, emulator: Emulator, known: np.ndarray, rng: np.random.Generator) -> Runs:
        pool = draw_runs(self.distributions, rng, known, self.config.runs)
        samples, _ = simulate_runs(self.system, pool, emulator.dt)
        return samples


class Random(Arm):
    """As `generate` draws."""

    def drawn(self, emulator: Emulator, known: np.ndarray, rng: np.random.Generator) -> Runs:
        count = SAMPLES // RUN_STEPS
        starts = sample_starts(self.system, rng, count, core_count())
        controls = sample_control_runs(rng, count, RUN_STEPS, emulator.dt, self.system)
        runs = self.system.simulate(starts, controls, emulator.dt, threads=core_count())
        samples = Runs(runs.states, controls, np.zeros(count, int))
        return samples.rows(~runs.has_diverged)


ARMS = {"improve": Improving, "anywhere": Anywhere, "random": Random}


def rows_of(task: Task, name: str, folder: Path) -> list[dict[str, Any]]:
    """Return a row for every round of an arm."""
    arm = ARMS[name](task)
    usual, away = task.errors(task.emulator)
    rows = []
    emulator = task.emulator
    for number in range(1, ROUNDS[name] + 1):
        emulator = arm.next_round(emulator, number, folder)
        accepted = arm.learner.accept(emulator) or task.emulator
        after_usual, after_away = task.errors(accepted)
        rows.append(
            {
                "system": arm.system.name,
                "seed": task.seed,
                "arm": name,
                "samples": number * SAMPLES,
                "usual_before": usual,
                "usual": after_usual,
                "shifted_before": away,
                "shifted": after_away,
            }
        )
    return rows


def samples_until(rows: list[dict[str, Any]], tolerance: float) -> float:
    """Return how many samples the rows of one arm and seed took to reach a tolerance; infinitely many if it was not reached."""
    for row in rows:
        is_within = row["shifted"] <= tolerance * row["shifted_before"]
        if is_within and row["usual"] <= KEPT * row["usual_before"]:
            return row["samples"]
    return np.inf


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return for each system and tolerance how many samples each seed took by each arm; `>` where it was not reached."""
    table = []
    for system in dict.fromkeys(row["system"] for row in rows):
        for tolerance in TOLERANCES:
            line: dict[str, Any] = {"system": system, "tolerance": tolerance}
            for arm in ARMS:
                most = ROUNDS[arm] * SAMPLES
                told = []
                for seed in SEEDS:
                    wanted = (system, arm, seed)
                    own = [
                        row for row in rows if (row["system"], row["arm"], row["seed"]) == wanted
                    ]
                    taken = samples_until(own, tolerance)
                    told.append(f"{taken:.0f}" if taken <= most else f">{most}")
                line[arm] = " ".join(told)
            table.append(line)
    return table


def after_as_many(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return what each arm made of as many samples as `improve` takes in all: errors over what they were, a seed each."""
    samples = ROUNDS["improve"] * SAMPLES
    table = []
    for system in dict.fromkeys(row["system"] for row in rows):
        for test in ("shifted", "usual"):
            line: dict[str, Any] = {"system": system, f"error after {samples}": test}
            for arm in ARMS:
                wanted = (system, arm, samples)
                own = [row for row in rows if (row["system"], row["arm"], row["samples"]) == wanted]
                line[arm] = " ".join(f"{row[test] / row[f'{test}_before']:.2f}" for row in own)
            table.append(line)
    return table


def main() -> None:
    systems = sys.argv[1:] or SYSTEMS
    rows = []
    with (
        TemporaryDirectory() as name,
        progress_bar("arms", len(systems) * len(SEEDS) * len(ARMS)) as bar,
    ):
        done = 0
        for system in systems:
            for seed in SEEDS:
                task = task_of(system, seed, Path(name))
                for arm in ARMS:
                    own = rows_of(task, arm, Path(name))
                    rows += own
                    done += 1
                    last = own[-1]
                    bar.advance_to(done, f"{system}, {arm}: error {last['shifted']:.3f}")
    print(describe_machine())
    print_table(summary(rows))
    print_table(after_as_many(rows))
    if not sys.argv[1:]:
        write_csv(TABLE, rows)


if __name__ == "__main__":
    main()
