"""Four super steps of 25 physics steps beside two of 50 and one of 100: errors after the same time, and after long."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

import neuroanimator as na
from classic_cases.lessons import rollouts
from classic_cases.pendulum_1998 import classic_networks
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.evaluation.accuracy import bounded, root_mean_square
from neuroanimator.evaluation.held_out import HeldOut, held_out_runs

Rows = list[dict[str, Any]]

HORIZON = 100
"""Number of physics steps for which a control is held, and after which errors are compared first."""

SUBSTEPS = (25, 50, 100)
"""Numbers of physics steps in a super step."""

PENDULUM = "pendulum"

SHIPPED = (PENDULUM, "pendulum-passive", "fish", "dolphin")
"""Systems whose emulators that ship are compared."""

RUNS = 16
"""Number of unseen runs."""

SECONDS = 5.0
"""Length of a rollout [s]."""

SHIPS = "ships"
CLASSIC = "classic"
PHYSICS = "physics"


def super_step_rows(is_quick: bool) -> Rows:
    """Return a row per system, network and super step: errors after one horizon, after 1 s and after 5 s."""
    rows = []
    for name in SHIPPED[:1] if is_quick else SHIPPED:
        longest = na.load_emulator(f"{name}-{HORIZON}")
        test = held_out_runs(longest, 4 if is_quick else RUNS, SECONDS)
        for substeps in SUBSTEPS:
            emulator = na.load_emulator(f"{name}-{substeps}")
            errors = errors_at_moments(test, emulated(emulator, test))
            rows.append(_row(name, SHIPS, substeps, errors[None]))
        if name == PENDULUM:
            rows += classic_rows(test, is_quick)
        rows.append(_row(name, PHYSICS, 1, physics_errors(test)[None]))
    return rows


def classic_rows(test: HeldOut, is_quick: bool) -> Rows:
    """Return the rows of networks of 1998."""
    rows = []
    for substeps in SUBSTEPS:
        emulators = classic_networks(substeps, is_quick).emulators
        errors = [errors_at_moments(test, emulated(emulator, test)) for emulator in emulators]
        rows.append(_row(PENDULUM, CLASSIC, substeps, np.array(errors)))
    return rows


def emulated(emulator: Emulator, test: HeldOut) -> Float[np.ndarray, "B T S"]:
    """Return the emulator's states at the test's moments, its controls held over several super steps."""
    each = round(test.dt / emulator.dt)
    controls = np.repeat(test.controls, each, axis=1)
    return np.asarray(rollouts(emulator, test.states[:, 0], controls), float)[:, ::each]


def errors_at_moments(test: HeldOut, states: Float[np.ndarray, "B T S"]) -> Float[np.ndarray, " 3"]:
    """Return errors after one horizon, after 1 s and at the end, over the standard deviation of the change in a horizon."""
    with np.errstate(over="ignore", invalid="ignore"):
        errors = test.relative(test.frame.difference(test.states, states))
        along = bounded(root_mean_square(bounded(errors), axis=(0, 2)))
    second = round(1.0 / test.dt)
    return along[[1, second, -1]]


def physics_errors(test: HeldOut) -> Float[np.ndarray, " 3"]:
    """Return the errors of the physics at its own step: where it strays from finer physics, nobody can follow."""
    system = test.system
    runs = system.simulate(test.states[:, 0], test.controls, test.dt, scheme=system.scheme)
    return errors_at_moments(test, runs.states)


def _row(
    name: str, network: str, substeps: int, errors: Float[np.ndarray, "N 3"]
) -> dict[str, Any]:
    row: dict[str, Any] = {"system": name, "network": network, "substeps": substeps}
    row["super_steps"] = HORIZON // substeps
    row["seeds"] = len(errors)
    for number, moment in enumerate(("horizon", "1s", "5s")):
        row[f"error_{moment}"] = float(np.median(errors[:, number]))
        row[f"error_{moment}_least"] = float(errors[:, number].min())
        row[f"error_{moment}_largest"] = float(errors[:, number].max())
    return row
