"""Everything measured about one emulator, in one run."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from neuroanimator.data.store import Transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.evaluation.accuracy import (
    HELD_OUT_RUNS,
    MAX_TRANSITIONS,
    HeldOut,
    baselines,
    held_out_runs,
    make_test,
    one_step_error,
    recorded_runs,
    rollout_error,
    root_mean_square,
    system_of,
)
from neuroanimator.evaluation.speed import REPEATS, Speed, measure_emulator, measure_speed
from neuroanimator.evaluation.speed_function import PYTHON_FUNCTION
from neuroanimator.evaluation.speed_mass_spring import JAX, NO_COMPILER
from neuroanimator.evaluation.stability import count_blow_ups
from neuroanimator.evaluation.verdict import Verdict, judge
from neuroanimator.systems.recorded.recorded_system import RecordedSystem
from neuroanimator.terminal import phase
from neuroanimator.training.config import TrainingConfig
from neuroanimator.training.train import validation_mask

MAX_NAMED = 6
"""State entries named in a note."""

NO_OPPONENT = (
    "learnt from recordings, so there is no physics to compare its speed with: no speed-ups."
)


@dataclass(frozen=True)
class Effort:
    """How thoroughly to measure."""

    runs: int = HELD_OUT_RUNS
    """Unseen runs."""
    transitions: int = MAX_TRANSITIONS
    """Super steps on which one-step errors are measured, at most."""
    repeats: int = REPEATS
    """Timings of each side."""
    starts: int = 1000
    """Random starts that might blow up; 0 leaves that out."""
    steps: int = 2000
    """Super steps rolled out from each."""
    rounds: int = 5
    """Sets of unseen runs, in a table."""


THOROUGH = Effort()
QUICK = Effort(runs=8, transitions=320, repeats=3, starts=200, steps=300, rounds=1)


@dataclass(frozen=True)
class Evaluation:
    """What the table and the report show."""

    system: str
    substeps: int
    dt: float
    entries: list[str]
    """Names and units of the state entries."""
    error_by_entry: np.ndarray
    """(S,) one-step errors over the change's standard deviation."""
    times: np.ndarray
    """(T+1,) [s]"""
    rollout_errors: np.ndarray
    """(T+1,) rms error of the emulator, in standard deviations of the state."""
    self_divergence: np.ndarray | None
    """(T+1,) the same for the physics at its own default step: the noise floor; None without physics."""
    sample_emulated: np.ndarray
    """(T+1, S) one held-out run by the emulator."""
    sample_physics: np.ndarray
    """(T+1, S) the same run by fine physics."""
    measured_speed: Speed | None
    """None where there is no physics to measure: recordings."""
    emulator_seconds: float
    """Time of one super step [s]."""
    baselines: dict[str, float]
    """One-step errors of cheap predictors; ridge regression only with a dataset."""
    diverged: int
    diverged_starts: int
    still: list[str] = field(default_factory=list)
    """State entries that never move and are left out of all errors."""

    @property
    def verdict(self) -> Verdict:
        """Whether the emulator is of any use, and why."""
        return judge(
            self.one_step_error,
            self.baselines,
            diverged=self.diverged,
            rollouts=self.diverged_starts,
            error_after_second=self.rollout_error_at(1.0),
        )

    @property
    def equal_error_text(self) -> str:
        """The equal-error speed-up and its rival, or why there is none."""
        if self.measured_speed is None:
            return "none: there is no physics to compare with"
        if self.verdict.is_useless:
            return f"none: {self.verdict.reasons[0].partition(' (')[0]}"
        speed = self.measured_speed
        rival = speed.rival.scheme
        return (
            f"{speed.equal_error:.1f} ({speed.physics} {rival.integrator}, {rival.dt * 1e3:.3g} ms)"
        )

    @property
    def speed(self) -> Speed:
        """The speed-ups; ArgumentError where there is no physics to measure them against."""
        if self.measured_speed is None:
            raise ArgumentError(f"{self.system}: {NO_OPPONENT}")
        return self.measured_speed

    @property
    def note(self) -> str:
        """What must be said about the figures, if anything."""
        notes = [self._note_on_speed, self._note_on_errors]
        return " ".join(note for note in notes if note)

    @property
    def _note_on_errors(self) -> str:
        if not self.still:
            return ""
        shown = ", ".join(self.still[:MAX_NAMED])
        more = f" and {len(self.still) - MAX_NAMED} more" if len(self.still) > MAX_NAMED else ""
        return f"{self.system}: left out of all errors, for it never moves: {shown}{more}."

    @property
    def _note_on_speed(self) -> str:
        if self.measured_speed is None:
            return f"{self.system}: {NO_OPPONENT}"
        if self.measured_speed.physics == JAX:
            return f"{self.system}: {NO_COMPILER}"
        if self.measured_speed.physics == PYTHON_FUNCTION:
            return f"{self.system}: the physics is a {PYTHON_FUNCTION}, not compiled; so are its speed-ups."
        return ""

    @property
    def one_step_error(self) -> float:
        """Root mean square over all state entries."""
        return float(root_mean_square(self.error_by_entry))

    def rollout_error_at(self, seconds: float) -> float:
        """Return the rollout error after `seconds` [s], to the nearest super step."""
        return float(
            self.rollout_errors[min(round(seconds / self.dt), len(self.rollout_errors) - 1)]
        )

    def row(self) -> dict[str, str | int | float]:
        """Return the figures by their published names."""
        speed = self.measured_speed
        rivalled = None if self.verdict.is_useless else speed
        return {
            "system": self.system,
            "substeps": self.substeps,
            "one_step_error": self.one_step_error,
            "rollout_error_1s": self.rollout_error_at(1.0),
            "nominal_speedup": speed.nominal if speed else "none",
            "equal_error_speedup": rivalled.equal_error if rivalled else "none",
            "equal_error_rival": f"{rivalled.rival.scheme.integrator} {rivalled.rival.scheme.dt * 1e3:.3g} ms"
            if rivalled
            else "none",
            "emulator_us": self.emulator_seconds * 1e6,
            "emulator_jax_us": speed.jax_seconds * 1e6 if speed and speed.jax_seconds else "none",
            "physics_us": speed.physics_seconds * 1e6 if speed else "none",
            "diverged": self.diverged,
            "verdict": self.verdict.word,
        }


def evaluate(
    emulator: Emulator,
    *,
    data: Transitions | None = None,
    effort: Effort | None = None,
    seed: int = 0,
) -> Evaluation:
    """Return the evaluation of `emulator` on unseen runs, drawn from `seed`.

    The test of an emulator of recordings is what `data` kept apart; there are no speed-ups then.
    """
    effort = effort or THOROUGH
    is_recorded = isinstance(system_of(emulator), RecordedSystem)
    with phase("simulating finely"):
        test = (
            recorded_runs(emulator, data)
            if is_recorded
            else held_out_runs(emulator, count=effort.runs, seed=seed)
        )
    test = replace(test, most_transitions=effort.transitions)
    among = test.transitions[0] if is_recorded else None
    with phase("emulating"):
        errors = one_step_error(emulator, test)
        found = np.asarray(
            emulator.rollout(test.states[:, 0], test.controls, may_diverge=True), float
        )
    with phase("timing"):
        speed = (
            None
            if is_recorded
            else measure_speed(emulator, test, float(root_mean_square(errors)), effort.repeats)
        )
    with phase("looking for blow-ups"):
        diverged = (
            count_blow_ups(emulator, effort.starts, effort.steps, among=among)
            if effort.starts
            else 0
        )
    return Evaluation(
        system=emulator.system,
        substeps=emulator.substeps,
        dt=emulator.dt,
        entries=emulator.state.names,
        error_by_entry=errors,
        times=np.arange(found.shape[1]) * emulator.dt,
        rollout_errors=rollout_error(test.frame, found, test.states),
        self_divergence=None if is_recorded else self_divergence(test),
        sample_emulated=found[0],
        sample_physics=test.states[0],
        measured_speed=speed,
        emulator_seconds=speed.emulator_seconds if speed else measure_emulator(emulator),
        baselines=baselines(data, test),
        diverged=diverged,
        diverged_starts=effort.starts,
        still=test.still,
    )


def judge_training(emulator: Emulator, data: Transitions, config: TrainingConfig) -> Verdict:
    """Return the verdict on the windows of `data` that training with `config` kept for validation: one step each."""
    kept = data.where(validation_mask(data.run, config))
    states = np.asarray(kept.states[:, :2], float)
    controls = np.asarray(kept.controls[:, :1], float)
    test = make_test(data.system, emulator.dt, states, controls)
    if emulator.encoding.is_identity:  # the same unit as in the error that training reports
        test = replace(test, change_scale=np.asarray(emulator.normaliser.unit, float))
    return judge(float(root_mean_square(one_step_error(emulator, test))), baselines(None, test))


def self_divergence(test: HeldOut) -> np.ndarray:
    """Return (T+1,) how far the physics at its own step strays from fine physics."""
    system = test.system
    runs = system.simulate(test.states[:, 0], test.controls, test.dt, scheme=system.scheme)
    return rollout_error(test.frame, runs.states[runs.is_alive], test.states[runs.is_alive])
