"""Policies by gradients from an emulator: true where it is the physics, the same from the same seed, and kept in files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import Emulator, NeuroAnimatorError, load_emulator, load_system
from neuroanimator.control.policies.state_policy import load_state_policy
from neuroanimator.gym import EpisodeRules
from neuroanimator.gym.bodies import Bodies, Rollouts, environment_returns
from neuroanimator.gym.learn_policy import learn_policy
from neuroanimator.gym.learner import Learner, PolicyLearning
from neuroanimator.gym.locomotion import task_of
from neuroanimator.gym.policy_gradient import (
    Actor,
    Minibatch,
    action_gradients,
    advantages,
    policy_loss,
    weight_of_gradients,
)
from neuroanimator.gym.state_rows import EmulatorStepper

LEARNING = PolicyLearning(
    updates=4, bodies=16, horizon=5, policy_widths=(8,), critic_widths=(8,), reports=2
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
        EmulatorStepper(emulator, np.inf, 0.0), RULES, emulator, np.random.default_rng(1), 16
    )
    return learner


@pytest.fixture(scope="module")
def rollouts(learner: Learner) -> Rollouts:
    """Rollouts whose physics is the emulator itself."""
    return learner._roll_out(np.random.default_rng(2), learner.policy)


def test_where_the_emulator_is_the_physics_gradients_are_those_of_returns(
    learner: Learner, rollouts: Rollouts, emulator: Emulator
):
    critic = learner.progress.critic

    def total(noise: jax.Array) -> jax.Array:
        states = rollouts.states[0]
        earned = jnp.zeros(len(states))
        weight = 1.0
        for shaken in noise:
            controls = learner.policy.control_of(states, shaken)
            following = jax.vmap(emulator.step)(states, controls)
            earned += weight * cost(states, controls, following, emulator.dt)
            weight *= DISCOUNT
            states = following
        return (earned + weight * critic(learner.policy.view(states))).sum()

    wanted = jax.jit(jax.grad(total))(rollouts.noise)
    gradients = action_gradients(learner.policy, critic, RULES, rollouts, DISCOUNT, 1.0)
    for step, (found, part) in enumerate(zip(gradients, wanted, strict=True)):
        found = DISCOUNT**step * np.asarray(found)
        assert np.allclose(found, part, rtol=2e-2, atol=2e-3 * np.abs(part).max())


def test_gradients_do_not_reach_from_an_episode_into_that_before(
    learner: Learner, rollouts: Rollouts
):
    ended = rollouts.is_last.at[1].set(True)
    cut = rollouts._replace(is_last=ended, is_fallen=ended)
    short = Rollouts(*(part[:2] for part in cut))

    def gradients(of: Rollouts) -> np.ndarray:
        found = action_gradients(learner.policy, learner.progress.critic, RULES, of, DISCOUNT, 0.9)
        return np.asarray(found)

    assert np.allclose(gradients(cut)[:2], gradients(short), rtol=1e-4, atol=1e-6)
    assert np.allclose(gradients(cut)[2:], gradients(rollouts)[2:], rtol=1e-4, atol=1e-6)
    assert not np.allclose(gradients(cut)[1], gradients(rollouts)[1], rtol=1e-2)


def test_advantages_with_a_full_trace_are_discounted_sums_and_without_one_single_steps(
    learner: Learner, rollouts: Rollouts, emulator: Emulator
):
    view = learner.policy.view
    critic = learner.progress.critic
    rewards = cost(rollouts.states, rollouts.controls, rollouts.following, emulator.dt)
    values = critic(view(rollouts.states))

    def found(trace: float) -> np.ndarray:
        earned = advantages(critic, view, RULES, rollouts, DISCOUNT, trace, emulator.dt)
        return np.asarray(earned)

    at_once = rewards + DISCOUNT * critic(view(rollouts.following)) - values
    assert np.allclose(found(0.0), at_once, rtol=1e-4, atol=1e-5)
    total = np.asarray(critic(view(rollouts.following[-1])))
    for reward in np.asarray(rewards)[::-1]:
        total = reward + DISCOUNT * total
    assert np.allclose(found(1.0)[0], total - values[0], rtol=1e-4, atol=1e-5)


def batch_of(
    learner: Learner, count: int, gradient_noise: float, advantage_noise: float
) -> Minibatch:
    """Return what there is to learn where an action earns its first number, with errors of these sizes."""
    rng = np.random.default_rng(4)
    observations = jnp.asarray(
        rng.normal(size=(count, len(learner.policy.view.entries))), jnp.float32
    )
    controls = len(learner.progress.actor.log_spread)
    noise = 0.5 * rng.normal(size=(count, controls))
    gradients = np.zeros((count, controls))
    gradients[:, 0] = 1 + gradient_noise
    earned = noise[:, 0] + advantage_noise * rng.normal(size=count)
    means = learner.progress.actor.network(observations)
    arrays = [jnp.asarray(part, jnp.float32) for part in (noise, earned, gradients)]
    return Minibatch(observations, arrays[0], means, arrays[1], arrays[2])


def test_by_likelihoods_and_by_gradients_the_gradient_is_the_same_on_average(learner: Learner):
    batch = batch_of(learner, 200_000, 0.0, 0.0)
    actor = learner.progress.actor

    @jax.jit
    def gradient(weight: float, batch: Minibatch) -> jax.Array:
        def loss(moved: Actor) -> jax.Array:
            return policy_loss(moved, actor.log_spread, jnp.asarray(weight), batch)[0]

        return jax.grad(loss)(actor).network.biases[-1]

    by_likelihoods, by_gradients = gradient(0.0, batch), gradient(1.0, batch)
    largest = np.abs(by_gradients).max()
    assert np.allclose(by_likelihoods, by_gradients, atol=0.03 * largest)
    assert largest > 0


def test_gradients_count_the_more_the_truer_they_are_and_the_noisier_returns_are(learner: Learner):
    actor = learner.progress.actor

    def weight(gradient_noise: float, advantage_noise: float) -> float:
        batch = batch_of(learner, 1600, gradient_noise, advantage_noise)
        return float(weight_of_gradients(actor, batch, 16))

    assert weight(0.0, 5.0) > 0.9
    assert weight(-3.0, 0.1) < 0.1
    assert weight(0.0, 5.0) > weight(-1.0, 1.0) > weight(-3.0, 0.1)


def test_a_run_that_was_killed_ends_with_the_same_bytes_and_files_keep_it(
    emulator: Emulator, tmp_path: Path
):
    system = load_system("pendulum")
    files = []
    for name, stops in (("whole", False), ("killed", True)):
        folder = tmp_path / name
        if stops:
            with pytest.raises(KeyboardInterrupt):
                learn_policy(system, emulator, RULES, LEARNING, folder=folder, on_report=interrupt)
        policy = learn_policy(system, emulator, RULES, LEARNING, folder=folder)
        files.append(folder / "run.policy.safetensors")
        policy.save(files[-1])
    assert files[0].read_bytes() == files[1].read_bytes()
    lines = [(path.parent / "metrics.jsonl").read_text().count("\n") for path in files]
    assert lines == [LEARNING.reports] * 2
    states = jnp.asarray(np.random.default_rng(3).normal(size=(4, 6)), jnp.float32)
    read = load_state_policy(files[0])
    assert np.array_equal(policy.control_of(states), read.control_of(states))
    assert eqx.tree_equal(policy.emulator.network, read.emulator.network)
    with pytest.raises(NeuroAnimatorError, match="other data or settings"):
        learn_policy(system, emulator, RULES, replace(LEARNING, seed=1), folder=folder)


def test_settings_that_cannot_be_are_refused(emulator: Emulator):
    for changed in ({"bodies": 20}, {"bodies": 0}, {"gradient_weight": 1.5}):
        with pytest.raises(NeuroAnimatorError, match=next(iter(changed))):
            Learner(load_system("pendulum"), emulator, RULES, replace(LEARNING, **changed))


def test_a_reward_that_is_no_number_is_refused(emulator: Emulator):
    rules = EpisodeRules(lambda *moved: cost(*moved) / 0.0, draw_start=starts, steps=100)
    with pytest.raises(NeuroAnimatorError, match="reward"):
        learn_policy(load_system("pendulum"), emulator, rules, LEARNING)


def interrupt(report: object) -> None:
    raise KeyboardInterrupt


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
