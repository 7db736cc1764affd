"""Choice of the teaching scheme, the cheapest that is accurate enough, and the time its data will take."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from neuroanimator.codegen.cores import core_count
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.config import RUN_STEPS, USUAL_COUNT, USUAL_SAMPLES_PER_RUN
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.scaffold.defaults import MAX_TEACHER_ERROR, MIN_CHANGE, rounded
from neuroanimator.scaffold.trials import EVALUATIONS, STIFF_INTEGRATORS, ModelTrial, step_cost
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.system import Scheme
from neuroanimator.terminal import phase, progress_bar

MAX_DATA_SECONDS = 240.0
"""Maximum time of the usual data on one core, without warm-up [s]; slower teachers are passed over."""

MAX_TRIAL_SECONDS = 2.0
"""Maximum time of the fine reference by `step_cost` [s], which sets the number of transitions in measured errors."""

TRANSITIONS = (32, 320)
"""Minimum and maximum number of transitions on which errors are measured."""

USUAL_RUNS = USUAL_COUNT / USUAL_SAMPLES_PER_RUN
"""Default number of simulated runs."""

MINUTES_FROM = 90.0
"""Time above which times are given in minutes [s]."""

HOURS_FROM = 7200.0
"""Time above which times are given in hours [s]."""

MAX_HERE = 3600.0
"""Time of data on this machine above which `new` proposes fewer [s]."""

FEWEST = 1 / 16
"""Minimum share of the usual data that is proposed."""

PARTS = (2, 5)
"""Numbers of parts into which the model's step is divided for schemes that may teach."""


class Teacher(NamedTuple):
    """The chosen teaching scheme, its error and its time."""

    scheme: Scheme
    """The first scheme tried that is accurate enough, else the best of those that are not too slow."""
    error: float
    """Its one-step error, as a share of the standard deviation of a super step's change."""
    own_error: float
    """The same of the model's own scheme."""
    seconds: float
    """Approximate time of the usual data on one core [s], including warm-up."""
    fine: Scheme
    """The reference of the errors."""
    passed_over: Scheme | None
    """A better scheme that would take too long, if there is one."""


def seconds_of_runs(scheme: Scheme, duration: float, cost: float) -> float:
    """Return the approximate time [s] of one core for `duration` [s] of all runs of the usual data by `scheme`.

    `cost` is that of computing all forces once [s].
    """
    return USUAL_RUNS * duration / scheme.dt * EVALUATIONS.get(scheme.integrator, 1) * cost


def choose_teacher(system: ModelSystem, trial: ModelTrial) -> Teacher:
    """Return the cheapest scheme accurate enough to teach, by its errors on the transitions of `trial`.

    Raises ArgumentError if every scheme diverges.
    """
    cost = step_cost(system, _usual_contacts(system, trial))
    errors, fine = _measured_errors(system, trial, cost)
    seconds = {scheme: seconds_of_runs(scheme, RUN_STEPS * trial.dt, cost) for scheme in errors}
    own = system.scheme
    good = [scheme for scheme, error in errors.items() if error <= MAX_TEACHER_ERROR]
    wanted = good[0] if good else min(errors, key=errors.__getitem__)
    chosen = wanted
    if seconds[wanted] > MAX_DATA_SECONDS:
        affordable = [scheme for scheme in errors if seconds[scheme] <= MAX_DATA_SECONDS]
        chosen = min([own, *affordable], key=errors.__getitem__)
    if not np.isfinite(errors[chosen]):
        raise ArgumentError(
            "No scheme steps this model without diverging. Use a smaller timestep in the model."
        )
    return Teacher(
        scheme=chosen,
        error=errors[chosen],
        own_error=errors[own],
        seconds=seconds[chosen] + seconds_of_runs(own, system.warm_up, cost),
        fine=fine,
        passed_over=None if wanted == chosen else wanted,
    )


def _measured_errors(
    system: ModelSystem, trial: ModelTrial, cost: float
) -> tuple[dict[Scheme, float], Scheme]:
    """Return the one-step error of each scheme that may teach, roughly the cheapest first, and their reference."""
    fine = system.fine
    fine_cost = fine.steps(trial.dt) * EVALUATIONS["rk4"] * cost
    count = int(np.clip(MAX_TRIAL_SECONDS / fine_cost, *TRANSITIONS))
    starts = trial.states[:, :-1].reshape(-1, system.state.size)
    rows = np.linspace(0, len(starts) - 1, count).astype(int)
    starts = starts[rows]
    controls = trial.controls.reshape(-1, 1, system.control.size)[rows]
    with phase("simulating finely"):
        exact = system.simulate_fastest(starts, controls, trial.dt, scheme=fine)
        for integrator in STIFF_INTEGRATORS:
            # Explicit schemes blow up on stiff, damped models at any step.
            if exact.has_diverged.any() and integrator in system.integrators:
                fine = Scheme(integrator, fine.dt)
                exact = system.simulate_fastest(starts, controls, trial.dt, scheme=fine)
    goal = exact.states[:, 1]
    frame = Frame.of(system.structure, trial.dt)
    unit = np.maximum(frame.difference(starts, goal).std(axis=0), MIN_CHANGE)
    schemes = _schemes_to_try(system)
    errors: dict[Scheme, float] = {}
    with progress_bar("physics steps tried", len(schemes)) as bar:
        for scheme in schemes:
            runs = system.simulate_fastest(starts, controls, trial.dt, scheme=scheme)
            errors[scheme] = float("inf")
            if not runs.has_diverged.any():
                differences = frame.difference(goal, runs.states[:, 1]) / unit
                errors[scheme] = float(np.sqrt(np.mean(differences**2)))
            bar.advance_to(len(errors), f"{scheme.integrator} {scheme.dt * 1e3:.3g} ms")
    return errors, fine


def _usual_contacts(system: ModelSystem, trial: ModelTrial) -> float:
    """Return the mean number of contacts in trial runs."""
    every = max(1, trial.states.shape[1] // 4)
    states = trial.states[:, ::every].reshape(-1, system.state.size)
    return float(np.mean(system.contact_counts(states)))


def _schemes_to_try(system: ModelSystem) -> list[Scheme]:
    """Return the schemes that may teach, roughly the cheapest first, without duplicates."""
    own = system.scheme.integrator
    schemes = [system.scheme, Scheme("rk4", system.physics_dt)]
    for parts in PARTS:
        step = rounded(system.physics_dt / parts, 12)
        schemes += [Scheme("rk4", step), Scheme(own, step)]
    return list(dict.fromkeys(schemes))


def affordable_count(usual: int, seconds: float) -> int:
    """Return the number of transitions that take this machine an hour, if all `usual` ones take a core `seconds`.

    At most all of them, and at least `FEWEST`, in two digits.
    """
    share = MAX_HERE * core_count() / max(seconds, MAX_HERE)
    if share >= 1:
        return usual
    return int(rounded(usual * max(share, FEWEST), 2))


def data_row(usual: int, seconds: float) -> tuple[str, str]:
    """Return the row for the screen about the time of all `usual` transitions, and of those that are proposed."""
    count = affordable_count(usual, seconds)
    told = f"{usual:,} transitions take about {in_words(seconds)}"
    if count < usual:
        told += f", {count:,} about {in_words(seconds * count / usual)}"
    return "data", told


def in_words(seconds: float) -> str:
    """Return the approximate time on all cores of this machine, in words, of what takes one core `seconds`."""
    here = seconds / core_count()
    if here < MINUTES_FROM:
        return f"{max(10, round(here, -1)):.0f} s"
    if here < HOURS_FROM:
        return f"{here / 60:.0f} min"
    return f"{here / 3600:.0f} hours"
