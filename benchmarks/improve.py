"""How many samples learning where it is weak saves, against samples drawn as datasets are; results/improve.csv.

python benchmarks/improve.py                 pendulum, truck and lander, some minutes on two cores
python benchmarks/improve.py pendulum        some of them; writes no file

A small emulator is trained on a small dataset. Then three arms give it new super steps in rounds, each as many, and after each
round as many weight updates on old and new windows, from the weights of the round before:

random    runs as `generate` draws them
anywhere  runs drawn as `improve` draws what it may simulate, usual and shifted, without choosing among them
improve   a quarter of them drawn so; the rest chosen by the errors to be expected

Each goes on until the 95th percentile of one-step errors on the shifted test of benchmarks/trust.py (controls at their bounds
that jump or stay, starts 1.2 to 2 times as fast) is half of what it was, and that on usual motions no larger than it was.
Samples are super steps by the true physics, the probes among them; tests are not counted.
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
from neuroanimator.bench.csv_table import write_csv
from neuroanimator.data.config import RUN_STEPS
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.data.store import Transitions
from neuroanimator.evaluation.held_out import HeldOut, held_out_runs
from neuroanimator.improvement.config import ImprovementConfig
from neuroanimator.improvement.emulated import errors_on
from neuroanimator.improvement.improve import (
    QUANTILE,
    TEST_RUNS,
    known_states,
    simulated_runs,
    weak_samples,
)
from neuroanimator.improvement.mixture import mixed, warm_config, widened
from neuroanimator.improvement.places import Shifted, Usual, drawn
from neuroanimator.improvement.samples import Samples, Windows, joined, simulated, windows_of
from neuroanimator.machine import describe_machine
from neuroanimator.terminal import print_table, progress_bar

TABLE = Path(__file__).parent / "results" / "improve.csv"

SYSTEMS = ("pendulum", "truck", "lander")

WIDTHS = (48, 32)
COUNT = 12_000
"""Transitions of the first dataset."""
FIRST_UPDATES = 12_000
SAMPLES = 1_500
"""New super steps of a round."""
UPDATES = 2_000
"""Weight updates of a round."""
ROUNDS = 12
"""Rounds an arm may take, at most."""
SEEDS = 3
WANTED = 0.5
"""The error on the shifted test shall become so many times what it was."""
KEPT = 1.0
"""That on the usual one at most so many times."""


class Task(NamedTuple):
    """A small emulator, what it was trained on, and the tests."""

    emulator: Emulator
    data: Transitions
    usual: HeldOut
    away: HeldOut
    seed: int

    def errors(self, emulator: Emulator) -> tuple[float, float]:
        """Return the error (on usual motions, on the shifted test)."""
        return tuple(
            float(np.quantile(errors_on(emulator, test), QUANTILE))
            for test in (self.usual, self.away)
        )


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
        self.places = (Usual(self.system, task.emulator.dt), Shifted(self.system, task.emulator.dt))
        self.config = ImprovementConfig(samples=SAMPLES, updates=UPDATES, seed=task.seed)
        self.samples: list[Samples] = []

    def windows(self, emulator: Emulator, number: int) -> Windows:
        """Return all new windows after round number `number`."""
        rng = np.random.default_rng([self.task.seed, 77, number])
        known = known_states(rng, self.task.data, self.samples)
        self.samples.append(self.drawn(emulator, known, rng))
        return windows_of(joined(self.samples))

    def drawn(self, emulator: Emulator, known: np.ndarray, rng: np.random.Generator) -> Samples:
        raise NotImplementedError


class Improving(Arm):
    """Chosen by the errors to be expected."""

    def drawn(self, emulator: Emulator, known: np.ndarray, rng: np.random.Generator) -> Samples:
        return weak_samples(
            emulator, self.system, self.places, self.task.usual, known, rng, self.config
        )


class Anywhere(Arm):
    """Drawn in the same places, none chosen."""

    def drawn(self, emulator: Emulator, known: np.ndarray, rng: np.random.Generator) -> Samples:
        pool = drawn(self.places, rng, known, simulated_runs(self.config))
        samples, diverged = simulated(self.system, pool, emulator.dt)
        return samples.where(~diverged)


class Random(Arm):
    """As `generate` draws."""

    def windows(self, emulator: Emulator, number: int) -> Windows:
        runs = number * (SAMPLES // RUN_STEPS)
        data = simulate_transitions(
            DatasetConfig(
                system=self.system.name,
                count=runs * 36,
                samples_per_run=36,
                seed=100_000 + self.task.seed,
            )
        )
        return Windows(data.states, data.controls, data.run)


ARMS = {"random": Random, "anywhere": Anywhere, "improve": Improving}


def rows_of(task: Task, name: str, folder: Path) -> list[dict[str, Any]]:
    """Return a row for every round of an arm, until it is good enough."""
    arm = ARMS[name](task)
    config = warm_config(task.emulator, arm.system.structure, UPDATES, seed=0)
    usual, away = task.errors(task.emulator)
    rows = []
    emulator = task.emulator
    for number in range(1, ROUNDS + 1):
        new = arm.windows(emulator, number)
        out = folder / f"{arm.system.name}-{task.seed}-{name}-{number}.safetensors"
        emulator = train(
            mixed(task.data, new, task.seed), config, out, start_from=widened(emulator, new)
        )
        after_usual, after_away = task.errors(emulator)
        is_enough = after_away <= WANTED * away and after_usual <= KEPT * usual
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
                "is_enough": is_enough,
            }
        )
        if is_enough:
            break
    return rows


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return for each system and arm how many samples each seed took."""
    table = []
    for system in dict.fromkeys(row["system"] for row in rows):
        for arm in ARMS:
            own = [row for row in rows if (row["system"], row["arm"]) == (system, arm)]
            taken = []
            for seed in range(SEEDS):
                last = [row for row in own if row["seed"] == seed][-1]
                mark = "" if last["is_enough"] else ">"
                taken.append(f"{mark}{last['samples']}")
            table.append({"system": system, "arm": arm, "samples by seed": ", ".join(taken)})
    return table


def main() -> None:
    systems = sys.argv[1:] or SYSTEMS
    rows = []
    with (
        TemporaryDirectory() as name,
        progress_bar("arms", len(systems) * SEEDS * len(ARMS)) as bar,
    ):
        done = 0
        for system in systems:
            for seed in range(SEEDS):
                task = task_of(system, seed, Path(name))
                for arm in ARMS:
                    rows += rows_of(task, arm, Path(name))
                    done += 1
                    bar.advance_to(done, f"{system} {arm}")
    print(describe_machine())
    print_table(summary(rows))
    if not sys.argv[1:]:
        write_csv(TABLE, rows)


if __name__ == "__main__":
    main()
