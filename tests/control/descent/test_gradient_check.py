"""The emulator's gradient is held against differences of the true physics."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swing_up import stand_upright

from neuroanimator import Emulator, load_system
from neuroanimator.control.descent.descend import pose_problem
from neuroanimator.control.descent.gradient_check import (
    GradientTrust,
    difference_gradient,
    gradient_trust,
)
from neuroanimator.control.descent.parametrisation import EachStep
from neuroanimator.emulator.super_step import rollout

STEPS = 10
REST = np.zeros(6)


@pytest.fixture(scope="module")
def parametrisation(shipped: Emulator) -> EachStep:
    return EachStep.of(STEPS, shipped.bounds)


def random_controls(emulator: Emulator, seed: int) -> np.ndarray:
    bounds = emulator.bounds
    return np.random.default_rng(seed).uniform(bounds.low, bounds.high, (STEPS, len(bounds.low)))


def physical_gradient(
    emulator: Emulator, parametrisation: EachStep, z: np.ndarray, step: float
) -> np.ndarray:
    system = load_system("pendulum")

    def follow(starts, controls):
        return system.simulate_fastest(starts, controls, emulator.dt).states

    problem = pose_problem(emulator, stand_upright(), parametrisation, REST)
    return difference_gradient(follow, problem, z, np.eye(len(z)), step)


@pytest.mark.parametrize("seed", range(5))
def test_over_a_short_horizon_both_gradients_agree(
    seed: int, shipped: Emulator, parametrisation: EachStep
):
    controls = random_controls(shipped, seed)
    trust = gradient_trust(
        shipped, load_system("pendulum"), stand_upright(), parametrisation, REST, controls
    )
    assert trust.cosine >= 0.9
    assert trust.warning() == ""
    ratio = np.linalg.norm(trust.emulator_gradient) / np.linalg.norm(trust.physics_gradient)
    assert ratio == pytest.approx(1, abs=0.25)


def test_a_shuffled_gradient_is_not_trusted(shipped: Emulator, parametrisation: EachStep):
    controls = random_controls(shipped, 0)
    trust = gradient_trust(
        shipped, load_system("pendulum"), stand_upright(), parametrisation, REST, controls
    )
    shuffled = np.random.default_rng(0).permutation(trust.emulator_gradient)
    broken = GradientTrust.of(shuffled, trust.physics_gradient)
    assert broken.cosine < 0.5
    assert f"cosine {broken.cosine:.2f}" in broken.warning()
    assert "\n" not in broken.warning()


def test_an_emulator_trusts_itself(shipped: Emulator, parametrisation: EachStep):
    controls = random_controls(shipped, 1)
    trust = gradient_trust(
        shipped, load_system("pendulum"), stand_upright(), parametrisation, REST, controls
    )

    def follow(starts, held):
        with jax.enable_x64(True):
            motions = jax.vmap(lambda s, u: rollout(shipped, s, u))
            return np.asarray(motions(jnp.asarray(starts), jnp.asarray(held)))

    problem = pose_problem(shipped, stand_upright(), parametrisation, REST)
    z = parametrisation.guess(controls)
    itself = difference_gradient(follow, problem, z, np.eye(len(z)))
    assert GradientTrust.of(trust.emulator_gradient, itself).cosine == pytest.approx(1, abs=1e-3)
    np.testing.assert_allclose(trust.emulator_gradient, itself, atol=1e-3 * np.abs(itself).max())


def test_halving_the_step_quarters_the_error_of_the_differences(
    shipped: Emulator, parametrisation: EachStep
):
    z = parametrisation.guess(random_controls(shipped, 2))
    coarse, middle, fine = (
        physical_gradient(shipped, parametrisation, z, step) for step in (4e-2, 2e-2, 1e-2)
    )
    assert np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine) == pytest.approx(
        4, rel=0.05
    )


def test_the_step_taken_is_drowned_neither_by_curvature_nor_by_rounding(
    shipped: Emulator, parametrisation: EachStep
):
    z = parametrisation.guess(random_controls(shipped, 3))
    taken, larger, smaller = (
        physical_gradient(shipped, parametrisation, z, step) for step in (1e-5, 1e-4, 1e-6)
    )
    size = np.linalg.norm(taken)
    assert np.linalg.norm(taken - larger) < 1e-6 * size
    assert np.linalg.norm(taken - smaller) < 1e-6 * size


def test_a_vanishing_gradient_is_not_trusted():
    assert GradientTrust.of(np.zeros(3), np.ones(3)).warning()
