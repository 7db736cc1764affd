"""Deformable bodies, part by part; each writes results/deformables_PART.csv.

python benchmarks/deformables.py physics          what the physics costs in C and in JAX, and how exact it is
python benchmarks/deformables.py accuracy         shipped emulators after one super step and after a hundred
python benchmarks/deformables.py long             100,000 super steps, with and without correction
python benchmarks/deformables.py hierarchy        flat networks against hierarchies of equal cost
python benchmarks/deformables.py physics --quick  fewer repeats; writes no file
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from deformable_emulators import accuracy_rows, deformable, hierarchy_rows, long_rows

from neuroanimator.bench.csv_table import describe_machine, write_csv
from neuroanimator.evaluation.held_out import HeldOut, make_test
from neuroanimator.evaluation.speed import interleaved, one_core
from neuroanimator.evaluation.speed_mass_spring import (
    BATCH_STEPS,
    c_batch_players,
    jax_batch_player,
    random_bodies,
    twin_error,
)
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.systems.deformable.native.compiled import INTEGRATORS, c_twin
from neuroanimator.systems.deformable.stability import largest_stable_step
from neuroanimator.systems.system import Scheme
from neuroanimator.terminal import print_table

SYSTEMS = ("fish", "dolphin", "cube")
BATCHES = (1, 64, 1024)
BODY_STEPS = 20_000
"""Physics steps of all bodies together in one timed run."""
COMPARED_STEPS = 100
"""Steps after which JAX and C are compared."""
DIVISIONS = (50, 25, 10, 5)
"""Physics steps per super step of 50 at which one-step errors are measured."""
REPEATS = 25
"""Timings of each side: enough to outlast a burst of other work on a shared machine, which nine are not."""
ERROR_RUNS, ERROR_STEPS = 32, 20

Rows = list[dict[str, Any]]


def physics_rows(repeats: int) -> Rows:
    """Return a row per system and integrator; every time is of one body's one step [µs]."""
    return [row for name in SYSTEMS for row in system_rows(deformable(name), repeats)]


def system_rows(system: DeformableSystem, repeats: int) -> Rows:
    """Return a row per integrator."""
    test, limit = simulated(system), largest_stable_step(system.body)
    return [
        {
            "system": system.name,
            "integrator": kind,
            **costs(system, kind, repeats),
            "jax_minus_c_float64": difference(system, kind),
            "step_ms": system.physics_dt * 1e3,
            "largest_linear_step_ms": limit * 1e3,
            **{
                f"error_at_{n}_per_super_step": twin_error(test, Scheme(kind, test.dt / n))
                for n in DIVISIONS
            },
        }
        for kind in INTEGRATORS
    ]


def costs(system: DeformableSystem, kind: str, repeats: int) -> dict[str, float | str]:
    """Return the cost of C and JAX at every batch, all played in turn, and their ratio at the fastest of each."""
    players, lengths = {}, {}
    for batch in BATCHES:
        steps = max(BATCH_STEPS // 10, BODY_STEPS // batch)
        found = {} if batch == 1 else c_batch_players(system, batch, kind, steps)
        if batch == 1 and (twin := c_twin(system.body)) is not None:
            found = {"": twin.player(*random_bodies(system, 1), kind, system.physics_dt, steps)}
        named = {
            f"c_{batch}_{name}".replace(" ", "_").rstrip("_"): play for name, play in found.items()
        }
        named[f"jax_{batch}"] = jax_batch_player(system, batch, kind, steps)
        players |= named
        lengths |= dict.fromkeys(named, batch * steps)
    with one_core():
        spans = interleaved(players, repeats)
    cost = {name: spans[name] / lengths[name] * 1e6 for name in players}
    return {
        **{f"{name}_us": cost[name] for name in players},
        **{f"jax_over_c_{batch}": ratio(cost, batch) for batch in BATCHES},
    }


def ratio(cost: dict[str, float], batch: int) -> float | str:
    """Return how many times as long as the faster C layout JAX takes; empty without a compiler."""
    rivals = [value for name, value in cost.items() if f"{name}_".startswith(f"c_{batch}_")]
    return cost[f"jax_{batch}"] / min(rivals) if rivals else ""


def difference(system: DeformableSystem, kind: str) -> float | str:
    """Return the largest difference of any number in float64 after `COMPARED_STEPS` steps under random controls."""
    twin, (starts, controls) = c_twin(system.body, np.float64), random_bodies(system, 16)
    if twin is None:
        return ""
    dt, steps = system.physics_dt, COMPARED_STEPS
    runs = system.simulate(starts, controls[:, None], dt * steps, scheme=Scheme(kind, dt))
    return float(np.abs(runs.states[:, -1] - twin.advance(starts, controls, kind, dt, steps)).max())


def simulated(system: DeformableSystem) -> HeldOut:
    """Return runs of fine physics under random controls, by super steps of 50."""
    rng = np.random.default_rng(0)
    controls = rng.uniform(-1, 1, (ERROR_RUNS, ERROR_STEPS, system.control.size))
    dt = 50 * system.physics_dt
    runs = system.simulate(system.sample_starts(rng, ERROR_RUNS), controls, dt, scheme=system.fine)
    return make_test(system, dt, runs.states[~runs.has_diverged], controls[~runs.has_diverged])


PARTS: dict[str, Callable[[int], Rows]] = {
    "physics": physics_rows,
    "accuracy": accuracy_rows,
    "long": long_rows,
    "hierarchy": hierarchy_rows,
}
"""By name, what makes a part's rows from the number of repeats."""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--quick", action="store_true", help="fewer repeats; writes no file")
    options = parser.parse_args()
    rows = PARTS[options.part](3 if options.quick else REPEATS)
    if not options.quick:
        write_csv(Path(__file__).parent / "results" / f"deformables_{options.part}.csv", rows)
    print(describe_machine())
    print_table(rows)


if __name__ == "__main__":
    main()
