"""Drift: histograms of long motions, of the physics and of emulators that are good, wrong and lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import neuroanimator as na
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.learn.evaluation.drift import measure_drift, quantities


@pytest.fixture(scope="module")
def shipped() -> Emulator:
    return na.load_emulator("pendulum-50")


@pytest.mark.parametrize("name", ["pendulum", "lander", "fish"])
def test_twice_as_fast_is_four_times_the_energy_wherever_it_is(name: str):
    system = na.load_system(name)
    states = system.sample_starts(np.random.default_rng(4), 5)
    fast = states.copy()
    rates = [entry for entry, unit in enumerate(system.state.names) if unit.endswith("/s")]
    fast[:, rates] *= 2
    slow_energy, fast_energy = system.kinetic_energies(states), system.kinetic_energies(fast)
    assert slow_energy is not None
    assert fast_energy is not None
    assert slow_energy.min() >= 0 < slow_energy.max()
    np.testing.assert_allclose(fast_energy, 4 * slow_energy, rtol=1e-9)
    slow, quick = quantities(system, states)["speed"], quantities(system, fast)["speed"]
    np.testing.assert_allclose(quick, 2 * slow, rtol=1e-9)


def test_an_emulator_that_is_true_spends_its_time_as_the_physics_does(shipped: Emulator):
    told: list[tuple[int, int]] = []
    found = measure_drift(
        shipped, runs=16, steps=600, on_progress=lambda done, of: told.append((done, of))
    )
    assert [drift.quantity for drift in found] == [
        "kinetic energy",
        "speed",
        "angle 1",
        "angle 2",
        "angle 3",
    ]
    assert told == [(500, 600), (600, 600)]
    for drift in found:
        assert 0 <= drift.low <= drift.high <= 1
        # No further than one half of the physics' own runs is from the other.
        assert drift.distance < drift.chance


def test_one_that_is_lazy_or_lost_does_not(shipped: Emulator):
    known = shipped.normaliser
    slow = replace(known, change_scale=0.1 * known.change_scale, change_mean=0 * known.change_mean)
    lazy = replace(shipped, normaliser=slow)
    found = measure_drift(lazy, runs=16, steps=600)
    assert max(drift.low - drift.chance for drift in found) > 0.1
    scale = np.full_like(np.asarray(shipped.normaliser.change_scale), np.nan)
    lost = replace(shipped, normaliser=replace(shipped.normaliser, change_scale=scale))
    for drift in measure_drift(lost, runs=4, steps=50):
        assert drift.distance == 1
