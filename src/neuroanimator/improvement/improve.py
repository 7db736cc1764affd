"""Find where an emulator is weak, simulate there, train on from its weights, and keep what it knew.

The way of the data:

    what may be asked        usual, shifted, users' controllers, recordings  → runs that may be simulated    places.py
    where errors are large   trust of the emulated runs × errors of a probe  → the runs that are simulated   choice.py
    the true physics         those runs                                      → a file of samples             samples.py
    what was known           old windows among new ones                      → training on, a new meter      mixture.py
    tests nobody learns from errors in every place, before and after         → stop, or another round        here

Every file is a function of what came before it, and whole or absent: killed at any moment and started again, an
improvement ends with the same bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.cores import core_count
from neuroanimator.data.config import RUN_STEPS, USUAL_SAMPLES_PER_RUN, DatasetConfig
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.data.store import Transitions
from neuroanimator.emulator.artifact import save
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.tensors import emulator_tensors
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.evaluation.held_out import HELD_OUT_SEED, HeldOut, held_out_runs, system_of
from neuroanimator.improvement.choice import ExpectedError, chosen
from neuroanimator.improvement.config import STRETCH, ImprovementConfig
from neuroanimator.improvement.emulated import errors_on, trust_along
from neuroanimator.improvement.learning import Learner, error_on
from neuroanimator.improvement.mixture import NEW_SHARE, resampled
from neuroanimator.improvement.places import Motion, Place, Shifted, Stretches, Usual, drawn
from neuroanimator.improvement.recordings import motions_of, read_runs
from neuroanimator.improvement.samples import (
    Samples,
    joined,
    read_samples,
    simulated,
    write_samples,
)
from neuroanimator.storage.files import digest, locked, write_whole
from neuroanimator.storage.unfinished import remove_stale
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase
from neuroanimator.training.train import Report, run_folder

GUARD = 1
"""The usual motions that this is judged by are drawn apart from those whose error is told."""

USUAL_GAIN = 0.7
"""If nothing else is said, no error shall be larger than so many times what the largest is now."""

PROBE_SHARE = 0.25
"""Share of a round's samples that is drawn anywhere: it tells what error goes with which trust, and keeps the rest broad."""

POOL = 8
"""So many runs are drawn, and emulated, for each that is simulated."""

REACHED_SHARE = 0.5
"""After the first round so many starts for each old one are where the physics has come to in earlier rounds."""

TEST_RUNS = 64
"""Runs in the test of usual motions."""

TEST_STRETCHES = 160
"""Short runs in the test of every other place."""

FRESH_SEED = 2**31 - 2
"""The seed of what is simulated anew to keep what was known: one that a dataset seldom has."""

MAX_KNOWN = 20_000
"""Old states that runs begin from, at most."""

ROUND_STREAM = 11
"""A round draws from a stream of its own: the seed with this number and that of the round."""

TEST_STREAM = 12
"""So does a test."""

MANIFEST = "improvement.json"
"""The file in the folder of an improvement that says what it follows from."""


@dataclass(frozen=True)
class PlaceError:
    """What an emulator's error is in a place."""

    place: str
    before: float
    """The 95th percentile of one-step errors, in standard deviations of the usual change."""
    after: float


@dataclass(frozen=True)
class Improvement:
    """What came of it."""

    emulator: Emulator
    errors: tuple[PlaceError, ...]
    """Of the usual motions first."""
    tolerance: float
    rounds: int
    """So many were gone through."""
    samples: int
    """New super steps that were simulated."""
    best_round: int
    """The round the emulator is of; 0 if it is the one that was given."""

    @property
    def is_within_tolerance(self) -> bool:
        """Whether no place's error is above the tolerance."""
        return max(error.after for error in self.errors) <= self.tolerance

    def __str__(self) -> str:
        """Return what came of it as a sentence."""
        if not self.rounds:
            return f"nothing to do: every error is at most {self.tolerance:.3g} already, so no sample was simulated"
        taken = f"{self.samples:,} samples in {self.rounds} rounds"
        if self.is_within_tolerance:
            return f"every error is at most {self.tolerance:.3g} after {taken}"
        if not self.best_round:
            return f"no better after {taken}, if usual errors are to stay: try a larger network, or more --updates"
        return f"not every error is at most {self.tolerance:.3g} after {taken}: give it more --rounds, or --samples"


@dataclass(frozen=True)
class RoundReport:
    """How far it is after a round."""

    number: int
    samples: int
    """Simulated so far."""
    errors: Mapping[str, float]
    """By the names of the places."""


def improve(
    emulator: Emulator,
    out: str | Path,
    *,
    tolerance: float | None = None,
    config: ImprovementConfig | None = None,
    data: Transitions | None = None,
    controllers: Mapping[str, Float[np.ndarray, "T C"]] | None = None,
    start: Float[np.ndarray, " S"] | None = None,
    recordings: Sequence[str | Path] = (),
    on_round: Callable[[RoundReport], None] = lambda report: None,
    on_report: Callable[[Report], None] = lambda report: None,
) -> Improvement:
    """Improve `emulator` where it is weak, write it to `out` and return what came of it.

    It is weak where its errors are large: in usual motions, beyond them, along what `controllers`, by their names, do
    from `start` (S,) or from rest, and along `recordings` (CSV or NPZ files). In each of `config.rounds` runs are drawn
    in all these places, simulated where errors are to be expected, and learnt from among the old data, `data` or some
    simulated anew, until no place's 95th percentile of one-step errors is above `tolerance` [standard deviations of
    the usual change]; seven tenths of the largest there is if not given. No emulator is taken whose error on usual
    motions grew by more than a tenth.

    Rounds lie in `run_folder(out)`; what was begun there goes on, also with another tolerance or more rounds.

    Raises ArgumentError for a system that cannot be simulated, and for controls out of bounds.
    """
    config = config or ImprovementConfig()
    system = system_of(emulator)
    refuse_unsimulated(system)
    if tolerance is not None and not 0 < tolerance < np.inf:
        raise ArgumentError(f"tolerance: wanted a number above 0, came {tolerance:g}.")
    out = Path(out)
    places = _places(emulator, system, controllers or {}, start, recordings)
    if data is None:
        with phase("simulating what it knows"):
            data = fresh_data(emulator, config)
    folder = run_folder(out)
    with locked(folder):
        remove_stale(folder)
        work = _Work.prepare(emulator, system, places, data, config, folder)
        result = work.done(tolerance, on_round, on_report)
        provenance = {
            "dataset": data.config.model_dump(),
            "improvement": config.model_dump() | {"samples": result.samples},
        }
        save(result.emulator, out, provenance)
    return result


def refuse_unsimulated(system: System) -> None:
    """Raise ArgumentError for a system that is known from recordings alone."""
    if not system.can_simulate:
        raise ArgumentError(
            f"{system.name} is known from recordings alone and cannot be simulated where its emulator is weak. "
            "Give it more recordings: improve --from recording.csv."
        )


def fresh_data(emulator: Emulator, config: ImprovementConfig) -> Transitions:
    """Return usual motions, simulated anew, to keep what an emulator knows: as many as a round learns from."""
    dataset = DatasetConfig(
        system=emulator.system,
        definition=emulator.definition,
        substeps=emulator.substeps,
        count=round((1 - NEW_SHARE) * config.windows),
        samples_per_run=USUAL_SAMPLES_PER_RUN,
        seed=FRESH_SEED,
    )
    return simulate_transitions(dataset)


def _places(
    emulator: Emulator,
    system: System,
    controllers: Mapping[str, Float[np.ndarray, "T C"]],
    start: Float[np.ndarray, " S"] | None,
    recordings: Sequence[str | Path],
) -> tuple[Place, ...]:
    """Return where the emulator may be weak."""
    places: list[Place] = [Usual(system, emulator.dt), Shifted(system, emulator.dt)]
    state = emulator.rest if start is None else np.asarray(start, float)
    for name, controls in controllers.items():
        held = _checked_controls(system, name, controls)
        runs = system.simulate(state[None], held[None], emulator.dt)
        if runs.has_diverged.any():
            raise ArgumentError(
                f"{name}: the physics itself diverges under these controls. Leave it out, or start elsewhere."
            )
        places.append(Motion(system, name, (runs.states[0],), (held,)))
    for path in recordings:
        motions = motions_of(read_runs(path, emulator), emulator)
        states = tuple(motion.states for motion in motions)
        held = tuple(motion.controls for motion in motions)
        places.append(Motion(system, str(path), states, held))
    return tuple(places)


def _checked_controls(
    system: System, name: str, controls: Float[np.ndarray, "T C"]
) -> Float[np.ndarray, "T C"]:
    """Return a controller's controls; ArgumentError names the controller and the control that is out of bounds."""
    try:
        return system.check_controls(controls)
    except ArgumentError as error:
        raise ArgumentError(f"{name}: {error}") from error


@dataclass
class _Work:
    """An improvement between two rounds."""

    system: System
    places: tuple[Place, ...]
    data: Transitions
    config: ImprovementConfig
    folder: Path
    identity: str
    """Names all that the rounds follow from."""
    tests: tuple[HeldOut, ...]
    """One for each place."""
    emulator: Emulator
    """The last round's, whatever it has forgotten: it goes on learning."""
    learner: Learner
    samples: list[Samples] = field(default_factory=list)
    """Those of each round."""

    @classmethod
    def prepare(
        cls,
        emulator: Emulator,
        system: System,
        places: tuple[Place, ...],
        data: Transitions,
        config: ImprovementConfig,
        folder: Path,
    ) -> _Work:
        """Return the improvement in `folder`, with its tests."""
        identity = _identity(emulator, places, data, config)
        _claim(folder, identity)
        with phase("simulating tests"):
            tests = _tests(emulator, system, places, config.seed)
            guard = usual_test(emulator, system, config.seed, GUARD)
        learner = Learner(system, data, emulator, guard, config)
        return cls(system, places, data, config, folder, identity, tests, emulator, learner)

    def done(
        self,
        tolerance: float | None,
        on_round: Callable[[RoundReport], None],
        on_report: Callable[[Report], None],
    ) -> Improvement:
        """Go through rounds until the tolerance is kept or there are no more; what is there already is gone through, too."""
        before = self._errors(self.emulator)
        wanted = tolerance or USUAL_GAIN * max(before.values())
        best = before
        best_emulator = self.emulator
        best_round = 0
        number = 0
        on_round(RoundReport(0, 0, before))
        while max(best.values()) > wanted and number < self.config.rounds:
            number += 1
            self._go_on(number, on_report)
            kept = self.learner.kept(self.emulator)
            errors = self._errors(kept or self.emulator)
            on_round(RoundReport(number, self._count(), errors))
            if kept is not None and max(errors.values()) < max(best.values()):
                best = errors
                best_emulator = kept
                best_round = number
        told = [PlaceError(name, error, best[name]) for name, error in before.items()]
        return Improvement(best_emulator, tuple(told), wanted, number, self._count(), best_round)

    def _count(self) -> int:
        """Return how many super steps were simulated."""
        return len(self.samples) * simulated_runs(self.config) * STRETCH

    def _errors(self, emulator: Emulator) -> dict[str, float]:
        """Return the error of an emulator in each place."""
        errors = {}
        for place, test in zip(self.places, self.tests, strict=True):
            errors[place.name] = error_on(emulator, test)
        return errors

    def _go_on(self, number: int, on_report: Callable[[Report], None]) -> None:
        """Go through round number `number`, or take what is left of it."""
        with phase("simulating where errors are expected"):
            self.samples.append(self._round_samples(number))
        path = self.folder / f"round-{number:03d}.emulator.safetensors"
        self.emulator = self.learner.learn(self.emulator, self.samples, path, on_report)

    def _round_samples(self, number: int) -> Samples:
        """Return a round's samples: those stored, or new ones, which are stored."""
        path = self.folder / f"round-{number:03d}.samples.safetensors"
        identity = f"{self.identity}-{number}"
        try:
            return read_samples(path, self.system, len(self.places), identity)
        except BadFileError:  # there are none yet, or they are damaged
            rng = np.random.default_rng([self.config.seed, ROUND_STREAM, number])
            known = known_states(rng, self.data, self.samples)
            samples = weak_samples(
                self.emulator, self.system, self.places, self.tests[0], known, rng, self.config
            )
            write_samples(path, samples, identity)
            # As those read back are.
            return read_samples(path, self.system, len(self.places), identity)


def simulated_runs(config: ImprovementConfig) -> int:
    """Return how many runs are simulated in a round."""
    return config.samples // STRETCH


def known_states(
    rng: np.random.Generator, data: Transitions, samples: Sequence[Samples]
) -> Float[np.ndarray, "K S"]:
    """Return states that the physics was seen in: old ones, and where it has come to in earlier rounds."""
    rows = resampled(rng, np.arange(len(data.states)), min(MAX_KNOWN, len(data.states)))
    old = data.states[rows, 0].astype(float)
    if not samples:
        return old
    reached = joined(samples).states[:, -1].astype(float)
    again = resampled(rng, np.arange(len(reached)), round(REACHED_SHARE * len(old)))
    return np.concatenate([old, reached[again]])


def weak_samples(
    emulator: Emulator,
    system: System,
    places: tuple[Place, ...],
    usual: HeldOut,
    known: Float[np.ndarray, "K S"],
    rng: np.random.Generator,
    config: ImprovementConfig,
) -> Samples:
    """Return a round's samples by the true physics: a probe drawn anywhere, and runs in which errors are to be expected."""
    count = simulated_runs(config)
    probes = round(PROBE_SHARE * count)
    pool = drawn(places, rng, known, POOL * count)
    scores = trust_along(emulator, pool.starts, pool.controls)
    order = rng.permutation(len(pool.starts))
    probe, diverged = simulated(system, pool.rows(order[:probes]), emulator.dt)
    test = replace(usual, states=probe.states, controls=probe.controls)
    whole = ~diverged
    errors = errors_on(emulator, test)[whole]
    expected = ExpectedError.fitted(
        scores[order[:probes]][whole], errors, probe.place[whole], len(places)
    )
    rest: Stretches = pool.rows(order[probes:])
    weights = expected.of(scores[order[probes:]], rest.place)
    weak, lost = simulated(system, chosen(rng, rest, weights, count - probes), emulator.dt)
    return joined([probe.where(whole), weak.where(~lost)])


def _tests(
    emulator: Emulator, system: System, places: tuple[Place, ...], seed: int
) -> tuple[HeldOut, ...]:
    """Return a test for each place, simulated as what is learnt from is, and never learnt from."""
    usual = usual_test(emulator, system, seed)
    known = usual.states[:, :-1].reshape(-1, usual.states.shape[-1])
    tests = [usual]
    for number, place in enumerate(places[1:]):
        rng = np.random.default_rng([HELD_OUT_SEED, TEST_STREAM, seed, number])
        starts, controls = place.draw(rng, known, TEST_STRETCHES)
        runs = system.simulate(starts, controls, emulator.dt, threads=core_count())
        whole = ~runs.has_diverged
        if not whole.any():
            raise ArgumentError(
                f"{place.name}: the physics itself diverges in every test run there. Leave it out."
            )
        tests.append(replace(usual, states=runs.states[whole], controls=controls[whole]))
    return tuple(tests)


def usual_test(emulator: Emulator, system: System, seed: int, kind: int = 0) -> HeldOut:
    """Return a test of usual motions; `kind` draws others of the same seed."""
    seconds = RUN_STEPS * emulator.dt
    return held_out_runs(emulator, TEST_RUNS, seconds, seed=2 * seed + kind, scheme=system.truth)


def _identity(
    emulator: Emulator, places: tuple[Place, ...], data: Transitions, config: ImprovementConfig
) -> str:
    """Return what names all that the rounds follow from."""
    total = hashlib.sha256(digest(emulator_tensors(emulator)).encode())
    total.update(digest({"states": data.states, "controls": data.controls}).encode())
    total.update(config.hash.encode())
    for place in places:
        total.update(type(place).__name__.encode())
        if isinstance(place, Motion):
            rows = {f"states {i}": states for i, states in enumerate(place.states)}
            rows |= {f"controls {i}": controls for i, controls in enumerate(place.controls)}
            total.update(digest(rows).encode())
    return total.hexdigest()[:32]


def _claim(folder: Path, identity: str) -> None:
    """Mark `folder` as holding this improvement; refuse one that holds another."""
    path = folder / MANIFEST
    content = json.dumps({"identity": identity}).encode() + b"\n"
    if not path.exists():
        if any(folder.glob("*.safetensors")):
            raise BadFileError(
                f"{folder} holds a training. Choose another --out, or remove that folder."
            )
        write_whole(path, content)
    elif path.read_bytes() != content:
        raise BadFileError(
            f"{folder} holds the improvement of another emulator, or with other settings. Choose another --out, or "
            "remove that folder."
        )
