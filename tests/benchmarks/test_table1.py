"""The table and the sweep measure what they say."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brief import BRIEF
from executor_tasks import PackedHere

from benchmarks.equal_error import chunk_time, table1
from benchmarks.equal_error.paper_table import nominal_against_plain_c
from benchmarks.equal_error.plain_mass_spring import plain_player
from benchmarks.equal_error.table1 import chosen_rows
from neuroanimator import Emulator, NeuroAnimatorError, load_system
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.files.zoo import SHIPPED, shipped_path
from neuroanimator.learn.evaluation.fleets.sweep import SweepRow, largest_within, sweep
from neuroanimator.learn.training.batches import draw_batches
from neuroanimator.learn.training.recipes import RECIPES


@pytest.mark.endurance
def test_a_row_of_the_table_is_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("NEUROANIMATOR_BACKEND", "auto")
    monkeypatch.setattr(table1, "QUICK", replace(BRIEF, runs=4))
    monkeypatch.setattr(chunk_time, "CHUNKS", 2)
    plot = tmp_path / "work-precision.png"
    table1.main(
        [
            "--quick",
            "--json",
            "--systems",
            "pendulum-passive",
            "--substeps",
            "50",
            "--plot",
            f"{plot}",
        ]
    )
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["system"], row["substeps"], row["nominal_1998"]) == ("pendulum-passive", 50, 94)
    assert row["diverged"] == 0
    assert row["nominal_speedup"] > 20
    assert row["equal_error_speedup"] > 1
    assert row["one_step_error"] < 0.06 < row["constant_velocity_error"] < row["persistence_error"]
    assert row["ridge_regression_error"] > row["one_step_error"]
    assert row["break_even_hours"] > 0
    assert plot.stat().st_size > 5000


def test_rows_are_chosen_by_name():
    assert len(chosen_rows(None, None)) == len(SHIPPED) + 3 == 22
    assert chosen_rows("truck,lander", "50") == [("lander", 50), ("truck", 50)]
    with pytest.raises(NeuroAnimatorError, match="No rows for car"):
        chosen_rows("car", None)


def test_every_row_has_a_recipe_and_ships_small():
    for system, substeps in SHIPPED:
        assert system in RECIPES
        assert shipped_path(system, substeps).stat().st_size < 300_000


@pytest.mark.endurance
def test_a_sweep_names_the_largest_n_that_keeps_the_tolerance(tmp_path: Path):
    with PackedHere() as executor:
        rows = sweep(
            "pendulum",
            (25, 50),
            tmp_path,
            seconds=0.1,
            transitions=1500,
            updates=250,
            executor=executor,
        )
    assert [row.substeps for row in rows] == [25, 50]
    assert all(row.path.exists() and 0 < row.error < 1 for row in rows)
    made = [
        SweepRow(n, 0.0, error, 1.0, tmp_path) for n, error in ((25, 0.05), (50, 0.09), (100, 0.4))
    ]
    best = largest_within(made, 0.1)
    assert best is not None
    assert best.substeps == 50
    assert largest_within(made, 0.01) is None


def test_drawing_rare_rows_more_often_does_not_change_the_mean():
    values = jnp.asarray(np.random.default_rng(0).normal(size=1000))
    rare = jnp.arange(0, 1000, 10)
    means = []
    for key in jax.random.split(jax.random.key(0), 20):
        rows, weights = draw_batches(key, 64, 1000, rare, 0.5)
        assert weights is not None
        means.append(float(jnp.mean(values[rows] * weights[rows])))
    spread = np.std(means) / np.sqrt(len(means))
    assert abs(np.mean(means) - float(values.mean())) < 4 * spread
    assert float(jnp.isin(rows, rare).mean()) > 0.5


@pytest.mark.parametrize("name", ["fish", "dolphin", "cube"])
def test_plain_c_equals_the_physics(name: str):
    system = load_system(name)
    rng = np.random.default_rng(0)
    starts = system.sample_starts(rng, 5)
    controls = rng.uniform(-1, 1, (5, system.control.size))
    play = plain_player(system.body, starts, controls, system.physics_dt, 20)
    if find_compiler() is None:
        assert play is None
        return
    same = system.simulate(
        starts, controls[:, None], 20 * system.physics_dt, scheme=system.scheme
    ).states[:, 1]
    found = play()
    assert np.abs(found - same).max() < 1e-4 * np.abs(same).max()
    assert np.abs(found - starts).max() > 100 * np.abs(found - same).max()


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_bodies_alone_are_timed_against_plain_c():
    assert float(nominal_against_plain_c(Emulator.load("fish-50"), 1)) > 1
    assert nominal_against_plain_c(Emulator.load("pendulum-50"), 1) == ""
