"""The emulator keeps what must hold exactly, and its file is whole or refused."""

from __future__ import annotations

import json
import random
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import safetensors.numpy
from swing_up import stand_upright

from neuroanimator import (
    Emulator,
    NeuroAnimatorError,
    TrainingConfig,
)
from neuroanimator.control.descent.defects import no_defects
from neuroanimator.control.descent.parametrisation import EachStep
from neuroanimator.control.descent.problem import Problem
from neuroanimator.emulator.features import Features, sine_cosine
from neuroanimator.emulator.networks import make_network
from neuroanimator.emulator.super_step import rollout
from neuroanimator.files.atomic import METADATA_KEY, _seal
from neuroanimator.files.zoo import SHIPPED, SHIPPED_SYSTEMS, SOFT, WITHOUT_EMULATOR, find_emulator
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.training.initialise import build_emulator


@pytest.fixture(params=["gated", "classic"])
def fresh(request: pytest.FixtureRequest, transitions: Transitions) -> Emulator:
    return build_emulator(transitions, TrainingConfig(network=request.param))


def random_inputs(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    states, controls = rng.normal(size=(count, 6)) * 3, rng.uniform(-1, 1, (count, 3)) * [30, 14, 4]
    return np.float32(states), np.float32(controls)


def test_mirror_symmetry_is_exact(fresh: Emulator):
    states, controls = random_inputs(100)
    step = jax.jit(jax.vmap(fresh.step))
    ahead = np.asarray(step(states, controls))
    mirrored = step(-states, -controls)
    assert np.array_equal(mirrored, -ahead)
    assert np.abs(ahead - states).max() > 1e-3


def test_a_full_turn_of_a_joint_changes_nothing(shipped: Emulator):
    states, controls = random_inputs(100)
    orientation = np.float32([2 * np.pi, -4 * np.pi, 2 * np.pi, 0, 0, 0])
    step = jax.jit(jax.vmap(shipped.step))
    change = np.asarray(step(states, controls)) - states
    turned = np.asarray(step(states + orientation, controls)) - (states + orientation)
    np.testing.assert_allclose(turned, change, atol=2e-4)


def test_sine_and_cosine_are_exact_to_float32():
    angles = jnp.asarray(np.random.default_rng(0).uniform(-300, 300, 20_000), jnp.float32)
    sine, cosine = sine_cosine(angles)
    np.testing.assert_allclose(sine, np.sin(np.asarray(angles, float)), atol=3e-7)
    np.testing.assert_allclose(cosine, np.cos(np.asarray(angles, float)), atol=3e-7)


def test_the_gradient_of_a_motion_equals_finite_differences(fresh: Emulator):
    with jax.enable_x64(True):
        exact = jax.tree.map(
            lambda leaf: jnp.asarray(np.asarray(leaf, float)) if eqx.is_array(leaf) else leaf, fresh
        )
        start, limit = jnp.array([0.3, -0.2, 0.1, 1.0, 0.0, -1.0]), jnp.array([30.0, 14.0, 4.0])
        parametrisation = EachStep(0 * limit, limit, 5)
        objective = jax.tree.map(lambda leaf: leaf.astype(jnp.float64), stand_upright())
        z = np.random.default_rng(0).normal(size=15)
        problem = Problem(exact, objective, parametrisation, start, no_defects(exact, 5), limit)
        cost = eqx.filter_jit(problem.cost)
        gradient = np.asarray(eqx.filter_jit(eqx.filter_grad(problem.cost))(z))
        step = 1e-6
        numeric = [
            float(cost(z + beside) - cost(z - beside)) / (2 * step) for beside in step * np.eye(15)
        ]
        np.testing.assert_allclose(gradient, numeric, rtol=1e-6, atol=1e-6 * np.abs(gradient).max())


@pytest.mark.parametrize("kind", ["glu", "linear-glu", "classic"])
def test_without_a_mirror_symmetry_the_network_is_not_forced_into_one(kind: str):
    features = Features(jnp.eye(2), plain=(1,), is_odd=False)
    network = make_network(
        kind, *features.sizes(1), 2, {"classic": (8,)}.get(kind, (8, 8)), jax.random.key(0)
    )

    def change(state, control):
        return network(*features.streams(state, features.plain_of(state, control)))

    there = change(jnp.array([0.4, 1.0]), jnp.array([0.5]))
    back = change(jnp.array([-0.4, -1.0]), jnp.array([-0.5]))
    assert np.abs(there + back).max() > 1e-3


def test_a_batch_is_the_same_as_its_rows(shipped: Emulator):
    states, _ = random_inputs(5)
    controls = np.random.default_rng(1).uniform(-1, 1, (5, 20, 3)) * [30, 14, 4]
    batch = shipped.rollout(states, controls)
    for row in range(5):
        np.testing.assert_allclose(
            batch[row], shipped.rollout(states[row], controls[row]), rtol=2e-3, atol=2e-3
        )


def test_a_rollout_is_repeated_steps(shipped: Emulator):
    states, controls = random_inputs(6)
    path = rollout(shipped, jnp.asarray(states[0]), jnp.asarray(controls))
    state = states[0]
    for i, control in enumerate(controls):
        state = shipped.step(state, control)
        np.testing.assert_allclose(path[i + 1], state, rtol=1e-4, atol=1e-4)


def test_the_domain_covers_what_training_saw_and_nothing_ten_times_faster(shipped: Emulator):
    state, control = np.array([0, 0, 0, 1.0, 1.0, 1.0]), np.array([10.0, 5.0, 1.0])
    assert shipped.covers(state, control)
    assert not shipped.covers(state * 1000, control)
    assert not shipped.covers(state, control * 10)


@pytest.mark.parametrize(
    ("state", "controls", "message"),
    [
        (np.zeros(5), np.zeros((3, 3)), "state: wanted 6 numbers"),
        (np.zeros(6), np.zeros((3, 4)), "controls: wanted 3 numbers"),
        (np.zeros(6), np.zeros(3), "state and controls"),
        (np.zeros((2, 6)), np.zeros((3, 4, 3)), "state and controls"),
        (np.full(6, np.nan), np.zeros((3, 3)), "not finite"),
        (np.zeros(6), np.full((3, 3), np.inf), "not finite"),
    ],
)
def test_wrong_shapes_and_numbers_are_refused(shipped: Emulator, state, controls, message: str):
    with pytest.raises(NeuroAnimatorError, match=message):
        shipped.rollout(state, controls)


def test_saving_and_loading_changes_no_bit(fresh: Emulator, tmp_path: Path):
    fresh.save(tmp_path / "a.safetensors")
    again = Emulator.load(tmp_path / "a.safetensors")
    again.save(tmp_path / "b.safetensors")
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    states, controls = random_inputs(10)
    assert np.array_equal(
        jax.jit(jax.vmap(fresh.step))(states, controls),
        jax.jit(jax.vmap(again.step))(states, controls),
    )


def test_f07_a_truncated_or_flipped_file_is_refused(tmp_path: Path):
    raw = find_emulator("pendulum-passive-50").read_bytes()
    path = tmp_path / "broken.safetensors"
    cuts = [*range(64), *random.Random(0).sample(range(64, len(raw)), 60)]
    flips = range(0, len(raw), 331)
    for broken in [raw[:cut] for cut in cuts] + [_flip(raw, position) for position in flips]:
        path.write_bytes(broken)
        with pytest.raises(NeuroAnimatorError, match="broken.safetensors"):
            Emulator.load(path)


def _flip(raw: bytes, position: int) -> bytes:
    return raw[:position] + bytes([raw[position] ^ 4]) + raw[position + 1 :]


def _tampered(change) -> bytes:
    """Return a shipped emulator with its metadata changed and sealed again, as an attacker would."""
    raw = find_emulator("pendulum-passive-50").read_bytes()
    length = int.from_bytes(raw[:8], "little")
    metadata = json.loads(json.loads(raw[8 : 8 + length])["__metadata__"][METADATA_KEY])
    change(metadata)
    metadata["sha256"] = _seal(safetensors.numpy.load(raw), metadata)
    return safetensors.numpy.save(safetensors.numpy.load(raw), {METADATA_KEY: json.dumps(metadata)})


@pytest.mark.parametrize(
    "change",
    [
        lambda m: m.update(format=99),
        lambda m: m.update(kind="shard"),
        lambda m: m.pop("state"),
        lambda m: m["network"].update(widths=[10**9, 64]),
        lambda m: m["network"].update(kind="../../x"),
        lambda m: m["network"].update(widths=[64]),
        lambda m: m["features"].update(plain=[99]),
        lambda m: m["skeleton"].append({"name": "x"}),
        lambda m: m.update(dt=[1]),
        lambda m: m.update(bounds=[[], []]),
        lambda m: m.update(rest=[0.0]),
        lambda m: m["frame"].update(segments=[["plain", 5, -1, 0.0]]),
        lambda m: m["frame"].update(segments=[["wormhole", 6, -1, 0.0]]),
        lambda m: m["frame"].update(segments=[["constant", 6, -1, 0.0]]),
        lambda m: m["frame"].update(segments=[["plain", 5, -1, 0.0], ["constant", 1, -1, 0.0]]),
        lambda m: m["frame"].update(probes=[[0, 0, 0, 1]]),
        lambda m: m["frame"].update(segments=[["points", 6, -1, 0.0]]),
        lambda m: m["features"].update(even=[2, 1]),
        lambda m: m.update(modes={"cloud": [[], []]}),
    ],
)
def test_f08_a_file_that_lies_about_itself_is_refused(change, tmp_path: Path):
    path = tmp_path / "hostile.safetensors"
    path.write_bytes(_tampered(change))
    with pytest.raises(NeuroAnimatorError, match="hostile.safetensors"):
        Emulator.load(path)


def test_a_crowded_repeating_or_deep_header_is_refused(tmp_path: Path):
    path = tmp_path / "hostile.safetensors"
    many = {f"t{i}": np.zeros(1, np.float32) for i in range(300)}
    path.write_bytes(safetensors.numpy.save(many, {METADATA_KEY: "{}"}))
    with pytest.raises(NeuroAnimatorError, match="300 tensors"):
        Emulator.load(path)
    header = b'{"__metadata__":{"na":"{}"},"a":{},"a":{}}'
    path.write_bytes(len(header).to_bytes(8, "little") + header)
    with pytest.raises(NeuroAnimatorError, match="hostile.*occurs twice"):
        Emulator.load(path)
    deep = b'{"a":' + b"[" * 100_000
    path.write_bytes(len(deep).to_bytes(8, "little") + deep)
    with pytest.raises(NeuroAnimatorError, match="hostile"):
        Emulator.load(path)


def test_a_missing_file_names_what_ships():
    with pytest.raises(
        NeuroAnimatorError, match="Shipped: cape-40, dolphin-100, dolphin-25, dolphin-50"
    ):
        find_emulator("nowhere")


@pytest.mark.parametrize("name", ["cube", "cube-50", "cube-100"])
def test_a_system_none_ships_of_says_how_to_make_one(name: str):
    advice = "no emulator of cube ships.*neuroanimator train cube --out"
    with pytest.raises(NeuroAnimatorError, match=advice):
        find_emulator(name)


def test_every_system_has_shipped_emulators_or_is_said_to_have_none():
    with_emulators = {system for system, _ in [*SHIPPED, *SOFT]}
    assert with_emulators.isdisjoint(WITHOUT_EMULATOR)
    assert with_emulators.union(WITHOUT_EMULATOR) == set(SHIPPED_SYSTEMS)
