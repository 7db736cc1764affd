"""Clips pass through the emulated states and look like the physics between them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from neuroanimator import Emulator, NeuroAnimatorError, load_system, make_clip
from neuroanimator.animation.interpolate import interpolate_hermite, interpolate_linear
from neuroanimator.animation.motion import random_drive
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.rotation import rotation_matrices

RATES = ((0, 3), (1, 4), (2, 5))


def test_hermite_is_closer_to_the_physics_than_straight_lines():
    system, rng = load_system("pendulum"), np.random.default_rng(0)
    controls = np.repeat(rng.uniform(-0.5, 0.5, (1, 20, 3)) * system.bounds.half, 10, axis=1)
    fine = system.simulate(system.sample_starts(rng, 1), controls, 0.005).states[0]
    coarse, times = fine[::10], np.arange(len(fine)) * 0.005
    errors = {
        between.__name__: np.sqrt(np.mean((between(coarse, 0.05, times, RATES) - fine)[:, :3] ** 2))
        for between in (interpolate_linear, interpolate_hermite)
    }
    assert errors["interpolate_hermite"] < 0.2 * errors["interpolate_linear"]


def test_both_pass_through_the_given_states():
    states, times = np.random.default_rng(0).normal(size=(6, 6)), np.arange(6) * 0.1
    for between in (interpolate_linear, interpolate_hermite):
        np.testing.assert_allclose(between(states, 0.1, times, RATES), states, atol=1e-12)


def test_hermite_is_exact_for_a_cubic_and_its_velocity():
    times, fine = np.arange(5) * 0.5, np.linspace(0, 2, 41)

    def cubic(t):
        return np.stack([t**3 - t, 3 * t**2 - 1], axis=1)

    np.testing.assert_allclose(
        interpolate_hermite(cubic(times), 0.5, fine, ((0, 1),)), cubic(fine), atol=1e-12
    )


@pytest.mark.parametrize("rate", [7.0, 24.0, 30.0, 60.0, 240.0])
def test_a_clip_has_the_display_rate_asked_for(rate: float, shipped: Emulator):
    clip = make_clip(shipped, random_drive(shipped, 2.0, seed=0).motion(shipped), rate=rate)
    assert clip.rate == pytest.approx(rate)
    assert len(clip.times) == round(2 * rate) + 1
    assert np.isfinite(clip.states).all()


@pytest.mark.parametrize("name", ["pendulum", "truck", "lander"])
def test_the_skeleton_stands_where_mujoco_puts_the_bodies(name: str):
    system, rng = load_system(name), np.random.default_rng(0)
    assert isinstance(system, MujocoSystem)
    states = system.sample_starts(rng, 20)
    bodies = [system.model.body(bone.name).id for bone in system.skeleton.bones]
    data = mujoco.MjData(system.model)
    for state, positions, orientations in zip(
        states, *system.skeleton.world_poses(states), strict=True
    ):
        system.put(data, state)
        mujoco.mj_forward(system.model, data)
        np.testing.assert_allclose(positions, data.xpos[bodies], atol=1e-9)
        np.testing.assert_allclose(
            rotation_matrices(orientations).reshape(-1, 9), data.xmat[bodies], atol=1e-9
        )


def test_links_stay_joined_and_of_their_length(shipped: Emulator):
    positions, _ = shipped.skeleton.world_poses(random_drive(shipped, 5.0, seed=1).motion(shipped))
    np.testing.assert_allclose(np.linalg.norm(np.diff(positions, axis=1), axis=-1), 0.5, atol=1e-9)


def test_bad_arguments_are_refused_by_name(shipped: Emulator):
    motion = random_drive(shipped, 1.0, seed=0).motion(shipped)
    with pytest.raises(NeuroAnimatorError, match="Interpolations: hermite, linear"):
        make_clip(shipped, motion, interpolation="spline")
    with pytest.raises(NeuroAnimatorError, match="rate: wanted between 0"):
        make_clip(shipped, motion, rate=0)
    with pytest.raises(NeuroAnimatorError, match="seconds"):
        random_drive(shipped, 0.0, seed=0).motion(shipped)
