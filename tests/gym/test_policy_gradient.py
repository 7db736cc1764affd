"""Policies by slopes from an emulator: true where the emulator is the physics, the same from the same seed, and kept in files."""

from __future__ import annotations

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import Emulator, NeuroAnimatorError, load_emulator, load_system
from neuroanimator.gym import EpisodeRules
from neuroanimator.gym.bodies import Bodies, environment_returns
from neuroanimator.gym.learn_policy import Learner, PolicyLearning, learn_policy
from neuroanimator.gym.locomotion import task_of
from neuroanimator.gym.policy_gradient import (
    Rollouts,
    critic_targets,
    policy_gradient,
    with_network,
)
from neuroanimator.gym.state_policy import Perceptron, load_state_policy
from neuroanimator.gym.state_rows import emulator_stepper

LEARNING = PolicyLearning(
    updates=2, bodies=4, horizon=5, policy_widths=(8,), critic_widths=(8,), reports=2
)
DISCOUNT = 0.9


def cost(states, controls, following, dt):
    return -(following**2).sum(axis=-1) - 0.01 * (controls**2).sum(axis=-1)


def starts(rng: np.random.Generator) -> np.ndarray:
    return np.array([0.3, 0.1, -0.2, 0.0, 0.0, 0.0]) + 0.1 * rng.normal(size=6)


RULES = EpisodeRules(cost, draw_start=starts, steps=100)


@pytest.fixture(scope="module")
def emulator() -> Emulator:
    return load_emulator("pendulum")


@pytest.fixture(scope="module")
def learner(emulator: Emulator) -> Learner:
    learner = Learner(load_system("pendulum"), emulator, RULES, LEARNING)
    learner.bodies = Bodies(
        emulator_stepper(emulator, np.inf, 0.0), RULES, emulator, np.random.default_rng(1), 4
    )
    return learner


@pytest.fixture(scope="module")
def rollouts(learner: Learner) -> Rollouts:
    """Rollouts whose physics is the emulator itself."""
    return learner._roll_out(np.random.default_rng(2))


def test_where_the_emulator_is_the_physics_slopes_are_those_of_returns(
    learner: Learner, rollouts: Rollouts, emulator: Emulator
):
    def minus_return(network: Perceptron) -> jax.Array:
        policy = with_network(learner.policy, network)
        states = rollouts.states[0]
        total = jnp.zeros(len(states))
        weight = 1.0
        for noise in rollouts.noise:
            controls = policy.control_of(states, noise)
            following = jax.vmap(emulator.step)(states, controls)
            total += weight * cost(states, controls, following, emulator.dt)
            weight *= DISCOUNT
            states = following
        total += weight * learner.critic(learner.policy.view(states))[..., 0]
        return -total.mean() / len(rollouts.noise)

    wanted_loss, wanted = jax.value_and_grad(minus_return)(learner.policy.network)
    loss, gradient = policy_gradient(
        learner.policy, learner.critic, emulator, RULES, rollouts, DISCOUNT
    )
    assert loss == pytest.approx(float(wanted_loss), rel=1e-4)
    for part, other in zip(jax.tree.leaves(gradient), jax.tree.leaves(wanted), strict=True):
        assert np.allclose(part, other, rtol=2e-2, atol=1e-3 * np.abs(other).max() + 1e-7)


def test_slopes_of_two_episodes_in_a_row_are_the_sum_of_those_of_each(
    learner: Learner, rollouts: Rollouts, emulator: Emulator
):
    ended = rollouts.is_last.at[1].set(True)
    cut = rollouts._replace(is_last=ended, is_fallen=ended)
    short = Rollouts(*(part[:2] for part in cut))

    def slopes(of: Rollouts) -> Perceptron:
        return policy_gradient(learner.policy, learner.critic, emulator, RULES, of, DISCOUNT)[1]

    later = Rollouts(*(part[2:] for part in cut))
    whole = jax.tree.map(lambda first, rest: 2 * first + 3 * rest, slopes(short), slopes(later))
    both = jax.tree.map(lambda part: 5 * part, slopes(cut))
    for part, other in zip(jax.tree.leaves(whole), jax.tree.leaves(both), strict=True):
        assert np.allclose(part, other, rtol=1e-3, atol=1e-3 * np.abs(other).max() + 1e-7)


def test_targets_with_a_full_trace_are_discounted_sums_and_without_one_single_steps(
    learner: Learner, rollouts: Rollouts, emulator: Emulator
):
    view = learner.policy.view
    values = learner.critic(view(rollouts.following))[..., 0]
    rewards = cost(rollouts.states, rollouts.controls, rollouts.following, emulator.dt)

    def targets(trace: float) -> np.ndarray:
        found = critic_targets(learner.critic, view, RULES, rollouts, DISCOUNT, trace, emulator.dt)
        return np.asarray(found)

    assert np.allclose(targets(0.0), rewards + DISCOUNT * values, rtol=1e-5, atol=1e-5)
    total = np.asarray(values[-1])
    for reward in np.asarray(rewards)[::-1]:
        total = reward + DISCOUNT * total
    assert np.allclose(targets(1.0)[0], total, rtol=1e-5, atol=1e-5)


def test_the_same_seed_learns_the_same_policy_and_files_keep_it(emulator: Emulator, tmp_path: Path):
    files = []
    for name in ("first", "second"):
        policy = learn_policy(load_system("pendulum"), emulator, RULES, LEARNING)
        path = tmp_path / f"{name}.policy.safetensors"
        policy.save(path)
        files.append(path)
    assert files[0].read_bytes() == files[1].read_bytes()
    states = jnp.asarray(np.random.default_rng(3).normal(size=(4, 6)), jnp.float32)
    read = load_state_policy(files[0])
    assert np.array_equal(policy.control_of(states), read.control_of(states))
    assert eqx.tree_equal(policy.emulator.network, read.emulator.network)


def test_an_environment_that_a_file_names_is_none_but_gymnasiums_own_of_this_body(
    learner: Learner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "stranger.py").write_text("raise SystemExit('a file has run a program')")
    monkeypatch.syspath_prepend(str(tmp_path))
    for env_id in ("stranger:Hopper-v5", "Nowhere-v0", "CartPole-v1"):
        with pytest.raises(NeuroAnimatorError):
            environment_returns(learner.policy, env_id, 1, 0)
    with pytest.raises(NeuroAnimatorError, match="wanted|controls|shape"):
        environment_returns(learner.policy, "Walker2d-v5", 1, 0)
    with pytest.raises(NeuroAnimatorError, match=r"no \[task\]"):
        task_of(learner.emulator.definition, "a.policy.safetensors")
