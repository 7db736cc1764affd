"""The plain C loop is the physics."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.equal_error.paper_table import nominal_against_plain_c
from benchmarks.equal_error.plain_mass_spring import plain_player
from neuroanimator import Emulator, load_system
from neuroanimator.codegen.compiler import find_compiler


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
