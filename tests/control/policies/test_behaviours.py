"""Bodies in company: nobody is run into, nobody dives steeply, and the glass is kept off."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import load_policy, load_system
from neuroanimator.control.policies.behaviours import (
    Tank,
    give_way,
    keep_apart,
    limit_angles,
    prioritise,
    shoal,
)
from neuroanimator.control.policies.closed_loop import rollout_on_emulator
from neuroanimator.state.pose import Pose

LENGTH = 0.26

# Compiled as wholes: operation by operation it takes ten times as long.
apart_force = jax.jit(keep_apart, static_argnums=1)
way_given = jax.jit(give_way, static_argnums=1)
limited_force = jax.jit(limit_angles, static_argnames=("max_climb", "max_turn"))


def poses(positions: list, headings: list[float], speed: float = 0.1) -> Pose:
    forward = np.array([[np.cos(angle), np.sin(angle), 0.0] for angle in headings])
    up = np.tile([0.0, 0.0, 1.0], (len(headings), 1))
    return Pose(
        *(jnp.asarray(part) for part in (np.array(positions, float), speed * forward, forward, up))
    )


def test_bodies_that_stay_far_apart_do_not_mind_each_other():
    pose = poses([[0, 0, 0], [0, 2, 0]], [0.0, 0.0])
    np.testing.assert_allclose(apart_force(pose, 0.5), 0, atol=1e-6)
    np.testing.assert_allclose(way_given(pose, 0.5), 1, atol=1e-6)


def test_the_nearer_the_stronger_and_away_from_each_other():
    near, nearer = (
        np.asarray(apart_force(poses([[0, 0, 0], [0, gap, 0]], [0.0, 0.0]), 0.5))
        for gap in (0.4, 0.1)
    )
    assert near[0, 1] < 0 < near[1, 1]
    assert np.linalg.norm(nearer[0]) > 2 * np.linalg.norm(near[0])


def test_bodies_about_to_meet_begin_to_turn_early_and_give_way_to_the_same_side():
    pose = poses([[0, 0, 0], [0.6, 0, 0]], [0.0, np.pi])
    force = np.asarray(apart_force(pose, 0.3))
    assert force[0, 1] > 0.1
    assert force[1, 1] < -0.1
    parting = poses([[0, 0, 0], [0.6, 0, 0]], [np.pi, 0.0])
    np.testing.assert_allclose(apart_force(parting, 0.3), 0, atol=1e-6)


def test_who_is_behind_slows_down_and_who_is_ahead_does_not():
    kept = np.asarray(way_given(poses([[0, 0, 0], [0.2, 0, 0]], [0.0, 0.0]), 0.5))
    assert kept[0] < 0.8
    assert kept[1] == pytest.approx(1)


def test_what_is_urgent_comes_first():
    urgent, other = jnp.array([[0.0, 1, 0], [0, 0.25, 0], [0, 0, 0]]), jnp.array([[3.0, 0, 0]] * 3)
    np.testing.assert_allclose(
        prioritise(urgent, other), [[0, 1, 0], [0.75, 0.25, 0], [1, 0, 0]], atol=1e-5
    )


def test_a_limited_force_is_neither_steep_nor_sharp():
    pose = poses([[0, 0, 0]] * 64, list(np.linspace(-3, 3, 64)))
    force = jnp.asarray(np.random.default_rng(0).normal(size=(64, 3)) * 10)
    limited = np.asarray(limited_force(force, pose, max_climb=0.3, max_turn=0.7))
    np.testing.assert_allclose(np.linalg.norm(limited, axis=1), 1, rtol=1e-4)
    assert np.abs(np.arcsin(limited[:, 2])).max() < 0.3 + 1e-4
    flat = limited[:, :2] / np.linalg.norm(limited[:, :2], axis=1, keepdims=True)
    assert (
        np.arccos(np.clip(np.sum(flat * np.asarray(pose.forward[:, :2]), axis=1), -1, 1)).max()
        < 0.7 + 1e-2
    )
    vertical = limited_force(jnp.array([[0.0, 0, 5]]), poses([[0, 0, 0]], [1.0]))
    assert np.arctan2(vertical[0, 1], vertical[0, 0]) == pytest.approx(1.0, abs=1e-4)


def test_a_school_keeps_its_distance_stays_level_and_in_its_tank():
    policy, system = load_policy("fish"), load_system("fish")
    tank = Tank((-1.2, -1.2, -0.7), (1.2, 1.2, 0.7))
    corners = np.mgrid[-0.6:0.61:0.4, -0.4:0.41:0.4, 0:1].reshape(3, -1).T
    starts = np.tile(system.rest, (len(corners), 1))
    starts[:, :69] += np.tile(corners, 23)
    behaviour = shoal(tank, length=LENGTH, speed=0.9 * policy.ranges.high[0])
    lives = np.asarray(
        rollout_on_emulator(policy, behaviour, starts, round(20.0 / policy.dt)), float
    )
    pose = policy.pose(np.asarray(policy.emulator.encode(lives)))
    apart = np.linalg.norm(pose.position[:, None] - pose.position[None], axis=-1)
    apart[np.arange(len(starts)), np.arange(len(starts))] = np.inf
    assert (apart.min(axis=(0, 1)) < LENGTH / 2).mean() < 0.02
    assert np.percentile(np.degrees(np.abs(np.arcsin(pose.forward[..., 2]))), 99) < 35
    assert (np.abs(pose.position) < np.array(tank.high) + LENGTH).all()
    way = np.linalg.norm(np.diff(pose.position, axis=1), axis=-1).sum(axis=1)
    assert way.min() > 20.0 * 0.25 * LENGTH
