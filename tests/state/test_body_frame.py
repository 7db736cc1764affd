"""The body's own frame: place and heading change nothing, quaternions stay of unit length."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from neuroanimator import DatasetConfig, Emulator, TrainingConfig, load_system
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.rotation import (
    facing,
    heading_of,
    multiply,
    rotate,
    rotate_back,
    rotated_by,
    rotation_between,
    rotation_matrices,
)
from neuroanimator.state.segments import Heading, Plain, PlanarPosition, PlanarVelocity
from neuroanimator.systems.system import System

PLANAR = (
    PlanarPosition(rate=4),
    Heading(rate=6),
    Plain(size=1),
    PlanarVelocity(),
    Plain(size=2),
)


@pytest.fixture(scope="module", params=["truck", "lander"])
def fresh(request: pytest.FixtureRequest) -> Emulator:
    data = simulate_transitions(DatasetConfig(system=request.param, count=612, samples_per_run=36))
    return build_emulator(data, TrainingConfig(widths=(24, 16)))


def quaternions(rng: np.random.Generator, count: int) -> np.ndarray:
    found = rng.normal(size=(count, 4))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def random_states(system: System, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    states = sample_starts(system, rng, count)
    states[:, :2] = rng.uniform(-5, 5, (count, 2))
    return states, system.bounds.middle + rng.uniform(
        -1, 1, (count, system.control.size)
    ) * system.bounds.half


def moved(system: System, states: np.ndarray, heading: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Return the same states in a world turned about the vertical and shifted."""
    turned = np.array(states, float)
    speed = system.state.index("root.velocity")
    turned[:, :3] = rotate(heading, turned[:, :3]) + shift
    turned[:, 3:7] = multiply(heading, turned[:, 3:7])
    turned[:, speed] = rotate(heading, turned[:, speed])
    return turned


def test_turning_and_moving_the_world_changes_a_prediction_by_less_than_1e_5(fresh: Emulator):
    system, rng = load_system(fresh.system), np.random.default_rng(1)
    states, controls = random_states(system, 200)
    heading = facing(rng.uniform(-np.pi, np.pi, 200))
    shift = np.concatenate([rng.uniform(-10, 10, (200, 2)), np.zeros((200, 1))], axis=1)
    step = jax.jit(jax.vmap(fresh.step))
    controls = np.float32(controls)
    here = moved(system, np.asarray(step(np.float32(states), controls)), heading, shift)
    there = step(np.float32(moved(system, states, heading, shift)), controls)
    assert np.abs(np.asarray(there) - here).max() < 1e-5
    assert np.abs(here - moved(system, states, heading, shift)).max() > 1e-2  # something did happen


def test_gravity_is_not_turned_away(fresh: Emulator):
    """Tipping the world over is no symmetry: the prediction must change."""
    system = load_system(fresh.system)
    states, controls = random_states(system, 50)
    tipped = np.array(states)
    tipped[:, 3:7] = multiply(
        np.broadcast_to([np.sqrt(0.5), np.sqrt(0.5), 0, 0], (50, 4)), states[:, 3:7]
    )
    seen = eqx.filter_jit(fresh.raw_features_of)
    local = [np.asarray(seen(np.float32(s), np.float32(controls))) for s in (states, tipped)]
    assert np.abs(local[0] - local[1]).max() > 0.5


def test_quaternions_stay_of_unit_length(fresh: Emulator):
    system = load_system(fresh.system)
    states, _ = random_states(system, 20)
    controls = system.bounds.middle + np.zeros((20, 200, system.control.size))
    path = np.asarray(fresh.rollout(states, controls))
    np.testing.assert_allclose(np.linalg.norm(path[..., 3:7], axis=-1), 1, atol=3e-7)


@pytest.mark.parametrize("name", ["truck", "lander", "pendulum"])
def test_applying_the_remainder_leads_from_state_to_state(name: str):
    system = load_system(name)
    frame = Frame.of(system.structure, 0.1)
    rng = np.random.default_rng(2)
    before, after = system.sample_starts(rng, 50), system.sample_starts(rng, 50)
    found = frame.apply(before, frame.remainder(before, after))
    assert np.abs(frame.difference(after, found)).max() < 1e-9
    assert np.abs(frame.difference(before, before)).max() < 1e-12


def test_a_planar_root_is_the_same_wherever_it_heads():
    frame, rng = Frame(PLANAR, (), 0.1), np.random.default_rng(3)
    before, after, orientation = (
        rng.normal(size=(30, 8)),
        rng.normal(size=(30, 8)),
        rng.uniform(-3, 3, 30),
    )

    def turned(states: np.ndarray) -> np.ndarray:
        states = np.array(states)
        cosine, sine = np.cos(orientation), np.sin(orientation)
        for x in (0, 4):
            states[:, x], states[:, x + 1] = (
                cosine * states[:, x] - sine * states[:, x + 1],
                sine * states[:, x] + cosine * states[:, x + 1],
            )
        states[:, 2] += orientation
        return states

    np.testing.assert_allclose(
        frame.remainder(turned(before), turned(after)), frame.remainder(before, after), atol=1e-9
    )
    np.testing.assert_allclose(frame.local(turned(before)), frame.local(before), atol=1e-9)
    np.testing.assert_allclose(
        frame.apply(before, frame.remainder(before, after)), after, atol=1e-9
    )


def test_rotations_are_mujocos():
    rng = np.random.default_rng(4)
    left, right, vectors = quaternions(rng, 20), quaternions(rng, 20), rng.normal(size=(20, 3))
    for a, b, vector in zip(left, right, vectors, strict=True):
        product, turned, matrix = np.empty(4), np.empty(3), np.empty(9)
        mujoco.mju_mulQuat(product, a, b)
        mujoco.mju_rotVecQuat(turned, vector, a)
        mujoco.mju_quat2Mat(matrix, a)
        np.testing.assert_allclose(multiply(a, b), product, atol=1e-12)
        np.testing.assert_allclose(rotate(a, vector), turned, atol=1e-12)
        np.testing.assert_allclose(rotate_back(a, turned), vector, atol=1e-12)
        np.testing.assert_allclose(rotation_matrices(a).ravel(), matrix, atol=1e-12)


def test_turns_are_undone_and_small_ones_are_rotation_vectors():
    rng = np.random.default_rng(5)
    start, orientation = quaternions(rng, 50), rng.normal(size=(50, 3))
    np.testing.assert_allclose(
        rotation_between(start, rotated_by(start, orientation)), orientation, atol=1e-9
    )
    small = 1e-4 * orientation
    for quaternion, vector in zip(start, small, strict=True):
        integrated = quaternion.copy()
        mujoco.mju_quatIntegrate(integrated, vector, 1.0)
        np.testing.assert_allclose(rotated_by(quaternion, vector), integrated, atol=1e-11)
    heading = rng.uniform(-3, 3, 50)
    np.testing.assert_allclose(heading_of(facing(heading)), heading, atol=1e-12)


def test_the_gradient_through_the_frame_equals_finite_differences(fresh: Emulator):
    system = load_system(fresh.system)
    states, controls = random_states(system, 1)
    with jax.enable_x64(True):
        exact = jax.tree.map(
            lambda leaf: jnp.asarray(np.asarray(leaf, float)) if eqx.is_array(leaf) else leaf, fresh
        )
        start, scale = jnp.asarray(states[0]), jnp.asarray(system.bounds.half)

        @jax.jit
        def cost(share):
            return jnp.sum(exact.step(start, share * scale)[:7] ** 2)

        point = controls[0] / system.bounds.half * 0.5
        gradient, step = np.asarray(jax.grad(cost)(point)), 1e-6
        for i, beside in enumerate(step * np.eye(len(point))):
            numeric = (cost(point + beside) - cost(point - beside)) / (2 * step)
            np.testing.assert_allclose(gradient[i], numeric, rtol=1e-4, atol=1e-9)
