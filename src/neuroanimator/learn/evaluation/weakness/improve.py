"""Active learning: find where an emulator is weak, simulate there, train on from its weights, and forget nothing.

    distributions   usual, shifted, near users' controllers           → candidate runs                  sampling.py
    large errors    trust of the emulated candidates × errors of a probe  → the runs that are simulated     sampling.py
    learning        new windows among old ones                            → the emulator of a round         learning.py
    tests           errors on every distribution, before and after        → stop, or another round          here

Every round is a function of those before it, and training goes on from its checkpoints: killed at any moment and
started again, an improvement ends with the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.artifact import save
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.files.places import place_of
from neuroanimator.learn.data.config import RUN_STEPS, USUAL_SAMPLES_PER_RUN, DatasetConfig
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.data.store import Transitions, read_config, read_transitions
from neuroanimator.learn.evaluation.held_out import HELD_OUT_SEED, HeldOut, held_out_runs, system_of
from neuroanimator.learn.evaluation.weakness.config import RUN_LENGTH, ImprovementConfig
from neuroanimator.learn.evaluation.weakness.learning import (
    NEW_SHARE,
    RoundTrainer,
    error_on,
    resample,
)
from neuroanimator.learn.evaluation.weakness.sampling import (
    Distribution,
    RunBatch,
    distributions_of,
    draw_near,
    draw_runs,
    join_runs,
    sample_weak_runs,
    simulate_runs,
)
from neuroanimator.learn.training.train import Report, run_folder
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase

GUARD = 1
"""Number of the test of usual motions by which emulators are accepted, other than the reported one."""

USUAL_GAIN = 0.7
"""Tolerance if none is given, as a share of the largest error."""

REACHED_SHARE = 0.5
"""Number of starts at the ends of earlier rounds' runs, for each start among old states."""

TEST_RUNS = 64
"""Number of runs in the test of usual motions."""

TEST_SHORT_RUNS = 160
"""Number of runs in the test of any other distribution."""

FRESH_SEED = 2**31 - 2
"""Seed of the usual motions simulated anew against forgetting: one that a dataset seldom has."""

MAX_KNOWN = 20_000
"""Maximum number of old states that runs begin from."""

ROUND_STREAM = 11
"""Number that names, with the seed and the round, the random stream of a round."""

TEST_STREAM = 12
"""The same for tests."""


@dataclass(frozen=True)
class ErrorChange:
    """An emulator's error on one distribution before and after."""

    distribution: str
    before: float
    """The 95th percentile of one-step errors, in standard deviations of the usual change."""
    after: float


@dataclass(frozen=True)
class Improvement:
    """The result of an improvement: the new emulator, and errors before and after."""

    emulator: Emulator
    errors: tuple[ErrorChange, ...]
    """Errors by distribution, usual motions first."""
    tolerance: float
    rounds: int
    """Number of rounds taken."""
    samples: int
    """Number of new super steps simulated."""

    @property
    def is_within_tolerance(self) -> bool:
        """Whether no error is above the tolerance."""
        return max(error.after for error in self.errors) <= self.tolerance

    def __str__(self) -> str:
        """Return the result as a sentence."""
        if not self.rounds:
            return f"nothing to do: every error is at most {self.tolerance:.3g} already, so no sample was simulated"
        taken = f"{self.samples:,} samples in {self.rounds} rounds"
        if self.is_within_tolerance:
            return f"every error is at most {self.tolerance:.3g} after {taken}"
        if all(error.after == error.before for error in self.errors):
            return f"no better after {taken}, if usual errors are to stay: try a larger network, or more --updates"
        return f"not every error is at most {self.tolerance:.3g} after {taken}: allow more --rounds, or --samples"


def improve(
    emulator: Emulator,
    out: str | Path,
    *,
    tolerance: float | None = None,
    config: ImprovementConfig | None = None,
    data: Transitions | None = None,
    controllers: Mapping[str, Float[np.ndarray, "T C"]] | None = None,
    start: Float[np.ndarray, " S"] | None = None,
    on_round: Callable[[int, Mapping[str, float]], None] = lambda number, errors: None,
    on_report: Callable[[Report], None] = lambda report: None,
) -> Improvement:
    """Improve `emulator` where it is weak, write it to `out` and return it with its errors before and after.

    It is weak where its errors are large: in usual motions, beyond them, and along the motions of the named `controllers`
    from `start` (S,) or from rest. In each of `config.rounds` rounds, runs are drawn from all these distributions,
    simulated where large errors are expected, and learnt from among the old data (`data`, or some simulated anew), until
    no distribution's 95th percentile of one-step errors is above `tolerance` [standard deviations of the usual change];
    seven tenths of the largest if not given. An emulator whose error on usual motions grew by more than a tenth is
    rejected. `on_round` is called with the number of each round and the errors after it, by distribution.

    Trainings of rounds lie in `run_folder(out)` and are resumed there, also with another tolerance or more rounds.

    Raises ArgumentError for a system that cannot be simulated, and for controls out of bounds; BadFileError for a folder
    that holds another improvement.
    """
    config = config or ImprovementConfig()
    system = system_of(emulator)
    if not system.can_simulate:
        raise ArgumentError(
            f"{system.name} is known from recordings alone and cannot be simulated where its emulator is weak. "
            "Give it more recordings: improve --from recording.csv."
        )
    if tolerance is not None and not 0 < tolerance < np.inf:
        raise ArgumentError(f"tolerance: wanted a number above 0, got {tolerance:g}.")
    distributions = distributions_of(system, emulator.dt)
    begin = emulator.rest if start is None else np.asarray(start, float)
    for name, controls in (controllers or {}).items():
        distributions.append(_near_controller(system, name, begin, controls, emulator.dt))
    data = data or fresh_data(emulator, config)
    with phase("simulating tests"):
        tests = _tests(emulator, system, distributions, config.seed)
        guard = usual_test(emulator, system, config.seed, GUARD)
    learner = RoundTrainer(data, emulator, guard, config)
    before = errors_by_test(emulator, tests)
    wanted = tolerance or USUAL_GAIN * max(before.values())
    best = emulator
    best_errors = before
    latest = emulator
    samples: list[RunBatch] = []
    on_round(0, before)
    while max(best_errors.values()) > wanted and len(samples) < config.rounds:
        number = len(samples) + 1
        with phase("simulating where errors are expected"):
            rng = np.random.default_rng([config.seed, ROUND_STREAM, number])
            known = known_states(rng, data, samples)
            runs = sample_weak_runs(latest, distributions, tests["usual"], known, rng, config)
            samples.append(runs.shortened())
        path = run_folder(Path(out)) / f"round-{number:03d}.emulator.safetensors"
        latest = learner.learn(latest, samples, path, on_report)
        accepted = learner.accept(latest)
        errors = errors_by_test(accepted or latest, tests)
        on_round(number, errors)
        if accepted is not None and max(errors.values()) < max(best_errors.values()):
            best = accepted
            best_errors = errors
    simulated = len(samples) * config.runs * RUN_LENGTH
    provenance = {
        "dataset": data.config.model_dump(),
        "improvement": config.model_dump() | {"samples": simulated},
    }
    save(best, Path(out), provenance)
    return Improvement(
        emulator=best,
        errors=error_changes(before, best_errors),
        tolerance=wanted,
        rounds=len(samples),
        samples=simulated,
    )


def _near_controller(
    system: System,
    name: str,
    start: Float[np.ndarray, " S"],
    controls: Float[np.ndarray, "T C"],
    dt: float,
) -> Distribution:
    """Return the distribution near a controller's motion; ArgumentError names a controller whose motion diverges."""
    try:
        held = system.check_controls(controls)
    except ArgumentError as error:
        raise ArgumentError(f"{name}: {error}") from error
    runs = system.simulate(start[None], held[None], dt)
    if runs.has_diverged.any():
        raise ArgumentError(
            f"{name}: the physics itself diverges under these controls. Leave it out, or start elsewhere."
        )
    return Distribution(name, partial(draw_near, system, runs.states[0], held))


def fresh_data(emulator: Emulator, config: ImprovementConfig) -> Transitions:
    """Return usual motions, simulated anew against forgetting: as many as a round learns from."""
    dataset = DatasetConfig(
        system=emulator.system,
        definition=emulator.definition,
        substeps=emulator.substeps,
        count=round((1 - NEW_SHARE) * config.windows),
        samples_per_run=USUAL_SAMPLES_PER_RUN,
        seed=FRESH_SEED,
    )
    with phase("simulating what it knows"):
        return simulate_transitions(dataset)


def read_old_data(folder: str | Path, emulator: Emulator, config: ImprovementConfig) -> Transitions:
    """Return the first shards of the emulator's dataset in `folder`, as many as a round learns from; all, for recordings.

    Raises BadFileError as `read_transitions` does, ArgumentError for a dataset of another system or super step.
    """
    place = place_of(folder)
    dataset = read_config(place)
    if (dataset.system, dataset.substeps) != (emulator.system, emulator.substeps):
        raise ArgumentError(
            f"data: {folder} is of {dataset.system}, {dataset.substeps} substeps; wanted {emulator.system}, "
            f"{emulator.substeps}. Give the emulator's own dataset, or none."
        )
    return read_transitions(place, at_least=config.windows)


def errors_by_test(emulator: Emulator, tests: Mapping[str, HeldOut]) -> dict[str, float]:
    """Return the error on each test, by name."""
    return {name: error_on(emulator, test) for name, test in tests.items()}


def error_changes(
    before: Mapping[str, float], after: Mapping[str, float]
) -> tuple[ErrorChange, ...]:
    """Return the errors on each test, before and after."""
    return tuple(ErrorChange(name, error, after[name]) for name, error in before.items())


def known_states(
    rng: np.random.Generator, data: Transitions, samples: Sequence[RunBatch]
) -> Float[np.ndarray, "K S"]:
    """Return states of the physics: old ones, and ends of earlier rounds' runs."""
    rows = resample(rng, np.arange(len(data.states)), min(MAX_KNOWN, len(data.states)))
    old = data.states[rows, 0].astype(float)
    if not samples:
        return old
    reached = join_runs(samples).states[:, -1].astype(float)
    again = resample(rng, np.arange(len(reached)), round(REACHED_SHARE * len(old)))
    return np.concatenate([old, reached[again]])


def _tests(
    emulator: Emulator, system: System, distributions: Sequence[Distribution], seed: int
) -> dict[str, HeldOut]:
    """Return a test of each distribution, by name, simulated as samples are and never learnt from."""
    usual = usual_test(emulator, system, seed)
    known = usual.states[:, :-1].reshape(-1, usual.states.shape[-1])
    tests = {"usual": usual}
    for number, distribution in enumerate(distributions[1:]):
        rng = np.random.default_rng([HELD_OUT_SEED, TEST_STREAM, seed, number])
        drawn = draw_runs([distribution], rng, known, TEST_SHORT_RUNS)
        runs, is_sound = simulate_runs(system, drawn, emulator.dt)
        if not is_sound.any():
            raise ArgumentError(
                f"{distribution.name}: the physics itself diverges in every test run there. Leave it out."
            )
        tests[distribution.name] = replace(usual, states=runs.states, controls=runs.controls)
    return tests


def usual_test(emulator: Emulator, system: System, seed: int, kind: int = 0) -> HeldOut:
    """Return a test of usual motions; another `kind` draws others from the same seed."""
    seconds = RUN_STEPS * emulator.dt
    return held_out_runs(emulator, TEST_RUNS, seconds, seed=2 * seed + kind, scheme=system.truth)
