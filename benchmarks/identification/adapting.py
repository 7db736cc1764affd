"""An arm of unknown masses and friction reaches and holds: planned for the nominal arm, for the one estimated online, and
for the true one.

python -m benchmarks.identification.adapting  twelve arms: minutes, with the emulator of identification.py accuracy
python -m benchmarks.identification.adapting --bodies 1 --dry

The arm is that of carrier_family.toml: three joints and a payload, six parameters within 30 % of nominal
ones. Every arm begins upright at rest and must reach random angles, planned again at each super step. Errors are those of its
angles in the last of three seconds on the true physics, and those of the estimated parameters.

Writes adapting.csv, a line per arm and method, and medians.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import neuroanimator as na
from benchmarks.harness import Rows, keep_rows, parser_of, show_rows
from benchmarks.identification.emulators import CARRIER_FAMILY, made
from neuroanimator.control import ParameterEstimator, PhysicsPlant, Planner, control_plant
from neuroanimator.learn.evaluation.held_out import system_of

TABLE = Path(__file__).with_name("adapting.csv")

SECONDS = 3.0
"""Length of a motion [s]."""

JUDGED = 1.0
"""Time at its end in which angles count [s]."""

HORIZON = 30
"""Number of super steps that plans look ahead: 0.6 s."""

SINCE = 0.3
"""From when on in a plan the arm is to be there [s]."""

FAR = 1.2
"""Largest angle that is asked for [rad]."""

FIRST_SEED = 100
"""Seed of the first body: settings of the estimator were chosen by bodies 0 to 11."""

JOINTS = ("turn", "lift", "elbow")

METHODS = ("nominal", "estimated", "true")
"""The parameters that plans are made with."""


def rows_of(emulator: na.Emulator, bodies: int) -> Rows:
    """Return a line for each body and method."""
    system: Any = system_of(emulator)
    planner = Planner.of(emulator, reach(system, np.zeros(len(JOINTS))), HORIZON)
    steps = round(SECONDS / emulator.dt)
    judged = round(JUDGED / emulator.dt)
    plant = PhysicsPlant(system, emulator.dt)
    ranges = np.array([parameter.high - parameter.low for parameter in system.parameters])
    entries = list(emulator.parameter_entries)
    rows: Rows = []
    for seed in range(FIRST_SEED, FIRST_SEED + bodies):
        rng = np.random.default_rng(seed)
        true = {p.name: rng.uniform(p.low, p.high) for p in system.parameters}
        angles = rng.uniform(-FAR, FAR, len(JOINTS))
        towards = planner.towards(reach(system, angles))
        start = system.at(**true).rest
        for method in METHODS:
            estimator = None
            if method == "nominal":  # an estimate is never made
                estimator = ParameterEstimator(emulator, every=steps + 1)
            elif method == "estimated":
                estimator = ParameterEstimator(emulator)
            motion = control_plant(towards, plant, start, steps, estimator=estimator)
            off = motion.states[-judged:, : len(JOINTS)] - angles
            values = start[entries] if estimator is None else estimator.values
            row: dict[str, Any] = {"seed": seed, "method": method}
            row["angle_error_mrad"] = 1e3 * float(np.sqrt(np.mean(off**2)))
            row["parameter_error"] = float(np.mean(np.abs(values - start[entries]) / ranges))
            row["plan_ms"] = 1e3 * float(np.median(motion.plan_seconds))
            rows.append(row)
        show_rows(rows[-len(METHODS) :])
    return rows


def reach(system: Any, angles: np.ndarray) -> na.Objective:
    """Return the objective of being at these angles [rad], at rest."""
    wanted = {joint: [float(angle)] for joint, angle in zip(JOINTS, angles, strict=True)}
    wanted |= {f"{joint}.velocity": [0.0] for joint in JOINTS}
    return na.Objective.of(na.effort(0.001), na.reach_state(system, wanted, since=SINCE))


def medians(rows: Rows) -> Rows:
    """Return the medians of each method."""
    lines: Rows = []
    for method in METHODS:
        own = [row for row in rows if row["method"] == method]
        line: dict[str, Any] = {"seed": "median", "method": method}
        for key in ("angle_error_mrad", "parameter_error", "plan_ms"):
            line[key] = float(np.median([row[key] for row in own]))
        lines.append(line)
    return lines


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--emulators", type=Path, default=Path("emulators"))
    parser.add_argument("--bodies", type=int, default=12)
    arguments = parser.parse_args()
    rows = rows_of(made(CARRIER_FAMILY, arguments.emulators).emulator, arguments.bodies)
    rows += medians(rows)
    show_rows(rows[-len(METHODS) :])
    keep_rows(TABLE, rows, arguments)


if __name__ == "__main__":
    main()
