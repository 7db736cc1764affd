"""Emulators of families: parameters stay, have gradients, and are the same in C and in files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from families import parameter_lines, write_arm

from neuroanimator import (
    Emulator,
    NeuroAnimatorError,
    TrainingConfig,
    load_emulator,
    load_system,
    set_backend,
)
from neuroanimator.emulator.networks import make_network
from neuroanimator.emulator.super_step import rollout
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.physics.loading import resolve, trust_files


@pytest.fixture(scope="module")
def family(tmp_path_factory: pytest.TempPathFactory) -> Emulator:
    """An untrained emulator of a family: for laws that hold of any weights."""
    path = write_arm(tmp_path_factory.mktemp("family"), {}, parameter_lines())
    trust_files(path)
    name, definition, substeps = resolve(str(path))
    config = DatasetConfig(
        system=name, definition=definition, substeps=substeps, count=2016, samples_per_run=36
    )
    emulator = build_emulator(simulate_transitions(config), TrainingConfig())
    # As large as those of training, so that parameters do something.
    scale = jnp.ones_like(emulator.normaliser.change_scale)
    return replace(emulator, normaliser=replace(emulator.normaliser, change_scale=scale))


def controls(emulator: Emulator, steps: int = 6) -> np.ndarray:
    drawn = np.random.default_rng(0).uniform(-1, 1, (steps, emulator.control.size))
    return (drawn * emulator.bounds.half).astype(np.float32)


def test_parameters_stay_and_make_a_difference(family: Emulator) -> None:
    light = family.at(mass=0.8)
    held = controls(family)
    motion = light.rollout(light.rest, held)
    entries = list(family.parameter_entries)
    assert [family.state.names[entry] for entry in entries] == [
        "damping[0] N·m·s/rad",
        "gear[0] 1",
        "mass[0] kg",
        "pos[0] m",
    ]
    np.testing.assert_array_equal(motion[:, entries], np.tile(motion[0, entries], (7, 1)))
    other = family.rollout(family.rest, held)
    assert np.abs(motion - other)[1:, :4].max() > 1e-4


def test_an_error_counts_what_moves_alone(family: Emulator) -> None:
    assert family.frame.change_size(family.state.size) == family.state.size - 4
    assert family.normaliser.unit.shape == (family.state.size - 4,)


def test_the_gradient_in_a_parameter_equals_finite_differences(family: Emulator) -> None:
    held = jnp.asarray(controls(family))
    entry = family.parameter_entries[2]

    def end(mass: jax.Array | float) -> jax.Array:
        state = jnp.asarray(family.rest).at[entry].set(mass)
        return rollout(family, state, held)[-1, :4].sum()

    with jax.enable_x64(True):
        gradient = float(jax.grad(end)(1.1))
        step = 1e-5
        difference = float(end(1.1 + step) - end(1.1 - step)) / (2 * step)
    assert abs(gradient) > 1e-4
    assert gradient == pytest.approx(difference, rel=1e-4)


def test_c_and_jax_agree_on_a_family(family: Emulator) -> None:
    held = controls(family)
    start = family.at(mass=1.3, pos=-0.35).rest
    wanted = family.rollout(start, held)
    set_backend("c")
    try:
        found = family.rollout(start, held)
    finally:
        set_backend("jax")
    assert not np.array_equal(found, wanted)  # rounded elsewhere: it was another program
    np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-4)


def test_a_family_comes_back_from_its_file(family: Emulator, tmp_path: Path) -> None:
    path = tmp_path / "arm.emulator.safetensors"
    family.at(gear=1.2).save(path)
    again = Emulator.load(path)
    assert again.parameters == family.at(gear=1.2).parameters
    assert again.parameters[1].nominal == pytest.approx(1.2)
    assert again.parameters[1].low == pytest.approx(0.6)


@pytest.mark.parametrize("kind", ["gated", "mirrored"])
def test_networks_of_families_gate_what_is_even_and_keep_the_mirror(kind: str) -> None:
    even_out = (1, 2) if kind == "mirrored" else ()
    key = jax.random.key(0)
    network = make_network(kind, 4, 3, 5, (6, 4), key, even_out, gates_even=True)
    assert network.widths == (6, 4)
    odd = jnp.array([0.3, -0.2, 0.5, 0.1])
    even = jnp.array([0.4, -0.6, 0.2])
    signs = np.where(np.isin(range(5), even_out), 1, -1)
    np.testing.assert_allclose(network(-odd, even), signs * network(odd, even), rtol=1e-5)
    plain = make_network(kind, 4, 3, 5, (6, 4), None, even_out)
    sizes = [sum(leaf.size for leaf in jax.tree.leaves(one)) for one in (network, plain)]
    assert sizes[0] == sizes[1] + (3 + 1) * 3 + (3 + 1) * 2


def test_bodies_outside_the_family_are_refused(family: Emulator) -> None:
    with pytest.raises(NeuroAnimatorError, match="wanted 0.7 to 1.4 kg, got 3"):
        family.at(mass=3.0)
    with pytest.raises(NeuroAnimatorError, match="Did you mean mass"):
        family.at(mas=1.0)
    with pytest.raises(NeuroAnimatorError, match="No parameter called 'self'"):
        family.at(self=1.0)


def test_the_ends_of_the_ranges_as_their_files_say_them_are_in_the_family() -> None:
    """An emulator has them in single precision."""
    fishes = load_emulator("fishes")
    for parameter in load_system("fishes").parameters:
        for end in (parameter.low, parameter.high):
            body = fishes.at(**{parameter.name: end})
            found = dict(zip([p.name for p in fishes.parameters], body.rest[-3:], strict=True))
            assert found[parameter.name] == pytest.approx(end, rel=1e-6)


def test_a_body_outside_of_the_family_stays_one_and_is_not_trusted(family: Emulator) -> None:
    start = family.rest
    entry = family.parameter_entries[2]
    start[entry] = 9.0
    motion, scores = family.rollout_trusted(start, controls(family))
    np.testing.assert_array_equal(motion[:, entry], 9.0)
    assert (scores > 1).all()


def test_an_emulator_of_mass_points_knows_the_shape_of_each_body(tmp_path: Path) -> None:
    fishes = load_emulator("fishes")
    system = load_system("fishes")
    assert [parameter.name for parameter in fishes.parameters] == ["density", "length", "stiffness"]
    long = fishes.at(length=0.32, density=0.8)
    np.testing.assert_allclose(long.rest, system.at(length=0.32, density=0.8).rest, atol=1e-6)
    # Modes are what is left beside the growth: at rest there is as much of them as in the nominal fish.
    layout = fishes.encoding.layout
    modes = [layout.part(np.asarray(one.encode(one.rest)), "modes") for one in (fishes, long)]
    np.testing.assert_allclose(modes[1], modes[0], atol=1e-6)
    motion = long.rollout(long.rest, controls(fishes))
    np.testing.assert_array_equal(motion[:, -3:], np.tile(motion[0, -3:], (7, 1)))
    length = np.ptp(motion[:, :69:3], axis=1)
    assert (length > 0.29).all()
    long.save(tmp_path / "long.emulator.safetensors")
    again = Emulator.load(tmp_path / "long.emulator.safetensors")
    assert again.parameters == long.parameters
    np.testing.assert_array_equal(again.rollout(again.rest, controls(fishes)), motion)
