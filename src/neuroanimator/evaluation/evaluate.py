"""Everything measured about one emulator, in one run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroanimator.data.transitions import Transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.evaluation.accuracy import (
    HELD_OUT_RUNS,
    TestSet,
    baselines,
    count_blow_ups,
    held_out_runs,
    one_step_error,
    rollout_error,
    root_mean_square,
)
from neuroanimator.evaluation.speed import Speed, measure_speed


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
    self_divergence: np.ndarray
    """(T+1,) the same for the physics at its own default step: the noise floor."""
    sample_emulated: np.ndarray
    """(T+1, S) one held-out run by the emulator."""
    sample_physics: np.ndarray
    """(T+1, S) the same run by fine physics."""
    speed: Speed
    baselines: dict[str, float]
    """One-step errors of cheap predictors; empty without a dataset."""
    blow_ups: int
    blow_up_starts: int

    @property
    def one_step_error(self) -> float:
        """Root mean square over all state entries."""
        return float(root_mean_square(self.error_by_entry))

    def rollout_error_at(self, seconds: float) -> float:
        """Return the rollout error after `seconds` [s], to the nearest super step."""
        return float(self.rollout_errors[min(round(seconds / self.dt), len(self.rollout_errors) - 1)])

    def row(self) -> dict[str, str | int | float]:
        """Return the figures by their published names."""
        return {
            "system": self.system,
            "substeps": self.substeps,
            "one_step_error": self.one_step_error,
            "rollout_error_1s": self.rollout_error_at(1.0),
            "nominal_speedup": self.speed.nominal,
            "equal_error_speedup": self.speed.equal_error,
            "equal_error_rival": f"{self.speed.rival.scheme.integrator} {self.speed.rival.scheme.dt * 1e3:.3g} ms",
            "emulator_us": self.speed.emulator_seconds * 1e6,
            "physics_us": self.speed.physics_seconds * 1e6,
            "blow_ups": self.blow_ups,
        }


def evaluate(
    emulator: Emulator,
    *,
    data: Transitions | None = None,
    starts: int = 1000,
    steps: int = 1000,
    runs: int = HELD_OUT_RUNS,
    seed: int = 0,
) -> Evaluation:
    """Return the evaluation of `emulator` on unseen runs; blow-ups among `starts` × `steps` super steps."""
    test = held_out_runs(emulator, count=runs, seed=seed)
    errors = one_step_error(emulator, test)
    found = np.asarray(emulator.rollout(test.states[:, 0], test.controls), float)
    return Evaluation(
        system=emulator.identity.system,
        substeps=emulator.identity.substeps,
        dt=emulator.dt,
        entries=emulator.identity.state.names,
        error_by_entry=errors,
        times=np.arange(found.shape[1]) * emulator.dt,
        rollout_errors=rollout_error(test.frame, found, test.states),
        self_divergence=self_divergence(test),
        sample_emulated=found[0],
        sample_physics=test.states[0],
        speed=measure_speed(emulator, test, float(root_mean_square(errors))),
        baselines=baselines(data, test) if data else {},
        blow_ups=count_blow_ups(emulator, starts, steps) if starts else 0,
        blow_up_starts=starts,
    )


def self_divergence(test: TestSet) -> np.ndarray:
    """Return (T+1,) how far the physics at its own step strays from fine physics."""
    system = test.system
    runs = system.simulate(test.states[:, 0], test.controls, test.dt, scheme=system.scheme)
    return rollout_error(test.frame, runs.states[runs.is_alive], test.states[runs.is_alive])
