"""Which scheme shall teach: the cheapest that is good enough, and what its data will take."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from neuroanimator.cores import core_count
from neuroanimator.data.config import RUN_STEPS, USUAL_COUNT, USUAL_SAMPLES_PER_RUN
from neuroanimator.errors import ArgumentError
from neuroanimator.scaffold.defaults import MAX_TEACHER_ERROR
from neuroanimator.scaffold.trials import EVALUATIONS, Trial, step_cost
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.rigid.model_system import ModelSystem
from neuroanimator.systems.system import Scheme
from neuroanimator.terminal import phase, progress_bar

MIN_CHANGE = 1e-9
"""An entry that changes less than this in a super step does not count by more than its difference over this."""

MAX_DATA_SECONDS = 240.0
"""A teacher by which the usual data, warm-up apart, would take one core longer than this is passed over for a cheaper one."""

MAX_TRIAL_SECONDS = 2.0
"""Time [s], by `step_cost`, that the fine reference may take: it sets on how many transitions errors are measured."""

MIN_TRANSITIONS = 32
"""But on no fewer than this."""

MAX_TRANSITIONS = 320
"""Errors are measured on at most this many transitions."""

USUAL_RUNS = USUAL_COUNT / USUAL_SAMPLES_PER_RUN
"""Default number of runs simulated."""

MINUTES_FROM = 90.0
"""Times from this on are told in minutes [s]."""


class Teacher(NamedTuple):
    """The scheme that shall teach, and what it costs in accuracy and time."""

    scheme: Scheme
    """The first of those tried that is good enough, else the best of those that are not too dear."""
    error: float
    """Its one-step error, as a share of the standard deviation of a super step's change."""
    own_error: float
    """The same of the scheme the model asks for."""
    seconds: float
    """About how long one core takes for the usual data [s], with what runs are warmed up by."""
    fine: Scheme
    """The reference of the errors."""
    passed_over: Scheme | None = None
    """A better scheme that would take too long, if there is one."""


def recording_seconds(scheme: Scheme, dt: float, cost: float) -> float:
    """Return about how long one core takes for the recorded part of the usual data by `scheme` [s]."""
    return USUAL_RUNS * _evaluations(scheme, RUN_STEPS * dt) * cost


def warm_up_seconds(system: ModelSystem, cost: float) -> float:
    """Return about how long one core takes to warm up the runs of the usual data, by the model's own scheme [s]."""
    return USUAL_RUNS * _evaluations(system.scheme, system.warm_up) * cost


def _evaluations(scheme: Scheme, seconds: float) -> float:
    """Return how often `scheme` computes forces in so many seconds."""
    return seconds / scheme.dt * EVALUATIONS.get(scheme.integrator, 1)


def choose_teacher(system: ModelSystem, trial: Trial, contacts: float) -> Teacher:
    """Return the cheapest scheme that is good enough to teach, by what it makes of the transitions of `trial`.

    Raises ArgumentError if every scheme diverges.
    """
    cost = step_cost(system, contacts)
    fine_cost = system.fine.steps(trial.dt) * EVALUATIONS["rk4"] * cost
    count = int(np.clip(MAX_TRIAL_SECONDS / fine_cost, MIN_TRANSITIONS, MAX_TRANSITIONS))
    starts = trial.states[:, :-1].reshape(-1, system.state.size)
    controls = trial.controls.reshape(-1, 1, system.control.size)
    rows = np.linspace(0, len(starts) - 1, count).astype(int)
    starts = starts[rows]
    controls = controls[rows]
    fine = system.fine
    with phase("simulating finely"):
        exact = system.simulate_fastest(starts, controls, trial.dt, scheme=fine)
        if exact.has_diverged.any():
            # What is stiff and damped, explicit schemes blow up at any step.
            fine = Scheme("implicitfast", fine.dt)
            exact = system.simulate_fastest(starts, controls, trial.dt, scheme=fine)
    goal = exact.states[:, 1]
    frame = Frame.of(system.structure, trial.dt)
    unit = np.maximum(frame.difference(starts, goal).std(axis=0), MIN_CHANGE)

    def error_of(scheme: Scheme) -> float:
        runs = system.simulate_fastest(starts, controls, trial.dt, scheme=scheme)
        if runs.has_diverged.any():
            return float("inf")
        differences = frame.difference(goal, runs.states[:, 1]) / unit
        return float(np.sqrt(np.mean(differences**2)))

    schemes = _schemes_to_try(system)
    errors: dict[Scheme, float] = {}
    with progress_bar("physics steps tried", len(schemes)) as bar:
        for scheme in schemes:
            errors[scheme] = error_of(scheme)
            bar.advance_to(len(errors), f"{scheme.integrator} {scheme.dt * 1e3:.3g} ms")
    seconds = {scheme: recording_seconds(scheme, trial.dt, cost) for scheme in schemes}
    chosen = _cheapest_good(errors)
    passed_over = None
    if seconds[chosen] > MAX_DATA_SECONDS:
        passed_over = chosen
        chosen = _best_within(errors, seconds, system.scheme)
    if not np.isfinite(errors[chosen]):
        raise ArgumentError(
            "No scheme steps this model without diverging. Use a smaller timestep in the model."
        )
    if passed_over == chosen:
        passed_over = None
    return Teacher(
        scheme=chosen,
        error=errors[chosen],
        own_error=errors[system.scheme],
        seconds=seconds[chosen] + warm_up_seconds(system, cost),
        fine=fine,
        passed_over=passed_over,
    )


def _cheapest_good(errors: dict[Scheme, float]) -> Scheme:
    """Return the first scheme that is good enough, else the one with the smallest error."""
    for scheme, error in errors.items():
        if error <= MAX_TEACHER_ERROR:
            return scheme
    return min(errors, key=lambda scheme: errors[scheme])


def _best_within(errors: dict[Scheme, float], seconds: dict[Scheme, float], own: Scheme) -> Scheme:
    """Return the scheme with the smallest error among those not too dear, the model's own always counted in."""
    affordable = [
        scheme for scheme in errors if seconds[scheme] <= MAX_DATA_SECONDS or scheme == own
    ]
    return min(affordable, key=lambda scheme: errors[scheme])


def _schemes_to_try(system: ModelSystem) -> list[Scheme]:
    """Return the schemes that may teach, about the cheapest first; each once."""
    step = system.physics_dt
    own = system.scheme
    schemes = [
        own,
        Scheme("rk4", step),
        Scheme("rk4", _part(step, 2)),
        Scheme(own.integrator, _part(step, 2)),
        Scheme("rk4", _part(step, 5)),
        Scheme(own.integrator, _part(step, 5)),
    ]
    return list(dict.fromkeys(schemes))


def _part(step: float, parts: int) -> float:
    """Return a part of a step [s], without the last digits that division leaves."""
    return float(f"{step / parts:.12g}")


def in_words(seconds: float) -> str:
    """Return about how long this machine takes, with all its cores, for what takes one of them `seconds`."""
    here = seconds / core_count()
    if here < MINUTES_FROM:
        return f"{max(10, round(here, -1)):.0f} s"
    return f"{here / 60:.0f} min"
