"""Swing-up of the three-link pendulum: three methods of descent, strong and weak motors.

python benchmarks/swing_up.py            table, and results/swing_up.csv
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator import (
    DescentOptions,
    Emulator,
    Objective,
    descend,
    effort,
    goal,
    is_reached,
    load_emulator,
    load_system,
    replay,
)
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.state.layout import Bounds
from neuroanimator.systems.rigid.pendulum import MOTOR_TORQUE, WEAK_MOTOR_TORQUE
from neuroanimator.terminal import print_table

LIMITS = {"strong": MOTOR_TORQUE, "weak": WEAK_MOTOR_TORQUE}
TRIALS = [
    ("strong", 1.5, "momentum", 20), ("strong", 1.5, "momentum", 200), ("strong", 1.5, "lbfgs", 20),
    ("strong", 1.5, "lbfgs", 60), ("strong", 1.5, "gauss-newton", 20), ("strong", 2.0, "gauss-newton", 20),
    ("weak", 1.5, "gauss-newton", 40), ("weak", 3.0, "gauss-newton", 40), ("weak", 4.0, "gauss-newton", 40),
    ("weak", 6.0, "gauss-newton", 40), ("weak", 4.0, "lbfgs", 200), ("weak", 4.0, "momentum", 400),
]  # fmt: skip
SEEDS = 5
"""Descents from different first controls; the first is no control at all, which is what users get."""
FIRST_SHARE = 0.3
"""Size of random first controls, as a share of the limit."""


def trial(
    emulator: Emulator, motors: str, seconds: float, method: str, iterations: int
) -> dict[str, Any]:
    """Return one row: how descents from `SEEDS` first controls fared, on emulator and physics."""
    system = load_system("pendulum")
    objective = Objective.of(effort(), goal(system, "upright"))
    start = np.zeros(6)
    bounds = Bounds.symmetric(LIMITS[motors])
    steps = round(seconds / emulator.dt)
    descents = []
    outcomes = []
    for seed in range(SEEDS):
        waves = smooth(np.random.default_rng(seed), steps, emulator.dt)
        first = waves * bounds.half * FIRST_SHARE * (seed > 0)
        options = DescentOptions(method=method, iterations=iterations, first=first, bounds=bounds)
        descent = descend(emulator, objective, start, steps=steps, options=options)
        descents.append(descent)
        outcomes.append(replay(emulator, system, objective, start, descent.controls))
    return {
        "motors": motors,
        "seconds": seconds,
        "method": method,
        "iterations": int(np.median([each.iterations for each in descents])),
        "search_s": float(np.median([each.seconds for each in descents])),
        "J_emulator": float(np.median([each.cost_emulator for each in outcomes])),
        "J_physics": float(np.median([each.cost_physics for each in outcomes])),
        "J_physics_worst": max(each.cost_physics for each in outcomes),
        "upright_emulator": f"{sum(is_reached(system, 'upright', each.emulator_states[-1]) for each in outcomes)}/{SEEDS}",
        "upright_physics": f"{sum(is_reached(system, 'upright', each.physics_states[-1]) for each in outcomes)}/{SEEDS}",
    }


def smooth(rng: np.random.Generator, steps: int, dt: float) -> np.ndarray:
    """Return slow random waves (T, 3) within ±1."""
    time = np.arange(steps)[:, None] * dt
    return np.sin(2 * np.pi * (rng.uniform(0.2, 0.8, 3) * time + rng.uniform(0, 1, 3)))


if __name__ == "__main__":
    emulator = load_emulator("pendulum-50")
    rows = [trial(emulator, *settings) for settings in TRIALS]
    write_csv(Path(__file__).parent / "results" / "swing_up.csv", rows)
    print(describe_machine())
    print_table(rows)
