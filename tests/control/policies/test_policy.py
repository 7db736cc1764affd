"""Policies obey commands on the true physics, whatever the place, the heading and the side."""

from __future__ import annotations

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.typing import ArrayLike

from neuroanimator import load_emulator, load_system
from neuroanimator.control.policies.behaviours import (
    Tank,
    pursue,
    school,
    stay_inside,
    steer_along,
    wander,
)
from neuroanimator.control.policies.closed_loop import rollout_on_emulator, rollout_on_physics
from neuroanimator.control.policies.policy import Policy, fresh_policy
from neuroanimator.control.policies.steering import (
    SteeringTarget,
    command_toward,
    leftward,
    steer_down,
    steer_forward,
    steer_left,
    unit,
)
from neuroanimator.emulator.pca import reflection
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.files.zoo import POLICIES, find_emulator, find_policy, shipped_policy
from neuroanimator.gym.policy_training import (
    PolicyTraining,
    command_ranges,
    draw_starts,
    train_policy,
)
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.state.layout import Bounds
from neuroanimator.state.pose import Pose
from neuroanimator.state.reference_shape import flat_of, points_of
from neuroanimator.state.rotation import facing, to_world_axes
from neuroanimator.state.structure import mixing

SECONDS = 6.0
"""As long as a fish needs to turn a third of a circle and to be back at its speed."""


@pytest.fixture(scope="module")
def policy() -> Policy:
    return Policy.load(find_policy("fish"))


@pytest.fixture(scope="module")
def fish() -> DeformableSystem:
    system = load_system("fish")
    assert isinstance(system, DeformableSystem)
    return system


@pytest.fixture(scope="module")
def starts(fish: DeformableSystem) -> np.ndarray:
    """(8, S) unseen in training."""
    return sample_starts(fish, np.random.default_rng(12345), 8)


@eqx.filter_jit
def control_rows(
    policy: Policy, latent: np.ndarray, phases: np.ndarray, commands: np.ndarray
) -> jax.Array:
    """Return the controls of each row, compiled as a whole."""
    return jax.vmap(policy.control)(latent, phases, commands)


def controls_of(
    policy: Policy, states: np.ndarray, phase: float, commands: ArrayLike
) -> np.ndarray:
    latent = np.float32(policy.emulator.encode(np.asarray(states, float)))
    phases = np.full(len(states), phase, np.float32)
    return np.asarray(control_rows(policy, latent, phases, np.float32(commands)))


def random_commands(policy: Policy, rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(policy.ranges.low, policy.ranges.high, (count, 4))


def moved(states: np.ndarray, heading: float, shift: np.ndarray) -> np.ndarray:
    """Return the fish of `states` (B, S) turned about the vertical and moved."""
    positions, velocities = points_of(states[:, :69]), points_of(states[:, 69:138])
    quaternion = facing(np.full(len(states), heading))
    parts = (
        flat_of(to_world_axes(quaternion, positions) + shift),
        flat_of(to_world_axes(quaternion, velocities)),
        states[:, 138:],
    )
    return np.concatenate(parts, axis=1)


def steering_error(
    policy: Policy, states: np.ndarray, target: SteeringTarget
) -> tuple[np.ndarray, np.ndarray]:
    """Return (speed (B,) [m/s], angle off course (B,) [rad]) over the last two periods of `states` (B, T+1, S)."""
    pose = policy.pose(np.asarray(policy.emulator.encode(states[:, -12:])))
    speed = np.sum(pose.velocity * pose.forward, axis=-1).mean(axis=1)
    cosine = np.sum(unit(pose.forward.mean(axis=1)) * np.asarray(target.direction), axis=-1)
    return speed, np.arccos(np.clip(cosine, -1, 1))


@pytest.mark.parametrize("size", [1.0, 1e3, 1e6])
def test_controls_stay_within_bounds_whatever_comes(policy: Policy, size: float):
    rng = np.random.default_rng(0)
    latent_size = len(policy.emulator.encode(policy.emulator.rest))
    latent = np.float32(rng.normal(size=(64, latent_size)) * size)
    commands = np.float32(rng.normal(size=(64, 4)) * size)
    found = np.asarray(control_rows(policy, latent, np.arange(64, dtype=np.float32), commands))
    bounds = policy.emulator.bounds
    assert ((found >= np.array(bounds.low)) & (found <= np.array(bounds.high))).all()
    assert np.ptp(found) > 0.5


def test_moving_and_turning_the_world_changes_no_muscle(policy: Policy, starts: np.ndarray):
    commands = random_commands(policy, np.random.default_rng(1), len(starts))
    here = controls_of(policy, starts, 0.7, commands)
    there = controls_of(policy, moved(starts, 1.9, np.array([3.0, -2.0, 0.5])), 0.7, commands)
    np.testing.assert_allclose(there, here, atol=2e-3)


def test_the_command_toward_a_target_turns_with_the_world(policy: Policy, starts: np.ndarray):
    pose = policy.pose(np.asarray(policy.emulator.encode(starts)))
    target = steer_left(pose, 0.8, 0.1)
    elsewhere = policy.pose(
        np.asarray(policy.emulator.encode(moved(starts, 1.9, np.array([3.0, -2.0, 0.5]))))
    )
    turned_target = steer_left(elsewhere, 0.8, 0.1)
    np.testing.assert_allclose(
        command_toward(turned_target, elsewhere), command_toward(target, pose), atol=1e-4
    )
    np.testing.assert_allclose(
        command_toward(target, pose)[:, :3], np.tile([0.1, 0.8, 0.0], (len(starts), 1)), atol=2e-3
    )


def test_a_dive_points_below_a_level_body():
    pose = Pose(*(np.array([row], float) for row in ([0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 0, 1])))
    assert steer_down(pose, 0.5, 0.1).direction[0, 2] == pytest.approx(-np.sin(0.5), abs=1e-5)
    assert command_toward(steer_down(pose, 0.5, 0.1), pose)[0, 2] == pytest.approx(-0.5, abs=1e-3)


def test_the_mirrored_fish_does_the_mirrored_thing(
    policy: Policy, fish: DeformableSystem, starts: np.ndarray
):
    mirror = fish.structure.mirror
    assert mirror is not None
    swap = reflection(mirror)
    image = np.concatenate(
        [
            starts[:, :69] @ swap.T,
            starts[:, 69:138] @ swap.T,
            starts[:, 138:][:, list(mirror.controls)],
        ],
        axis=1,
    )
    commands = random_commands(policy, np.random.default_rng(2), len(starts))
    found = controls_of(policy, starts, 0.4, commands)
    mirrored = controls_of(policy, image, 0.4 + np.pi, commands * [1, -1, 1, -1])
    np.testing.assert_allclose(mirrored, found[:, list(mirror.controls)], atol=2e-3)
    assert mixing(mirror.controls)[1] == 6


def test_on_the_true_physics_it_swims_faster_when_told_to(policy: Policy, fish: DeformableSystem):
    starts = np.tile(fish.rest, (3, 1))
    pose = policy.pose(np.asarray(policy.emulator.encode(starts)))
    target = steer_forward(pose, np.array([0.04, 0.08, 0.12]))
    runs, _ = rollout_on_physics(policy, fish, starts, target, round(SECONDS / policy.dt))
    speed, off = steering_error(policy, runs.states, target)
    assert not runs.has_diverged.any()
    assert (np.diff(speed) > 0.02).all()
    np.testing.assert_allclose(speed, target.speed, atol=0.02)
    assert np.degrees(off).max() < 12


@pytest.mark.parametrize("angle", [np.pi / 3, -np.pi / 3])
def test_on_the_true_physics_it_turns_left_or_right_as_told(
    policy: Policy, fish: DeformableSystem, angle: float
):
    pose = policy.pose(np.asarray(policy.emulator.encode(fish.rest[None])))
    target = steer_left(pose, angle, 0.08)
    runs, _ = rollout_on_physics(policy, fish, fish.rest[None], target, round(SECONDS / policy.dt))
    after = policy.pose(np.asarray(policy.emulator.encode(runs.states[:, -12:]))).forward.mean(
        axis=1
    )
    assert np.sign(np.sum(after * np.asarray(leftward(pose)))) == np.sign(angle)
    assert np.degrees(steering_error(policy, runs.states, target)[1][0]) < 15


def test_on_the_true_physics_most_targets_are_found_from_anywhere(
    policy: Policy, fish: DeformableSystem, starts: np.ndarray
):
    pose = policy.pose(np.asarray(policy.emulator.encode(starts)))
    target = steer_left(pose, np.linspace(-1.5, 1.5, len(starts)), 0.08)
    runs, _ = rollout_on_physics(policy, fish, starts, target, round(SECONDS / policy.dt))
    assert np.degrees(np.median(steering_error(policy, runs.states, target)[1])) < 10


def test_a_policy_survives_its_file(policy: Policy, tmp_path: Path, starts: np.ndarray):
    first, second = tmp_path / "a.policy.safetensors", tmp_path / "b.policy.safetensors"
    policy.save(first)
    again = Policy.load(first)
    again.save(second)
    assert first.read_bytes() == second.read_bytes()
    commands = random_commands(policy, np.random.default_rng(3), len(starts))
    np.testing.assert_array_equal(
        controls_of(again, starts, 0.2, commands), controls_of(policy, starts, 0.2, commands)
    )


def test_a_policy_that_is_not_given_parameters_does_the_same_for_all_and_survives_its_file(
    policy: Policy, tmp_path: Path
):
    family = load_emulator("fishes")
    latent = np.tile(np.float32(family.encode(family.rest)), (2, 1))
    latent[1, -len(family.parameter_entries) :] *= 1.2
    commands = random_commands(policy, np.random.default_rng(6), 1).repeat(2, axis=0)
    found = {}
    for is_given in (True, False):
        made = fresh_policy(family, policy.ranges, (8,), observes_parameters=is_given)
        made.save(tmp_path / "a.policy.safetensors")
        for one in (made, Policy.load(tmp_path / "a.policy.safetensors")):
            controls = control_rows(one, latent, np.zeros(2, np.float32), np.float32(commands))
            found.setdefault(is_given, []).append(np.asarray(controls))
    np.testing.assert_array_equal(found[False][0][0], found[False][0][1])
    assert (found[True][0][0] != found[True][0][1]).any()
    for made, read in found.values():
        np.testing.assert_array_equal(made, read)


@pytest.mark.parametrize("name", POLICIES)
def test_shipped_policies_load_and_are_small(name: str):
    emulator = Policy.load(find_policy(name)).emulator
    assert emulator.system == name
    size = shipped_policy(name).stat().st_size
    if emulator.skeleton.shapes is None:
        assert size <= 300_000
    else:
        alone = find_emulator(name).stat().st_size
        assert alone < size <= alone + 75_000


def test_a_policy_that_does_not_ship_is_refused_with_the_names():
    with pytest.raises(
        BadFileError, match="^No policy file 'whale', .* Shipped: dolphin, fish, trout, orca.$"
    ):
        find_policy("whale")


FORGERIES = {
    "another format": lambda metadata: metadata | {"format": 99},
    "another version": lambda metadata: (
        metadata | {"emulator": metadata["emulator"] | {"format": 1}}
    ),
    "commands with another meaning": lambda metadata: (
        metadata | {"command": [["speed", 1, "knots"]]}
    ),
    "sizes out of range": lambda metadata: metadata | {"widths": [10**9]},
    "no layers": lambda metadata: metadata | {"widths": []},
    "no numbers": lambda metadata: metadata | {"ranges": "fast"},
    "low above high": lambda metadata: metadata | {"ranges": metadata["ranges"][::-1]},
    "no emulator": lambda metadata: metadata | {"emulator": 3},
    "another emulator": lambda metadata: metadata | {"emulator_sha256": "0" * 64},
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forged_file_is_refused_in_one_line(name: str, tmp_path: Path):
    tensors, metadata = read_tensors(find_policy("fish"), "policy")
    path = tmp_path / "forged.policy.safetensors"
    write_tensors(path, tensors, FORGERIES[name](metadata))
    with pytest.raises(BadFileError) as caught:
        Policy.load(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("position", [5, 3_000, -4])
def test_a_damaged_file_is_refused_in_one_line(position: int, tmp_path: Path):
    raw = bytearray(find_policy("fish").read_bytes())
    raw[position] ^= 0x55
    path = tmp_path / "damaged.policy.safetensors"
    path.write_bytes(raw)
    with pytest.raises(BadFileError) as caught:
        Policy.load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("fault", ["weights", "scale"])
def test_a_policy_whose_controls_are_not_finite_is_refused(
    fault: str, policy: Policy, tmp_path: Path
):
    path = tmp_path / "wild.policy.safetensors"
    wild = policy
    if fault == "weights":
        huge = jax.tree.map(lambda leaf: np.full(np.shape(leaf), 3e37, np.float32), policy.network)
        wild = eqx.tree_at(lambda one: one.network, policy, huge)
    else:
        scale = np.zeros_like(np.asarray(policy.emulator.normaliser.plain_scale))
        wild = eqx.tree_at(lambda one: one.emulator.normaliser.plain_scale, policy, scale)
    wild.save(path)
    with pytest.raises(BadFileError, match="is not a usable policy"):
        Policy.load(path)


def test_an_emulator_is_no_policy():
    with pytest.raises(BadFileError, match="it says it is a 'emulator'"):
        Policy.load(find_emulator("fish"))


def test_a_system_that_cannot_point_anywhere_gets_no_policy(policy: Policy):
    with pytest.raises(ArgumentError, match="free root or mass points"):
        fresh_policy(load_emulator("pendulum"), policy.ranges, (8, 8))


def test_a_body_without_left_and_right_or_gait_gets_a_policy_too():
    lander = load_emulator("lander")
    policy = fresh_policy(lander, Bounds((0.0, -1.5, -1.5, -1.5), (5.0, 1.5, 1.5, 1.5)), (8, 8))
    states = np.tile(lander.rest, (2, 1))
    found = controls_of(policy, states, 0.3, [[1.0, 1.0, 0.0, 0.0], [1.0, -1.0, 0.0, 0.0]])
    assert found.shape == (2, lander.control.size)
    assert ((found >= lander.bounds.low) & (found <= lander.bounds.high)).all()
    assert (found[0] != found[1]).any()


def test_training_resumes_to_the_same_bytes_and_learns(fish: DeformableSystem, tmp_path: Path):
    emulator, reports = load_emulator("fish"), []
    training = PolicyTraining(widths=(8,), updates=200, batch=4, steps=6, starts=32)
    whole, parts = tmp_path / "whole.policy.safetensors", tmp_path / "parts.policy.safetensors"
    train_policy(emulator, fish, whole, training, on_report=reports.append)

    def stop(report):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_policy(emulator, fish, parts, training, on_report=stop)
    assert not parts.exists()
    train_policy(emulator, fish, parts, training)
    assert parts.read_bytes() == whole.read_bytes()
    assert reports[-1].validation < reports[0].validation
    assert len((tmp_path / "parts.policy.run" / "metrics.jsonl").read_text().splitlines()) == 2


@pytest.mark.parametrize(
    "fault", [{"updates": 0}, {"batch": 0}, {"starts": 4}, {"learning_rate": 2.0}, {"deeper": -1.0}]
)
def test_a_senseless_training_is_refused(fault: dict):
    with pytest.raises(ArgumentError, match=f"^{next(iter(fault))}: wanted"):
        PolicyTraining(**fault)


def test_bodies_under_a_surface_start_at_all_depths():
    """Near it they are steered otherwise than below, and cannot see how deep they are."""
    emulator, dolphin = load_emulator("dolphin"), load_system("dolphin")
    near, deep = (
        draw_starts(emulator, dolphin, training, np.random.default_rng(0))
        for training in (PolicyTraining(starts=32, deeper=deeper) for deeper in (0.0, 3.0))
    )
    lowered = near - deep
    heights = lowered[:, 2:69:3] / dolphin.body_length
    np.testing.assert_allclose(heights, np.repeat(heights[:, :1], 23, axis=1))
    assert 0 <= heights.min() < 0.3
    assert 2.7 < heights.max() <= 3
    lowered[:, 2:69:3] = 0
    assert not lowered.any()


def test_the_highest_speed_is_that_of_the_gait():
    ranges = command_ranges(load_emulator("fish"))
    assert 0.12 < ranges.high[0] < 0.18


TANK = Tank((-1.2, -1.2, -0.7), (1.2, 1.2, 0.7))


def test_a_school_stays_in_its_tank_and_in_shape(policy: Policy, fish: DeformableSystem):
    rng, count = np.random.default_rng(4), 20
    starts = np.tile(fish.rest, (count, 1))
    starts[:, :69] += np.tile(rng.uniform(-0.5, 0.5, (count, 3)) * [1, 1, 0.5], 23)

    def behave(pose: Pose, time: jax.Array) -> SteeringTarget:
        company = wander(pose, time) + school(pose, spacing=0.3, reach=0.6)
        return steer_along(
            company * jnp.array([1.0, 1.0, 0.3]) + 12 * stay_inside(pose, TANK, 0.4), 0.1
        )

    lives = np.asarray(rollout_on_emulator(policy, behave, starts, 200))
    positions = lives[..., :69].reshape(count, -1, 23, 3)
    assert (positions > np.array(TANK.low)).all()
    assert (positions < np.array(TANK.high)).all()
    sizes = np.linalg.norm(positions - positions.mean(axis=2, keepdims=True), axis=-1).max(axis=-1)
    np.testing.assert_allclose(sizes, sizes[:, :1] + np.zeros_like(sizes), rtol=0.15)
    way = np.linalg.norm(np.diff(positions.mean(axis=2), axis=1), axis=-1).sum(axis=1)
    assert (way > 1.0).all()


def test_fish_catch_what_they_pursue(policy: Policy, fish: DeformableSystem):
    bait = np.array([0.8, 0.9, 0.2])
    lives = np.asarray(
        rollout_on_emulator(
            policy, lambda pose, time: steer_along(pursue(pose, bait), 0.12), fish.rest[None], 150
        )
    )
    distance = np.linalg.norm(lives[0, :, :3] - bait, axis=-1)
    assert distance.min() < 0.1 < distance[0]


def test_forces_point_away_from_walls_and_neighbours():
    positions = np.array([[0.9, 0.0, 0.0], [0.85, 0.0, 0.0], [-0.9, 0.0, 0.4]])
    axes = np.tile([1.0, 0.0, 0.0], (3, 1)), np.tile([0.0, 0.0, 1.0], (3, 1))
    pose = Pose(jnp.asarray(positions), jnp.zeros((3, 3)), *map(jnp.asarray, axes))
    inward = np.asarray(stay_inside(pose, Tank((-1.0, -1.0, -0.5), (1.0, 1.0, 0.5)), 0.2))
    assert (np.sign(inward) == [[-1, 0, 0], [-1, 0, 0], [1, 0, -1]]).all()
    apart = np.asarray(school(pose, spacing=0.2, reach=0.3))
    assert apart[0, 0] > apart[1, 0]
    assert np.isfinite(apart).all()


def test_lives_of_the_wrong_shape_are_refused(policy: Policy, fish: DeformableSystem):
    with pytest.raises(ArgumentError, match="^starts and steps: wanted"):
        rollout_on_emulator(policy, lambda pose, time: steer_forward(pose, 0.1), fish.rest, 5)
