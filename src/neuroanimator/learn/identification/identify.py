"""Identification: the parameters of a body from recordings of its motion."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from neuroanimator.emulator.emulator import Emulator, as_emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.evaluation.held_out import replayable_system
from neuroanimator.learn.identification.findings import Findings, findings_of
from neuroanimator.learn.identification.fit import Fit, Fitter, Fitting, Guess, Predict
from neuroanimator.learn.identification.least_squares import covariance, normal_equations
from neuroanimator.learn.identification.measurements import (
    SHORTEST,
    Measurements,
    read_measurements,
)
from neuroanimator.learn.identification.predictions import Predictor
from neuroanimator.learn.identification.unknowns import Unknowns, unknowns_of
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase

SURE = 5.0
"""Number of standard deviations from which an unrequested delay or offset is reported."""

NOTEWORTHY = 0.5
"""Minimum unrequested offset that is reported, as a share of the noise."""

FIRST_STEPS = 3
"""Maximum number of steps on the physics by the emulator's slopes: the first ones do nearly all that they can."""

LATE = 0.1
"""Minimum unrequested delay that is reported, as a share of a super step."""


@dataclass(frozen=True)
class Estimate:
    """One identified number."""

    name: str
    unit: str
    value: float
    deviation: float
    """Standard deviation."""
    nominal: float
    low: float
    high: float
    is_known: bool
    """Whether the recording determines it better than its range."""
    is_parameter: bool
    """Whether it belongs to the body; a delay and offsets belong to its sensors."""


@dataclass(frozen=True)
class Identification:
    """Parameters of a body, and how well they explain its recordings."""

    estimates: tuple[Estimate, ...]
    """Parameters, the delay and offsets of sensors."""
    confused: tuple[tuple[str, ...], ...]
    """Names of parameters that the recordings cannot tell apart: only a combination is known."""
    notes: tuple[str, ...]
    """Remarks on the result for the user, a line each."""
    measurements: Measurements
    nominal: Fit
    """Residuals at nominal values, on the physics if available."""
    emulated: Fit
    """The fit by the emulator alone."""
    proven: Fit | None
    """The fit on the physics; None for a system that cannot be simulated."""
    seconds_of_emulator: float
    """Wall time of the fit by the emulator [s]."""
    seconds_of_physics: float
    """Wall time of the fit on the physics [s]."""

    @property
    def final(self) -> Fit:
        """The fit on the physics, or the emulator's if there is none."""
        return self.proven or self.emulated

    @property
    def parameters(self) -> dict[str, float]:
        """Value of each parameter, for `Emulator.at` and `System.at`."""
        return {
            estimate.name: estimate.value for estimate in self.estimates if estimate.is_parameter
        }


def identify(
    emulator: Emulator | str | Path,
    recordings: str | Path | Sequence[str | Path],
    *,
    delay: bool = False,
    offsets: bool = False,
    window: float | None = None,
    physics: bool = True,
    resample: bool = False,
) -> Identification:
    """Return the parameters of the body in `recordings` (CSV or NPZ files), of the family that `emulator` was trained on.

    The state at the start of every window of `window` seconds is found as well, so that noise in it does no harm and
    velocities need not be measured. `delay` also finds the sensors' common delay, `offsets` the offset of
    each sensor. With `resample`, samples at uneven times are interpolated. By default the result is corrected and
    verified on the `physics`, if available.

    Raises ArgumentError for an emulator without parameters, BadFileError for recordings that do not fit it.
    """
    emulator = as_emulator(emulator)
    if not emulator.parameters:
        raise ArgumentError(
            f"{emulator.system}: its emulator is of one body and has no parameters. Write a table [parameters] into its TOML "
            "file and train again: see docs/tutorials/families.md."
        )
    paths = [recordings] if isinstance(recordings, str | Path) else list(recordings)
    measurements = read_measurements(paths, emulator, window, resample=resample)
    unknowns = unknowns_of(emulator, measurements, delay=delay, offsets=offsets)
    fitters = _stages(emulator, measurements, unknowns)
    begun = time.perf_counter()
    with phase("fitting the emulator"):
        stages = _by_emulator(fitters)
    last = stages[-1]
    emulated = last.fit
    seconds_of_emulator = time.perf_counter() - begun
    begun = time.perf_counter()
    fitter = fitters[-1]
    nominal = _at_nominal(fitter, emulated, fitter.predictor.by_emulator)
    proven = None
    system = replayable_system(emulator) if physics else None
    if system is not None and system.can_simulate:
        with phase("verifying it on the physics"):
            motions = partial(fitter.predictor.by_physics, system)
            nominal = _at_nominal(fitter, emulated, motions)
            first = stages[0].fit
            guess = Guess(emulated.values, first.starts, first.noise)
            last = _on_physics(fitters, guess, system)
            proven = last.fit
    seconds_of_physics = time.perf_counter() - begun
    final = last.fit
    known = covariance(fitter.normal(final, last.slopes), unknowns)
    findings = findings_of(known, final.values, unknowns)
    return Identification(
        estimates=_estimates(final, findings, unknowns),
        confused=findings.confused,
        notes=(
            *_unproven(system),
            *_notes(findings, unknowns),
            *_unasked(fitter, final, emulator),
        ),
        measurements=measurements,
        nominal=nominal,
        emulated=emulated,
        proven=proven,
        seconds_of_emulator=seconds_of_emulator,
        seconds_of_physics=seconds_of_physics,
    )


def _stages(emulator: Emulator, measurements: Measurements, unknowns: Unknowns) -> list[Fitter]:
    """Return fitters of the same motions, from short windows to the whole ones, doubling the length each time.

    Short windows lead from far away into the basin where long ones have a single minimum.
    """
    parts = 1
    while measurements.steps % (2 * parts) == 0 and measurements.steps // (2 * parts) >= SHORTEST:
        parts *= 2
    fitters = []
    while parts >= 1:
        windows = measurements.split(parts)
        fitters.append(Fitter(windows, Predictor(emulator, windows, unknowns), unknowns))
        parts //= 2
    return fitters


def _by_emulator(fitters: list[Fitter]) -> list[Fitting]:
    """Return the emulator's fit of each stage."""
    fits: list[Fitting] = []
    for fitter in fitters:
        guess = fitter.taken_up(fits[-1].fit) if fits else fitter.first_guess()
        fits.append(fitter.fitted(guess, fitter.predictor.by_emulator))
    return fits


def _at_nominal(fitter: Fitter, emulated: Fit, predict: Predict) -> Fit:
    """Return the residuals of `predict`'s motions with nominal parameters and the identified starts."""
    guess = Guess(fitter.unknowns.nominal, emulated.starts, emulated.noise)
    return fitter.seen(guess, predict(guess.starts, guess.values))


def _on_physics(fitters: list[Fitter], guess: Guess, system: System) -> Fitting:
    """Return the fit of true motions, starting from the `guess` for the shortest windows.

    A few steps there use the emulator's slopes, which are good over short windows; longer ones follow differences of the
    physics itself, so that the emulator's remaining errors affect neither the result nor its standard deviations.
    """
    shortest = fitters[0]
    motions = partial(shortest.predictor.by_physics, system)
    first = shortest.fitted(guess, motions, max_iterations=FIRST_STEPS)
    last = fitters[-1]
    return last.fitted(
        last.taken_up(first.fit),
        partial(last.predictor.by_physics, system),
        partial(last.predictor.slopes_by_physics, system),
    )


def _estimates(fit: Fit, findings: Findings, unknowns: Unknowns) -> tuple[Estimate, ...]:
    estimates = []
    for place, unknown in enumerate(unknowns.each):
        estimate = Estimate(
            **vars(unknown),
            value=float(fit.values[place]),
            deviation=float(findings.deviations[place]),
            is_known=findings.is_known[place],
            is_parameter=place < unknowns.parameters,
        )
        estimates.append(estimate)
    return tuple(estimates)


def _unproven(system: System | None) -> list[str]:
    """Return why nothing was proved, if the physics is missing."""
    if system is None or not system.missing:
        return []
    return [f"not verified: {system.missing} Parameters are as good as the emulator."]


def _notes(findings: Findings, unknowns: Unknowns) -> list[str]:
    """Return notes on what the recordings leave open, a line each."""
    notes = []
    for name in findings.not_shown:
        notes.append(
            f"{name}: the recordings do not determine it; its value is little more than the nominal one. Record motions that "
            "depend on it."
        )
    for names in findings.confused:
        notes.append(
            f"{', '.join(names)}: cannot be told apart; only a combination of them is known. Fix one, by a narrow range "
            "around a measured value, or record other motions."
        )
    for name in findings.at_end:
        ended = unknowns.each[unknowns.names.index(name)]
        notes.append(
            f"{name}: its best value lies at the end of its range, {ended.low:.4g} to {ended.high:.4g} {ended.unit}. Widen "
            "that, and train again."
        )
    return notes


def _unasked(fitter: Fitter, fit: Fit, emulator: Emulator) -> list[str]:
    """Return notes on an unrequested delay or offsets that the residuals show, by one more step with these unknown."""
    asked = fitter.unknowns
    if asked.has_delay and asked.offsets:
        return []
    measurements = fitter.measurements
    unknowns = unknowns_of(emulator, measurements, delay=True, offsets=True)
    delay = unknowns.parameters
    known = list(range(delay))
    if asked.has_delay:
        known.append(delay)
    if asked.offsets:
        known += range(delay + 1, len(unknowns.each))
    values = unknowns.nominal.copy()
    values[known] = fit.values
    wider = Predictor(emulator, measurements, unknowns)
    slopes = wider.slopes(fit.starts, values)
    normal = normal_equations(fit.residuals, fit.noise, slopes, values, unknowns)
    change = np.linalg.solve(normal.matrix, normal.right)
    deviations = np.sqrt(np.maximum(np.diag(covariance(normal, unknowns)), 0.0))
    is_sure = np.abs(change) >= SURE * deviations
    notes = []
    if delay not in known and is_sure[delay] and change[delay] > LATE * emulator.dt:
        notes.append(
            f"the measurements seem to be {change[delay] * 1e3:.2g} ms late: --delay finds the delay, too."
        )
    for place, entry in enumerate(unknowns.offsets, delay + 1):
        is_large = abs(change[place]) > NOTEWORTHY * fit.noise[entry]
        if place not in known and is_sure[place] and is_large:
            offset = unknowns.each[place]
            name = offset.name.removeprefix("offset of ")
            notes.append(
                f"{name} seems to be off by {change[place]:.3g} {offset.unit} throughout: --offsets finds the "
                "offset, too."
            )
    return notes
