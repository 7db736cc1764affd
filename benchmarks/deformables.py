"""Deformable bodies, part by part; each writes results/deformables_PART.csv.

python benchmarks/deformables.py physics          cost of the physics in C and in JAX, and its accuracy
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
from deformable_cases.batch_players import (
    BATCH_STEPS,
    c_batch_players,
    jax_batch_player,
    random_bodies,
)
from deformable_emulators import accuracy_rows, deformable, hierarchy_rows, long_rows

from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.held_out import HeldOut, make_test
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.evaluation.speed import interleaved, one_core
from neuroanimator.evaluation.speed_mass_spring import twin_error
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.systems.deformable.native.compiled import INTEGRATORS, c_twin
from neuroanimator.systems.deformable.stability import largest_stable_step
from neuroanimator.systems.system import Scheme
from neuroanimator.terminal import print_table

SYSTEMS = ("fish", "dolphin", "cube")
"""The shipped systems measured."""

BATCHES = (1, 64, 1024)
"""Numbers of bodies simulated at once."""

BODY_STEPS = 20_000
"""The physics steps of all bodies together in one timed run."""

COMPARED_STEPS = 100
"""Number of steps after which JAX and C are compared."""

COMPARED_BODIES = 16
"""Number of random bodies on which JAX and C are compared."""

SUPER_STEP = 50
"""Number of physics steps in a super step."""

DIVISIONS = (50, 25, 10, 5)
"""Numbers of physics steps per super step with which one-step errors are measured."""

REPEATS = 25
"""Number of timings of every side: enough to outlast a burst of other work on a shared machine, which nine are not."""

QUICK_REPEATS = 3
"""Number of timings of every side with --quick."""

ERROR_RUNS = 32
"""Number of runs in which one-step errors are measured."""

ERROR_STEPS = 20
"""Number of super steps in each of these runs."""

Row = dict[str, Any]
Rows = list[Row]


def physics_rows(repeats: int) -> Rows:
    """Return a row per system and integrator; every time is of one body's one step [µs]."""
    rows: Rows = []
    for name in SYSTEMS:
        rows += system_rows(deformable(name), repeats)
    return rows


def system_rows(system: DeformableSystem, repeats: int) -> Rows:
    """Return a row per integrator."""
    test = simulated(system)
    limit = largest_stable_step(system.body)
    rows: Rows = []
    for integrator in INTEGRATORS:
        row: Row = {"system": system.name, "integrator": integrator}
        row |= costs(system, integrator, repeats)
        row["jax_minus_c_float64"] = difference(system, integrator)
        row["step_ms"] = system.physics_dt * 1e3
        row["largest_linear_step_ms"] = limit * 1e3
        for count in DIVISIONS:
            scheme = Scheme(integrator, test.dt / count)
            row[f"error_at_{count}_per_super_step"] = twin_error(test, scheme)
        rows.append(row)
    return rows


def costs(system: DeformableSystem, integrator: str, repeats: int) -> dict[str, float | str]:
    """Return the cost of C and JAX at every batch, all played in turn, and their ratio at the fastest of each."""
    players: dict[str, Callable[[], object]] = {}
    body_steps: dict[str, int] = {}
    for batch in BATCHES:
        steps = max(BATCH_STEPS // 10, BODY_STEPS // batch)
        batch_players = c_players(system, batch, integrator, steps)
        batch_players[f"jax_{batch}"] = jax_batch_player(system, batch, integrator, steps)
        players |= batch_players
        body_steps |= dict.fromkeys(batch_players, batch * steps)
    with one_core():
        spans = interleaved(players, repeats)
    cost = {name: spans[name] / body_steps[name] * 1e6 for name in players}
    columns: dict[str, float | str] = {f"{name}_us": cost[name] for name in players}
    for batch in BATCHES:
        columns[f"jax_over_c_{batch}"] = ratio(cost, batch)
    return columns


def c_players(
    system: DeformableSystem, batch: int, integrator: str, steps: int
) -> dict[str, Callable[[], object]]:
    """Return what plays `steps` steps of `batch` bodies in C, by name; none without a compiler."""
    if batch == 1:
        twin = c_twin(system.body)
        if twin is None:
            return {}
        start, control = random_bodies(system, 1)
        return {"c_1": twin.player(start, control, integrator, system.physics_dt, steps)}
    players = {}
    for layout, play in c_batch_players(system, batch, integrator, steps).items():
        players[f"c_{batch}_{layout}".replace(" ", "_").rstrip("_")] = play
    return players


def ratio(cost: dict[str, float], batch: int) -> float | str:
    """Return how many times as long as the faster C layout JAX takes; empty without a compiler."""
    c_costs = [value for name, value in cost.items() if f"{name}_".startswith(f"c_{batch}_")]
    if not c_costs:
        return ""
    return cost[f"jax_{batch}"] / min(c_costs)


def difference(system: DeformableSystem, integrator: str) -> float | str:
    """Return the largest difference of any number in float64 after `COMPARED_STEPS` steps under random controls."""
    twin = c_twin(system.body, np.float64)
    if twin is None:
        return ""
    starts, controls = random_bodies(system, COMPARED_BODIES)
    dt = system.physics_dt
    scheme = Scheme(integrator, dt)
    runs = system.simulate(starts, controls[:, None], dt * COMPARED_STEPS, scheme=scheme)
    in_jax = runs.states[:, -1]
    in_c = twin.advance(starts, controls, integrator, dt, COMPARED_STEPS)
    return float(np.abs(in_jax - in_c).max())


def simulated(system: DeformableSystem) -> HeldOut:
    """Return runs of fine physics under random controls, by super steps of `SUPER_STEP`."""
    rng = np.random.default_rng(0)
    controls = rng.uniform(-1, 1, (ERROR_RUNS, ERROR_STEPS, system.control.size))
    dt = SUPER_STEP * system.physics_dt
    starts = system.sample_starts(rng, ERROR_RUNS)
    runs = system.simulate(starts, controls, dt, scheme=system.fine)
    is_alive = ~runs.has_diverged
    return make_test(system, dt, runs.states[is_alive], controls[is_alive])


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
    repeats = REPEATS
    if options.quick:
        repeats = QUICK_REPEATS
    rows = PARTS[options.part](repeats)
    if not options.quick:
        write_csv(Path(__file__).parent / "results" / f"deformables_{options.part}.csv", rows)
    print(describe_machine())
    print_table(rows)


if __name__ == "__main__":
    main()
