"""Emulators of deformable bodies are timed against C, and against what else there is where nothing compiles it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.equal_error.batch_players import c_batch_players, jax_batch_player
from benchmarks.equal_error.work_precision import draw_work_precision
from neuroanimator.codegen import compiler
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.learn.evaluation.accuracy import scheme_error
from neuroanimator.learn.evaluation.evaluate import Evaluation
from neuroanimator.learn.evaluation.held_out import HeldOut, make_test
from neuroanimator.learn.evaluation.report import write_report
from neuroanimator.learn.evaluation.speed import Opponent, Speed
from neuroanimator.learn.evaluation.speed_mass_spring import (
    C_TWIN,
    JAX,
    deformable_players,
    twin_error,
)
from neuroanimator.physics import load_system
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.physics.deformable.native.compiled import INTEGRATORS
from neuroanimator.systems.system import Scheme

has_compiler = find_compiler() is not None


@pytest.fixture(scope="module")
def swims() -> HeldOut:
    system, rng = load_system("fish"), np.random.default_rng(0)
    assert isinstance(system, DeformableSystem)
    controls = rng.uniform(-1, 1, (4, 3, system.control.size))
    dt = 10 * system.physics_dt
    return make_test(
        system, dt, system.simulate(system.sample_starts(rng, 4), controls, dt).states, controls
    )


def test_errors_by_the_twin_are_those_of_the_physics(swims: HeldOut):
    for scheme in (swims.system.scheme, Scheme("semi-implicit", swims.dt / 10)):
        assert twin_error(swims, scheme) == pytest.approx(scheme_error(swims, scheme), rel=1e-6)
    assert twin_error(swims, swims.system.truth) < 1e-9


def test_a_step_too_long_is_no_opponent(swims: HeldOut):
    longer = HeldOut(swims.system, 0.5, swims.states, swims.controls, swims.change_scale)
    assert twin_error(longer, Scheme("symplectic", 0.01)) > 100


@pytest.mark.parametrize("compiles", [True, False])
def test_every_integrator_is_timed(swims: HeldOut, compiles: bool, monkeypatch: pytest.MonkeyPatch):
    if not compiles:
        monkeypatch.setattr(compiler.shutil, "which", lambda name: None)
    system = swims.system
    assert isinstance(system, DeformableSystem)
    physics, players = deformable_players(system, swims, steps=20, pieces=2)
    assert physics == (C_TWIN if compiles and has_compiler else JAX)
    assert tuple(players) == INTEGRATORS
    for play in players.values():
        play()


def test_batches_are_stepped_in_turn_and_side_by_side():
    system = load_system("fish")
    assert isinstance(system, DeformableSystem)
    players = c_batch_players(system, 16, "symplectic", steps=2)
    assert list(players) == (["in turn", "side by side"] if has_compiler else [])
    for play in [*players.values(), jax_batch_player(system, 16, "symplectic", steps=2)]:
        play()


def evaluation(physics: str) -> Evaluation:
    """An evaluation with made-up figures."""
    opponents = tuple(
        Opponent(Scheme(kind, dt), error, 1e-4 / dt)
        for kind in INTEGRATORS
        for dt, error in ((0.01, float("inf")), (0.001, 0.01))
    )
    speed = Speed(1e-6, 1e-6, 50.0, 2.0, opponents[1], opponents, physics)
    times, motion = np.arange(3.0), np.zeros((3, 2))
    return Evaluation(
        system="fish", substeps=50, dt=0.1, entries=["nose.x m", "nose.y m"], error_by_entry=np.full(2, 0.02),
        times=times, rollout_errors=times, self_divergence=times, sample_emulated=motion, sample_physics=motion,
        measured_speed=speed, emulator_seconds=1e-6, baselines={}, diverged=0, diverged_starts=0,
    )  # fmt: skip


def test_the_report_names_the_twin_and_says_where_there_is_none(tmp_path: Path):
    assert "no C compiler" not in evaluation(C_TWIN).note
    assert "no C compiler" in evaluation(JAX).note
    write_report([evaluation(C_TWIN)], tmp_path / "report.html")
    draw_work_precision([evaluation(C_TWIN)], tmp_path / "work.svg")
    assert "symplectic at 1 ms" in (tmp_path / "report.html").read_text()
