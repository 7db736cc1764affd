"""Everything measured about one emulator, in one run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.departures import Departure, departures_in_words, find_departures
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.verdict import (
    NOISE_TOLD,
    Verdict,
    WindowErrors,
    beyond_noise,
    judge,
)
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.store import Dataset
from neuroanimator.learn.evaluation.accuracy import (
    emulate,
    error_after,
    noise_error,
    one_step_error,
    rollout_error,
    root_mean_square,
    self_divergence,
)
from neuroanimator.learn.evaluation.baselines import baselines
from neuroanimator.learn.evaluation.bounded_errors import BoundedErrors, bounded_errors
from neuroanimator.learn.evaluation.held_out import (
    HELD_OUT_RUNS,
    MAX_TRANSITIONS,
    held_out_runs,
    recorded_runs,
    system_of,
)
from neuroanimator.learn.evaluation.hybrid_shares import HybridGain, hybrid_shares
from neuroanimator.learn.evaluation.speed import REPEATS, Speed, measure_emulator, measure_speed
from neuroanimator.learn.evaluation.speed_function import PYTHON_FUNCTION
from neuroanimator.learn.evaluation.speed_mass_spring import JAX, NO_COMPILER
from neuroanimator.learn.evaluation.stability import count_diverged
from neuroanimator.learn.evaluation.weakness.conditions import WeakSpot
from neuroanimator.learn.evaluation.weakness.inspection import INSPECTED_RUNS, Inspection, inspect
from neuroanimator.terminal import phase
from neuroanimator.text import listed

INSPECTED_PER_RUN = INSPECTED_RUNS // HELD_OUT_RUNS
"""Number of inspected runs per finely simulated run."""

NO_OPPONENT = (
    "Learnt from recordings, so there is no physics to compare its speed with: no speed-ups."
)
"""Sentence on the speed of an emulator of recordings."""

NONE = "none"
"""Value in a row of a figure that does not exist."""


@dataclass(frozen=True)
class EvaluationBudget:
    """How thoroughly to measure."""

    runs: int = HELD_OUT_RUNS
    """Number of unseen runs."""
    seconds: float | None = None
    """Length of the unseen runs [s]; the usual one if not given."""
    transitions: int = MAX_TRANSITIONS
    """Maximum number of super steps on which one-step errors are measured."""
    repeats: int = REPEATS
    """Number of timings of each side."""
    starts: int = 1000
    """Number of random starts checked for divergence; 0 leaves that out."""
    steps: int = 2000
    """Number of super steps rolled out from each."""
    rounds: int = 5
    """Number of sets of unseen runs, in a table."""
    hybrid_runs: int = 0
    """Number of unseen runs in which emulator and physics take turns; 0 leaves that out."""

    @property
    def inspected(self) -> int:
        """Number of unseen runs inspected for weak conditions: more, as they are far cheaper."""
        return INSPECTED_PER_RUN * self.runs


THOROUGH = EvaluationBudget(hybrid_runs=16)
"""Budget of a minute for each emulator."""

SOFT_BODY = EvaluationBudget(
    runs=16, seconds=2.0, transitions=160, repeats=3, starts=100, steps=150
)
"""The same for a soft body, whose physics takes milliseconds a super step: `THOROUGH` would take many minutes."""

QUICK = EvaluationBudget(runs=8, transitions=320, repeats=3, starts=200, steps=300, rounds=1)
"""Budget of seconds for each emulator."""


@dataclass(frozen=True)
class Evaluation:
    """The errors and the speed of one emulator, and sentences on them."""

    system: str
    substeps: int
    dt: float
    entries: list[str]
    """Names and units of the state entries."""
    error_by_entry: Float[np.ndarray, " M"]
    """One-step errors of what moves, over the change's standard deviation."""
    times: Float[np.ndarray, " T"]
    """Time since a test run's start, super step by super step [s]."""
    rollout_errors: Float[np.ndarray, " T"]
    """Rms error of the emulator at these times, in standard deviations of the state."""
    self_divergence: Float[np.ndarray, " T"] | None
    """The same for the physics at its own default step: the noise floor; None without physics."""
    sample_emulated: Float[np.ndarray, "T S"]
    """One held-out run by the emulator."""
    sample_physics: Float[np.ndarray, "T S"]
    """The same run by fine physics."""
    measured_speed: Speed | None
    """The speed-ups; None where there is no physics to measure: recordings."""
    emulator_seconds: float
    """Time of one super step [s]."""
    baselines: dict[str, float]
    """One-step errors of cheap predictors; ridge regression only with a dataset."""
    diverged: int
    """Number of random starts whose long rollouts diverged."""
    diverged_starts: int
    """Number of random starts tried."""
    still: list[str] = field(default_factory=list)
    """State entries whose change never varies, and which are left out of all errors."""
    noise: Float[np.ndarray, " S"] | None = None
    """Standard deviation of the noise in each state entry of recordings; None where unknown."""
    noise_by_entry: Float[np.ndarray, " M"] | None = None
    """One-step errors that this noise alone makes, in the units of `error_by_entry`."""
    inspection: Inspection | None = None
    """Where it is good and where it is weak; None if that was not measured."""
    bounded: BoundedErrors | None = None
    """Whether bounds of errors hold; None where there are none."""
    window: WindowErrors | None = None
    """Errors of a soft body in the windows of training's validation; None for other systems."""
    departures: tuple[Departure, ...] = ()
    """What leaves training while controls are held at their bounds, or at rest, worst first."""
    hybrid: Mapping[float, HybridGain] = field(default_factory=dict)
    """Gain of turns with the physics, by the score from which it takes over; empty if not measured."""

    @property
    def weak_spots(self) -> tuple[WeakSpot, ...]:
        """Conditions under which the error is several times that elsewhere, worst first."""
        return self.inspection.weak_spots if self.inspection else ()

    @property
    def verdict(self) -> Verdict:
        """Whether the emulator is useful, and why."""
        verdict = judge(
            self.one_step_error,
            self.baselines,
            diverged=self.diverged,
            rollouts=self.diverged_starts,
            error_after_second=self.rollout_error_at(1.0),
            noise=self.noise_error or 0.0,
        )
        if self.window is not None:
            verdict = self.window.judged(verdict)
        if self.departures:
            verdict = verdict.with_flaw(str(self.departures[0]))
        if self.inspection is None:
            return verdict
        return verdict.because(self.inspection.causes)

    @property
    def is_unmatched(self) -> bool:
        """Whether no physics tried is as accurate from what the state holds: for a soft body, its shapes alone."""
        speed = self.measured_speed
        return speed is not None and speed.equal_error_opponent.error > self.one_step_error

    @property
    def equal_error_text(self) -> str:
        """The equal-error speed-up and its opponent, or why there is none."""
        if self.measured_speed is None:
            return "none: there is no physics to compare with"
        if self.verdict.is_useless:
            reason, _, _ = self.verdict.reasons[0].partition(" (")
            return f"none: {reason}"
        if self.is_unmatched:
            return "none: no physics that was tried is as accurate, given only the state"
        speed = self.measured_speed
        scheme = speed.equal_error_opponent.scheme
        return (
            f"{speed.equal_error:.1f}, against {speed.physics} {scheme.integrator} at {scheme.dt * 1e3:.3g} ms, the fastest "
            "physics that is at least as accurate"
        )

    @property
    def speed(self) -> Speed:
        """The speed-ups; ArgumentError where there is no physics to measure them against."""
        if self.measured_speed is None:
            raise ArgumentError(f"{self.system}: {NO_OPPONENT}")
        return self.measured_speed

    @property
    def title(self) -> str:
        """System and super step, as headings name the emulator."""
        return f"{self.system}, n = {self.substeps}"

    @property
    def note(self) -> str:
        """Sentences on speed, divergence, noise and what is left out: the same on the terminal, in reports and in cards."""
        sentences = [*self._on_speed(), *self._on_noise()]
        if self.departures:
            sentences.append(f"{departures_in_words(self.departures).capitalize()}.")
        if self.still:
            sentences.append(
                f"Left out of all errors, since its change never varies: {listed(self.still)}."
            )
        return " ".join(sentences)

    def _on_speed(self) -> list[str]:
        cost = f"One super step costs {self.emulator_seconds * 1e6:.2f} µs"
        diverged = f"Diverged: {self.diverged} of {self.diverged_starts}"
        speed = self.measured_speed
        if speed is None:
            return [f"{cost}.", NO_OPPONENT, f"{diverged} recorded starts."]
        sentences = [
            f"{cost} in {speed.runtime}.",
            f"The physics' own {self.substeps} steps take {speed.nominal:.0f} times as long.",
            f"Speed-up at equal error: {self.equal_error_text}.",
            f"{diverged} random starts.",
        ]
        if speed.physics == JAX:
            sentences.append(NO_COMPILER)
        if speed.physics == PYTHON_FUNCTION:
            sentences.append(
                f"The physics is a {PYTHON_FUNCTION}, not compiled; so are its speed-ups."
            )
        if self.is_own_reference:
            sentences.append(
                "Errors are measured against the physics at its own step, which is the truth."
            )
        return sentences

    def _on_noise(self) -> list[str]:
        noise = self.noise_error
        if noise is None or self.noise is None:
            return []
        if noise < NOISE_TOLD * self.one_step_error:
            return ["Hardly any of the one-step error is noise of the recordings."]
        deviations = []
        for name, deviation in zip(self.entries, self.noise, strict=True):
            entry, _, unit = name.rpartition(" ")
            deviations.append(f"{entry} {deviation:.2g} {unit}")
        left = beyond_noise(self.one_step_error, noise)
        return [
            f"The recordings' own noise ({listed(deviations)}) makes a one-step error of {noise:.2g} by itself; no more "
            f"than {left:.2g} of {self.one_step_error:.2g} is left to gain, in root mean squares."
        ]

    @property
    def is_own_reference(self) -> bool:
        """Whether all errors are measured against the physics at its own step, which then has none itself."""
        return self.self_divergence is not None and not self.self_divergence.any()

    @property
    def one_step_error(self) -> float:
        """Root mean square over all state entries."""
        return float(root_mean_square(self.error_by_entry))

    @property
    def noise_error(self) -> float | None:
        """The one-step error of a perfect emulator, due to the recordings' noise; None where unknown."""
        if self.noise_by_entry is None:
            return None
        return float(root_mean_square(self.noise_by_entry))

    def rollout_error_at(self, seconds: float) -> float:
        """Return the rollout error after `seconds` [s], at the nearest super step but the first."""
        return error_after(self.rollout_errors, self.dt, seconds)

    def row(self) -> dict[str, str | int | float]:
        """Return the figures by their published names."""
        row: dict[str, str | int | float] = {
            "system": self.system,
            "substeps": self.substeps,
            "one_step_error": self.one_step_error,
            "noise_error": NONE if self.noise_error is None else self.noise_error,
            "rollout_error_1s": self.rollout_error_at(1.0),
            "nominal_speedup": NONE,
            "equal_error_speedup": NONE,
            "equal_error_baseline": NONE,
            "emulator_us": self.emulator_seconds * 1e6,
            "emulator_jax_us": NONE,
            "physics_us": NONE,
            "diverged": self.diverged,
            "verdict": self.verdict.word,
        }
        speed = self.measured_speed
        if speed is None:
            return row
        row["nominal_speedup"] = speed.nominal
        row["physics_us"] = speed.physics_seconds * 1e6
        if speed.jax_seconds:
            row["emulator_jax_us"] = speed.jax_seconds * 1e6
        if not self.verdict.is_useless and not self.is_unmatched:
            scheme = speed.equal_error_opponent.scheme
            row["equal_error_speedup"] = speed.equal_error
            row["equal_error_baseline"] = f"{scheme.integrator} {scheme.dt * 1e3:.3g} ms"
        return row


def evaluate(
    emulator: Emulator,
    *,
    data: Dataset | None = None,
    budget: EvaluationBudget | None = None,
    seed: int = 0,
) -> Evaluation:
    """Return the evaluation of `emulator` on unseen runs, drawn from `seed`.

    An emulator of recordings is tested on the runs that `data` kept apart; there are no speed-ups then.
    """
    if budget is None:
        is_soft = emulator.spec.skeleton.shapes is not None
        budget = SOFT_BODY if is_soft else THOROUGH
    is_recorded = system_of(emulator).recordings is not None
    with phase("simulating finely"):
        if is_recorded:
            test = recorded_runs(emulator, data)
        else:
            test = held_out_runs(emulator, budget.runs, budget.seconds, seed)
    test = replace(test, most_transitions=budget.transitions)
    with phase("emulating"):
        errors = one_step_error(emulator, test)
        emulated = emulate(emulator, test.states[:, 0], test.controls)
    with phase("timing"):
        if is_recorded:
            speed = None
            emulator_seconds = measure_emulator(emulator, budget.repeats)
        else:
            error = float(root_mean_square(errors))
            speed = measure_speed(emulator, test, error, budget.repeats)
            emulator_seconds = speed.emulator_seconds
    with phase("looking for rollouts that diverge"):
        diverged = 0
        if budget.starts:
            among = test.transitions.states if is_recorded else None
            diverged = count_diverged(emulator, budget.starts, budget.steps, among=among)
    with phase("holding the controls"):
        departures = tuple(find_departures(emulator, budget.steps))
    hybrid: dict[float, HybridGain] = {}
    if budget.hybrid_runs and not is_recorded:
        with phase("taking turns with the physics"):
            hybrid = hybrid_shares(emulator, test, budget.hybrid_runs)
    return Evaluation(
        system=emulator.system,
        substeps=emulator.substeps,
        dt=emulator.dt,
        entries=emulator.state.names,
        error_by_entry=errors,
        times=np.arange(emulated.shape[1]) * emulator.dt,
        rollout_errors=rollout_error(test.frame, emulated, test.states),
        self_divergence=None if is_recorded else self_divergence(test),
        sample_emulated=emulated[0],
        sample_physics=test.states[0],
        measured_speed=speed,
        emulator_seconds=emulator_seconds,
        baselines=baselines(data, test),
        diverged=diverged,
        diverged_starts=budget.starts,
        still=test.still,
        noise=test.noise,
        noise_by_entry=noise_error(emulator, test),
        inspection=inspect(emulator, data=data, runs=budget.inspected, seed=seed),
        bounded=bounded_errors(emulator, test, emulated),
        window=None if emulator.validation is None else emulator.validation.window,
        departures=departures,
        hybrid=hybrid,
    )
