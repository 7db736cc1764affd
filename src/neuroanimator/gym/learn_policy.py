"""Learn a policy: short rollouts on the true physics, slopes of their returns from an emulator that learns from them too.

N bodies go T steps on the physics  →  policy_gradient of their returns  →  a step of Adam for the policy
                                    →  TD(λ) targets, a few epochs for the critic
                                    →  the transitions join a memory, and the emulator learns from it
Random numbers follow from the seed and the update's number alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.gym.bodies import Bodies, returns_of
from neuroanimator.gym.policy_gradient import (
    Rollouts,
    critic_loss,
    critic_targets,
    emulator_loss,
    noisy_controls,
    policy_gradient,
    with_network,
)
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.gym.state_policy import FIRST_GAIN, Perceptron, StatePolicy, View
from neuroanimator.gym.state_rows import physics_stepper
from neuroanimator.state.segments import Position
from neuroanimator.state.structure import Structure
from neuroanimator.systems.system import System

DECAYS = (0.7, 0.95)
"""Of Adam's averages of slopes and of their squares: both change with the policy."""

MAX_GRADIENT = 1.0
"""Norm that gradients are clipped to."""

LEAST_RATE = 0.05
"""The policy's learning rate at the end, over that at the beginning."""

EMULATOR_RATE = 5e-4
"""Learning rate of the emulator."""

EMULATOR_BATCH = 1024

CRITIC_EPOCHS = 4
CRITIC_BATCHES = 4

FOLLOWS = 0.4
"""Share of its last weights that the slowly following critic keeps in an update."""

MEMORY = 200_000
"""Number of transitions that are remembered."""

MAX_WEIGHT = 2e6
"""Number of states after which the view's mean and deviation change no slower."""

EVALUATED = 16
"""Number of episodes that judge a policy on the way."""


@dataclass(frozen=True)
class PolicyLearning:
    """Settings of `learn_policy`."""

    updates: int = 1000
    bodies: int = 128
    """N."""
    horizon: int = 32
    """T: beyond it the critic counts."""
    discount: float = 0.99
    trace: float = 0.95
    """λ of TD(λ)."""
    policy_rate: float = 2e-3
    critic_rate: float = 1e-3
    policy_widths: tuple[int, ...] = (128, 64)
    critic_widths: tuple[int, ...] = (128, 128)
    spread: float = 0.12
    """Standard deviation of the noise, before controls are pressed into their bounds; with 0.3 a hopper falls before it hops."""
    emulator_updates: int = 4
    """Number of steps of Adam for the emulator in an update."""
    reports: int = 20
    seed: int = 0


class LearningReport(NamedTuple):
    """What became of a policy so far."""

    update: int
    steps: int
    """Number of steps of the physics' super steps, evaluation left out."""
    mean_return: float
    """Of whole episodes without noise."""
    emulator_error: float
    """Of the memory's super steps."""
    seconds: float


class Learner:
    """A policy, its critic and its emulator, between two updates."""

    def __init__(
        self, system: System, emulator: Emulator, rules: EpisodeRules, learning: PolicyLearning
    ):
        self.system = system
        self.emulator = emulator
        self.rules = rules
        self.learning = learning
        self.dt = emulator.dt
        shown = _shown_entries(system.structure)
        policy_key, critic_key = jax.random.split(jax.random.key(learning.seed))
        size = len(shown)
        controls = system.control.size
        network = Perceptron.fresh(
            (size, *learning.policy_widths, controls), policy_key, FIRST_GAIN
        )
        view = View(jnp.zeros(size), jnp.ones(size), shown)
        self.policy = StatePolicy(emulator, view, network)
        self.critic = Perceptron.fresh((size, *learning.critic_widths, 1), critic_key, 1.0)
        self.slow_critic = self.critic
        self.of_policy = _clipped_adam(1.0)
        self.of_critic = _clipped_adam(learning.critic_rate)
        self.of_emulator = optax.adam(EMULATOR_RATE)
        weights: Any = (
            network,
            self.critic,
            emulator.network,
        )  # trees, but no such types as optax names
        self.policy_memory = self.of_policy.init(weights[0])
        self.critic_memory = self.of_critic.init(weights[1])
        self.emulator_memory = self.of_emulator.init(weights[2])
        stepper = physics_stepper(system, system.scheme, self.dt)
        self.bodies = Bodies(stepper, rules, emulator, self._rng(-1), learning.bodies)
        self.transitions: tuple[np.ndarray, ...] = tuple(
            np.zeros((MEMORY, width), np.float32)
            for width in (system.state.size, controls, system.state.size)
        )
        self.remembered = 0
        self.weight = 0.0
        self.emulator_error = 0.0
        self.update = 0

    def _rng(self, *stream: int) -> np.random.Generator:
        return np.random.default_rng([self.learning.seed, *(number + 1 for number in stream)])

    def advance(self, done: float) -> None:
        """Do one update; a share `done` of them all is done."""
        rng = self._rng(self.update)
        rollouts = self._roll_out(rng)
        loss, gradient = policy_gradient(
            self.policy, self.slow_critic, self.emulator, self.rules, rollouts,
            self.learning.discount,
        )  # fmt: skip
        if np.isfinite(float(loss)):
            rate = self.learning.policy_rate * max(LEAST_RATE, 1 - done)
            network, self.policy_memory = _stepped(
                self.of_policy, gradient, self.policy_memory, self.policy.network, as_jax(rate)
            )
            self.policy = with_network(self.policy, network)
        self._see(np.asarray(rollouts.states))
        self._fit_critic(rng, rollouts)
        self._remember(rollouts)
        self._fit_emulator(rng)
        self.update += 1

    def _roll_out(self, rng: np.random.Generator) -> Rollouts:
        shape = (self.learning.bodies, self.system.control.size)
        told = []
        for _ in range(self.learning.horizon):
            states = self.bodies.states.astype(np.float32)
            noise = (self.learning.spread * rng.normal(size=shape)).astype(np.float32)
            controls = np.asarray(noisy_controls(self.policy, as_jax(states), as_jax(noise)))
            moved = self.bodies.step(controls)
            following = moved.following.astype(np.float32)
            told.append((states, noise, controls, following, moved.is_fallen, moved.is_last))
            self.bodies.begin(rng, moved.is_last)
        return Rollouts(*(jnp.asarray(np.stack(part)) for part in zip(*told, strict=True)))

    def _see(self, states: Float[np.ndarray, "T N S"]) -> None:
        """Let what networks are shown of a state keep to what states there are."""
        view = self.policy.view
        shown = states[..., list(view.entries)].reshape(-1, len(view.entries)).astype(float)
        share = len(shown) / (self.weight + len(shown))
        self.weight = min(self.weight + len(shown), MAX_WEIGHT)
        mean = np.asarray(view.mean, float)
        away = shown.mean(axis=0) - mean
        square = np.asarray(view.deviation, float) ** 2
        square += share * (shown.var(axis=0) - square) + share * (1 - share) * away**2
        renewed = View(
            jnp.asarray(mean + share * away, jnp.float32),
            jnp.asarray(np.sqrt(square), jnp.float32),
            view.entries,
        )
        self.policy = eqx.tree_at(lambda policy: policy.view, self.policy, renewed)

    def _fit_critic(self, rng: np.random.Generator, rollouts: Rollouts) -> None:
        learning = self.learning
        targets = critic_targets(
            self.slow_critic, self.policy.view, self.rules, rollouts, learning.discount,
            learning.trace, self.dt,
        )  # fmt: skip
        count = targets.size
        order = np.stack([rng.permutation(count) for _ in range(CRITIC_EPOCHS)])
        rows = order.reshape(CRITIC_EPOCHS * CRITIC_BATCHES, -1).astype(np.int32)
        states = rollouts.states.reshape(count, -1)
        self.critic, self.critic_memory = _critic_epochs(
            self.of_critic, self.critic, self.critic_memory, self.policy.view(as_jax(states)),
            targets.reshape(-1), as_jax(rows, np.int32),
        )  # fmt: skip
        self.slow_critic = jax.tree.map(
            lambda slow, new: FOLLOWS * slow + (1 - FOLLOWS) * new, self.slow_critic, self.critic
        )

    def _remember(self, rollouts: Rollouts) -> None:
        count = rollouts.is_last.size
        places = (self.remembered + np.arange(count)) % MEMORY
        parts = (rollouts.states, rollouts.controls, rollouts.following)
        for kept, part in zip(self.transitions, parts, strict=True):
            kept[places] = np.asarray(part).reshape(count, -1)
        self.remembered += count

    def _fit_emulator(self, rng: np.random.Generator) -> None:
        if not self.learning.emulator_updates:
            return
        shape = (self.learning.emulator_updates, EMULATOR_BATCH)
        rows = rng.integers(0, min(self.remembered, MEMORY), shape)
        batches = tuple(as_jax(kept[rows]) for kept in self.transitions)
        self.emulator, self.emulator_memory, loss = _emulator_steps(
            self.of_emulator, self.emulator, self.emulator_memory, batches
        )
        self.emulator_error = float(np.sqrt(loss))

    @property
    def learnt(self) -> StatePolicy:
        """The policy as it is now, and its emulator."""
        return StatePolicy(self.emulator, self.policy.view, self.policy.network)


def _clipped_adam(rate: float) -> optax.GradientTransformation:
    first, second = DECAYS
    clip = optax.clip_by_global_norm(MAX_GRADIENT)
    return optax.chain(clip, optax.adam(rate, b1=first, b2=second))


@eqx.filter_jit
def _stepped(
    optimizer: optax.GradientTransformation,
    gradient: Any,
    memory: Any,
    network: Perceptron,
    rate: Float[Array, ""],
) -> tuple[Perceptron, Any]:
    step, memory = optimizer.update(gradient, memory)
    scaled = jax.tree.map(lambda part: rate * part, step)
    return eqx.apply_updates(network, scaled), memory


@eqx.filter_jit
def _critic_epochs(
    optimizer: optax.GradientTransformation,
    critic: Perceptron,
    memory: Any,
    shown: Float[Array, "B O"],
    targets: Float[Array, " B"],
    rows: Int[Array, "U M"],
) -> tuple[Perceptron, Any]:
    def update(carry: tuple, chosen: Array) -> tuple[tuple, None]:
        critic, memory = carry
        gradient: Any = jax.grad(critic_loss)(critic, shown[chosen], targets[chosen])
        step, memory = optimizer.update(gradient, memory)
        return (eqx.apply_updates(critic, step), memory), None

    (critic, memory), _ = jax.lax.scan(update, (critic, memory), rows)
    return critic, memory


@eqx.filter_jit
def _emulator_steps(
    optimizer: optax.GradientTransformation,
    emulator: Emulator,
    memory: Any,
    batches: tuple[Array, ...],
) -> tuple[Emulator, Any, Array]:
    def update(carry: tuple, batch: tuple[Array, ...]) -> tuple[tuple, Array]:
        network, memory = carry
        loss, gradient = jax.value_and_grad(emulator_loss)(network, emulator, *batch)
        step, memory = optimizer.update(gradient, memory)
        return (eqx.apply_updates(network, step), memory), loss

    (network, memory), losses = jax.lax.scan(update, (emulator.network, memory), batches)
    return eqx.tree_at(lambda emulator: emulator.network, emulator, network), memory, losses.mean()


def _shown_entries(structure: Structure) -> tuple[int, ...]:
    """Return the entries of the state that matter to a policy: all but where a body is along the ground."""
    entry = 0
    shown: set[int] = set()
    for segment in structure.segments:
        entries = list(range(entry, entry + segment.size))
        if isinstance(segment, Position):
            entries = entries[2:]
        shown.update(entries)
        entry += segment.size
    if not shown:
        shown.update(structure.plain)
        for angle in structure.angles:
            shown.update(np.flatnonzero(angle).tolist())
    return tuple(sorted(shown))


def learn_policy(
    system: System,
    emulator: Emulator,
    rules: EpisodeRules,
    learning: PolicyLearning = PolicyLearning(),
    *,
    seconds: float | None = None,
    on_share: Callable[[float], None] = lambda share: None,
    on_report: Callable[[LearningReport], None] = lambda report: None,
) -> StatePolicy:
    """Return the best of the policies on the way, by whole episodes on the true physics.

    `emulator` leaps one step of the episodes; a copy of it learns from them. Given `seconds`, learning ends after that time, not
    after a number of updates, and the policy depends on the machine. `on_share` is told the share that is done.
    """
    learner = Learner(system, emulator, rules, learning)
    best = learner.learnt
    best_return = -np.inf
    stepper = physics_stepper(system, system.scheme, emulator.dt)
    began = time.monotonic()
    reported = 0
    done = 0.0
    while done < 1:
        learner.advance(done)
        elapsed = time.monotonic() - began
        done = learner.update / learning.updates
        if seconds is not None:
            done = elapsed / seconds
        on_share(min(done, 1.0))
        if int(done * learning.reports) <= reported:
            continue
        reported = int(done * learning.reports)
        policy = learner.learnt
        mean = float(returns_of(policy, stepper, rules, EVALUATED, learning.seed).mean())
        if mean > best_return:
            best = policy
            best_return = mean
        steps = learner.update * learning.bodies * learning.horizon
        on_report(LearningReport(learner.update, steps, mean, learner.emulator_error, elapsed))
    return best
