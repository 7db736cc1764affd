"""Families of mass-spring bodies: each body of one is the body that would be written down with its numbers."""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from energies import energy

from neuroanimator import load_system
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.definitions.body import BodyDefinition
from neuroanimator.errors import ArgumentError
from neuroanimator.physics.deformable.body import length_jacobian
from neuroanimator.physics.deformable.body_parameters import body_at
from neuroanimator.physics.deformable.build import body_of
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.physics.deformable.mass_spring import BodyState, trajectory
from neuroanimator.physics.deformable.native.compiled import INTEGRATORS, c_twin

DT = 0.02
"""Ten physics steps of a fish [s]."""


@pytest.fixture(scope="module")
def fishes() -> DeformableSystem:
    system = load_system("fishes")
    assert isinstance(system, DeformableSystem)
    return system


def fish_definition(parameters: dict[str, Any]) -> BodyDefinition:
    """The fish that ships, with a table of parameters."""
    file = resources.files("neuroanimator.systems") / "assets" / "fish.toml"
    values = tomllib.loads(file.read_text(encoding="utf-8")) | {"parameters": parameters}
    return BodyDefinition.model_validate(values)


def driven(system: DeformableSystem, count: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """Return random starts (B, S), and controls (B, 5, C)."""
    rng = np.random.default_rng(0)
    return system.sample_starts(rng, count), rng.uniform(-1, 1, (count, 5, system.control.size))


def test_at_nominal_values_it_is_the_body_itself(fishes: DeformableSystem):
    fish = load_system("fish")
    starts, controls = driven(fish)
    nominal = np.tile(fishes.rest[fishes.parameter_entries], (len(starts), 1))
    wanted = fish.simulate(starts, controls, DT).states
    found = fishes.simulate(np.hstack([starts, nominal]), controls, DT).states
    np.testing.assert_allclose(found[..., :-3], wanted, atol=1e-12)
    np.testing.assert_array_equal(found[..., -3:], np.repeat(nominal[:, None], 6, axis=1))


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_each_body_is_the_one_written_down_with_its_numbers(fishes: DeformableSystem):
    """C of one body alone, whose numbers are constants, knows nothing of parameters."""
    starts, controls = driven(fishes)
    family = fishes.simulate_fastest(starts, controls, DT).states
    alone = fishes.simulate_fastest(starts[:1], controls[:1], DT).states
    np.testing.assert_allclose(alone, family[:1], atol=1e-12)
    np.testing.assert_allclose(family, fishes.simulate(starts, controls, DT).states, atol=1e-12)
    body = body_at(fishes.body, starts[0, fishes.parameter_entries])
    twin = c_twin(body, np.float64)
    family_twin = c_twin(fishes.body, np.float64)
    assert twin is not None
    assert family_twin is not None
    for integrator in INTEGRATORS:
        wanted = twin.play(starts[0, :-3], controls[0], integrator, 0.002, 10)
        found = family_twin.play(starts[0], controls[0], integrator, 0.002, 10)
        np.testing.assert_allclose(found[:, :-3], wanted, atol=1e-12, err_msg=integrator)


def test_the_gradient_in_parameters_equals_finite_differences(fishes: DeformableSystem):
    targets = ("body/density_factor", "body/length", "spring/muscle/stiffness", "water/face_drag")
    tables = {chr(97 + i): {"sets": target, "range": [0.1, 9]} for i, target in enumerate(targets)}
    body = body_of(fish_definition(tables))
    starts, controls = driven(fishes, 1)
    parts = fishes.unpack(starts[0])

    @jax.jit
    def work(values: Any) -> Any:
        at = body_at(body, values)
        state = BodyState(*(jnp.asarray(part) for part in parts))
        path = trajectory(at, "symplectic", 0.002, 4, state, jnp.asarray(controls[0]))
        return energy(at, BodyState(*(part[-1] for part in path)))

    with jax.enable_x64(True):
        values = jnp.array([1.1, 0.3, 5.0, 90.0])
        gradient = np.asarray(jax.grad(work)(values))
        steps = np.diag(1e-5 * np.asarray(values))
        differences = [float(work(values + step) - work(values - step)) for step in steps]
    assert (np.abs(gradient) > 0).all()
    np.testing.assert_allclose(gradient, differences / (2 * np.diag(steps)), rtol=1e-5)


def test_every_body_rests_in_its_own_shape(fishes: DeformableSystem):
    """Weight and lift, which rights it, are carried by the springs whatever its parameters are."""
    body = fishes.at(length=0.2, stiffness=1.25, density=0.8)
    positions = fishes.unpack(body.rest)[0]
    assert np.ptp(positions[:, 0]) == pytest.approx(0.2)
    assert np.ptp(positions[:, 1]) == pytest.approx(0.06)
    path = body.simulate(body.rest[None], np.zeros((1, 20, 12)), 0.1).states[0]
    np.testing.assert_allclose(path, np.tile(body.rest, (21, 1)), atol=1e-9)
    parts = {"length": 0.2, "stiffness": 1.25, "density": 0.8}
    np.testing.assert_array_equal(fishes.start_at(parts), body.rest)
    numbers = body_at(fishes.body, body.rest[fishes.parameter_entries])
    assert numbers.masses.sum() == pytest.approx(fishes.body.masses.sum() * 0.2 / 0.26 * 0.8)
    assert np.abs(length_jacobian(numbers)).max() <= 1


def test_a_body_turned_and_given_another_length_is_that_body_turned(fishes: DeformableSystem):
    turned = fishes.start_at({"body.heading": 1.0})
    cloud = fishes.structure.cloud
    assert cloud is not None
    values = np.array([1.0, 0.3, 1.0])
    found = cloud.reshaped(turned, values)
    wanted = fishes.start_at({"body.heading": 1.0, "length": 0.3})
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_starts_are_of_bodies_all_over_the_ranges(fishes: DeformableSystem):
    rng = np.random.default_rng(0)
    for starts in (fishes.sample_starts(rng, 200), fishes.sample_resets(rng, 200)):
        values = starts[:, fishes.parameter_entries]
        for column, parameter in zip(values.T, fishes.parameters, strict=True):
            width = parameter.high - parameter.low
            assert parameter.low <= column.min() < parameter.low + 0.1 * width
            assert parameter.high - 0.1 * width < column.max() <= parameter.high
    assert np.ptp(fishes.kinetic_energies(fishes.sample_starts(rng, 9))) > 0


@pytest.mark.parametrize(
    ("sets", "ends", "message"),
    [
        ("spring/muscles/stiffness", [5, 6], "Did you mean spring/muscle/stiffness"),
        ("body/mass", [0.1, 0.3], "no target called 'body/mass'. Targets: "),
        ("body/length", [0, 0.3], "wanted values above 0, got 0 m"),
        ("body/length", [0.3, 0.4], "around the body's own value, 0.26 m"),
        ("spring/damping_factor", [-1, 2], "wanted values at least 0, got -1"),
        ("spring/stiffness_factor", [0.5, 9], "with p = 9: physics.step: .* Or narrow the range"),
        ("spring/damping_factor", [0.5, 50], "with p = 50: physics.step"),
    ],
)
def test_ranges_without_such_bodies_are_refused_by_name(sets: str, ends: list, message: str):
    with pytest.raises(ArgumentError, match=message):
        DeformableSystem(fish_definition({"p": {"sets": sets, "range": ends}}))


def test_two_parameters_of_one_number_are_refused():
    table = {"sets": "body/length", "range": [0.2, 0.3]}
    with pytest.raises(ArgumentError, match="'p' sets body/length, too"):
        DeformableSystem(fish_definition({"p": table, "q": table}))
