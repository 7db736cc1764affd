"""The cost of leaving training: nothing within, more without, and what is found with it stays nearer."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest

import neuroanimator as na
from neuroanimator.control.descent.options import DescentOptions
from neuroanimator.control.objective.objective import Trajectory
from neuroanimator.control.synthesis.attempt import SearchOptions
from neuroanimator.control.synthesis.synthesise import synthesise_goal
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError


@pytest.fixture(scope="module")
def shipped() -> Emulator:
    return na.load_emulator("pendulum-50")


@eqx.filter_jit
def slope_of(cost: na.CostTerm, motion: Trajectory) -> jax.Array:
    """Return the slope by the states, compiled as a whole."""
    return jax.grad(lambda states: cost(motion._replace(states=states)))(motion.states)


def test_it_costs_what_scores_are_above_the_threshold(shipped: Emulator):
    rng = np.random.default_rng(6)
    controls = rng.uniform(shipped.bounds.low, shipped.bounds.high, (12, 3))
    states, scores = shipped.rollout_trusted(shipped.rest, controls)
    motion = Trajectory(np.float32(states), np.float32(controls), np.ones(3), shipped.dt)
    for threshold in (0.05, 0.2, 10.0):
        cost = na.stay_trusted(shipped, threshold=threshold, weight=3.0)
        excess = np.maximum(scores - threshold, 0)
        wanted = 1.5 * shipped.dt * np.sum(excess**2)
        assert float(cost(motion)) == pytest.approx(wanted, rel=1e-3, abs=1e-7)
        assert np.isfinite(slope_of(cost, motion)).all()


def test_what_is_found_with_it_stays_nearer_to_training(shipped: Emulator):
    options = SearchOptions(DescentOptions(iterations=8), corrections=0)
    system = na.load_system("pendulum")
    beyond = []
    for threshold in (None, 0.15):
        found = synthesise_goal(shipped, system, "upright", options=options, threshold=threshold)
        scores = shipped.trust(found.outcome.emulator_states[:-1], found.controls)
        beyond.append(np.sum(np.maximum(scores - 0.15, 0) ** 2))
    assert beyond[1] < 0.9 * beyond[0]


def test_a_threshold_that_makes_no_sense_is_refused(shipped: Emulator):
    for threshold in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ArgumentError, match="threshold: wanted a score above 0"):
            na.stay_trusted(shipped, threshold=threshold)
    with pytest.raises(ArgumentError, match=r"too old to have trust scores. na.fit_trust"):
        na.stay_trusted(replace(shipped, meter=None))
