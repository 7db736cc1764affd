"""Errors of emulators of families beside those of one body of each, and what a super step of them costs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax

from neuroanimator import Emulator
from neuroanimator.learn.evaluation.accuracy import one_step_error, root_mean_square
from neuroanimator.learn.evaluation.held_out import held_out_runs
from neuroanimator.learn.evaluation.speed import (
    IN_C,
    TIMED_SUPER_STEPS,
    emulator_players,
    interleaved,
    one_core,
)

TEST_RUNS = 100
"""Number of unseen runs, of each emulator's own system: of bodies of the family, or of the one."""


def accuracy_rows(emulators: Mapping[str, Emulator]) -> list[dict[str, Any]]:
    """Return a line for each emulator by its name: size, cost, error, and that over the first one, which is of one body."""
    players = {name: emulator_players(emulator)[IN_C] for name, emulator in emulators.items()}
    with one_core():
        seconds = interleaved(players)
    tests = {}  # their physics is dear
    rows: list[dict[str, Any]] = []
    for name, emulator in emulators.items():
        if emulator.system not in tests:
            tests[emulator.system] = held_out_runs(emulator, TEST_RUNS)
        test = tests[emulator.system]
        row: dict[str, Any] = {"emulator": name}
        row["parameters"] = len(emulator.parameters)
        row["widths"] = " ".join(map(str, emulator.network.widths))
        row["weights"] = sum(
            leaf.size for leaf in jax.tree.leaves(eqx.filter(emulator.network, eqx.is_array))
        )
        row["one_step_error"] = float(root_mean_square(one_step_error(emulator, test)))
        row["over_one_body"] = row["one_step_error"] / (rows or [row])[0]["one_step_error"]
        row["super_step_us"] = 1e6 * seconds[name] / TIMED_SUPER_STEPS
        rows.append(row)
    return rows
