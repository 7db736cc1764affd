"""Body and motion are varied together, by one gradient, and what is found is better on the physics or is not taken."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from families import parameter_lines, write_arm

from neuroanimator import (
    DatasetConfig,
    Emulator,
    NeuroAnimatorError,
    Objective,
    TrainingConfig,
    design,
    effort,
    load_system,
    reach_state,
    train,
)
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.control.descent.c_evaluator import c_evaluator
from neuroanimator.control.descent.descend import pose_problem, vary_parameters
from neuroanimator.control.descent.jax_evaluator import JaxEvaluator
from neuroanimator.control.descent.parametrisation import EachStep
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.systems.system import System

STEPS = 12


@pytest.fixture(scope="module")
def family(tmp_path_factory: pytest.TempPathFactory) -> tuple[Emulator, System]:
    folder = tmp_path_factory.mktemp("arm")
    toml = write_arm(folder, {}, parameter_lines(("damping", "gear", "mass")))
    trust_files(toml)
    name, definition, substeps = resolve(str(toml))
    config = DatasetConfig(
        system=name, definition=definition, substeps=substeps, count=2_016, samples_per_run=36
    )
    settings = TrainingConfig(updates=500, widths=(48, 32), batch=256)
    emulator = train(simulate_transitions(config), settings, folder / "arm.emulator.safetensors")
    return emulator, load_system(str(toml))


def lift(system: System) -> Objective:
    """The shoulder is to be raised: a light arm does it best."""
    return Objective.of(reach_state(system, {"shoulder": [3.0]}), effort(1e-3))


def test_the_gradient_in_parameters_equals_finite_differences(
    family: tuple[Emulator, System],
) -> None:
    emulator, system = family
    parametrisation = EachStep.of(STEPS, emulator.bounds)
    problem = pose_problem(emulator, lift(system), parametrisation, emulator.rest)
    varied = vary_parameters(emulator, ("mass", "gear"), parametrisation)
    rng = np.random.default_rng(0)
    z = rng.normal(size=parametrisation.size + 2) * 0.5
    with jax.enable_x64(True):
        cost = eqx.filter_jit(replace(problem, varied=varied).cost)
        gradient = np.asarray(jax.grad(cost)(jnp.asarray(z)))
        for entry in (-1, -2, 0):
            step = np.zeros(len(z))
            step[entry] = 1e-5
            ends = [float(cost(jnp.asarray(z + sign * step))) for sign in (1, -1)]
            difference = (ends[0] - ends[1]) / 2e-5
            assert gradient[entry] == pytest.approx(difference, rel=1e-3, abs=1e-7)


def test_a_designed_body_is_better_on_the_physics_or_the_old_one_stays(
    family: tuple[Emulator, System],
) -> None:
    emulator, system = family
    found = design(
        emulator, system, lift(system), emulator.rest, parameters=("mass", "gear"), steps=STEPS
    )
    assert found.synthesis.outcome.is_on_physics
    assert found.synthesis.outcome.cost_physics < 0.9 * found.nominal.outcome.cost_physics
    for parameter in emulator.parameters:
        if parameter.name in found.parameters:
            assert parameter.low <= found.parameters[parameter.name] <= parameter.high
    # What was not named stays.
    entry = emulator.parameter_entries[0]
    assert found.start[entry] == pytest.approx(emulator.rest[entry])
    assert found.parameters["gear"] > 1.0  # the motor is too weak


def test_names_that_are_no_parameters_are_refused(family: tuple[Emulator, System]) -> None:
    emulator, system = family
    with pytest.raises(NeuroAnimatorError, match="Parameters: damping, gear, mass"):
        design(emulator, system, lift(system), emulator.rest, parameters=("maß",), steps=STEPS)


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_c_and_jax_agree_where_a_body_is_varied(family: tuple[Emulator, System]) -> None:
    emulator, system = family
    parametrisation = EachStep.of(STEPS, emulator.bounds)
    problem = pose_problem(emulator, lift(system), parametrisation, emulator.rest)
    varied = vary_parameters(emulator, ("mass", "gear"), parametrisation)
    problem = replace(problem, varied=varied)
    in_c = c_evaluator(problem)
    assert in_c is not None
    in_jax = JaxEvaluator(problem)
    zs = np.random.default_rng(0).normal(size=(9, varied.size)) * 0.5
    np.testing.assert_allclose(in_c.costs(zs), in_jax.costs(zs), rtol=1e-4)
    for found, expected in zip(in_c.gradients(zs[:2]), in_jax.gradients(zs[:2]), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())
    found, expected = in_c.quadratic_models(zs[:1])[0], in_jax.quadratic_models(zs[:1])[0]
    scale = np.abs(expected.curvature).max()
    np.testing.assert_allclose(found.curvature, expected.curvature, atol=1e-3 * scale)
    np.testing.assert_allclose(
        in_c.motion(zs[0]).states, in_jax.motion(zs[0]).states, rtol=1e-3, atol=1e-4
    )
