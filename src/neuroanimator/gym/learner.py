"""One update of a policy, its critic and its emulator.

N bodies take T physics super steps →  advantages of actions by a critic, and gradients by the emulator
                                    →  weights of both: the mean with the least expected error
                                    →  a few epochs of the policy, and of the critic
                                    →  the transitions join a replay buffer, and the emulator learns from it
Random numbers follow from the seed and the update's number alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

from neuroanimator.control.policies.reference_motion import ReferenceMotion
from neuroanimator.control.policies.state_policy import FIRST_GAIN, Perceptron, StatePolicy, View
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.bodies import Bodies, Rollouts, roll_out
from neuroanimator.gym.policy_gradient import (
    Actor,
    Critic,
    Minibatch,
    action_gradients,
    advantages,
    critic_loss,
    emulator_loss,
    policy_loss,
    weight_of_gradients,
)
from neuroanimator.gym.rules import EpisodeRules, drawn_starts, unpaid
from neuroanimator.gym.started_policy import check_start, started
from neuroanimator.gym.state_rows import physics_stepper
from neuroanimator.learn.training.optimizer import clipped
from neuroanimator.state.segments import Position, place_segments
from neuroanimator.state.structure import Structure
from neuroanimator.systems.system import System

EMULATOR_RATE = 5e-4
"""Learning rate of the emulator."""

EMULATOR_BATCH = 1024

EPOCHS = 5
BATCHES = 4

RATES = (1e-5, 1e-2)
"""Minimum and maximum learning rate of the policy."""

FASTER = 1.5
"""Factor of that rate if a policy has changed by less than half of the target divergence, or more than twice."""

GROUPS = 16
"""Number of groups of bodies in estimates of the variance of gradients."""

WEIGHT_KEPT = 0.9
"""Share of the weight of gradients kept in an update (exponential smoothing)."""

UNIT_KEPT = 0.9
"""Share of the unit of values kept in an update (exponential smoothing)."""

TINY = 1e-8

REPLAY_SIZE = 200_000
"""Number of transitions in the replay buffer."""

STARTS = 500
"""Number of starts whose mean and deviation normalise the inputs that the initial policy lacks."""

CRITIC_FIRST = 10
"""Number of updates for which the initial policy is kept: the critic first learns its values."""

MAX_OBSERVED = 2e6
"""Maximum number of states that count in the view's mean and deviation, so that they keep adapting."""


@dataclass(frozen=True)
class PolicyLearning:
    """Settings of `learn_policy`."""

    updates: int = 1000
    bodies: int = 128
    """Number N of bodies, a multiple of 16."""
    horizon: int = 32
    """Number T of steps per update; beyond it the critic counts."""
    discount: float = 0.99
    trace: float = 0.95
    """λ of TD(λ), for values."""
    gradient_trace: float = 0.9
    """λ of TD(λ), for gradients of values: through contacts these hold over a tenth of a second, no longer."""
    gradient_weight: float | None = None
    """Weight of the emulator's gradients beside likelihoods; if None, the one with the least expected error.

    With 0 this is proximal policy optimisation; with 1, only gradients count.
    """
    divergence: float = 0.01
    """Target Kullback-Leibler divergence of a policy's change in an update."""
    policy_rate: float = 1e-3
    """Initial learning rate of the policy, unless learning begins with another policy."""
    critic_rate: float = 1e-3
    policy_widths: tuple[int, ...] = (128, 64)
    critic_widths: tuple[int, ...] = (128, 128)
    spread: float = 0.5
    """Initial standard deviation of the noise, before controls are squashed into their bounds."""
    emulator_updates: int = 4
    """Number of Adam steps of the emulator in an update."""
    reports: int = 20
    seed: int = 0


class LearnerState(NamedTuple):
    """Arrays on which the rest of learning depends, and the best policy so far."""

    actor: Actor
    critic: Critic
    network: Any
    """Network of the emulator."""
    view: View
    rate: Float[Array, ""]
    """Learning rate of the policy."""
    optimizer_states: tuple[Any, Any, Any]
    """States of the optimisers of the policy, the critic and the emulator."""
    states: Float[np.ndarray, "N S"]
    """States of the bodies."""
    ages: Int[np.ndarray, " N"]
    """Numbers of steps since the starts of their episodes."""
    replay_buffer: tuple[np.ndarray, np.ndarray, np.ndarray]
    """States, controls and following states: a ring buffer, empty if no gradients count."""
    best: tuple[Perceptron, View, Any]
    """Policy, view and emulator's network of the best policy."""


class Counters(NamedTuple):
    """Counters and scalars on which the rest of learning depends."""

    update: int = 0
    """Number of updates done."""
    observed: int = 0
    """Number of states behind the view's mean and deviation, at most `MAX_OBSERVED`."""
    gradient_weight: float = 0.0
    best_return: float | None = None
    """Mean return of the best policy; None before the first evaluation."""
    seconds: float = 0.0
    """Time it has taken [s]."""


class NetworkOutputs(NamedTuple):
    """Results of the networks on B states, those of a body one after another."""

    observations: Float[Array, "B O"]
    values: Float[Array, " B"]
    means: Float[Array, "B C"]
    """Outputs of the policy's network, without noise."""
    mean: Float[Array, " O"]
    """Mean over the states of each observation, in its own unit."""
    variance: Float[Array, " O"]


class Learner:
    """A policy, its critic and its emulator, between two updates."""

    def __init__(
        self,
        system: System,
        emulator: Emulator,
        rules: EpisodeRules,
        learning: PolicyLearning,
        reference: ReferenceMotion | None = None,
        start: StatePolicy | None = None,
    ):
        """Begin; `reference` is the motion to follow, if any, `start` the initial policy.

        Raises ArgumentError for invalid settings, for rules that draw no starts, and for a start of another body.
        """
        if learning.bodies < GROUPS or learning.bodies % GROUPS:
            raise ArgumentError(f"bodies: wanted a multiple of {GROUPS}, got {learning.bodies}.")
        if learning.gradient_weight is not None and not 0 <= learning.gradient_weight <= 1:
            raise ArgumentError(
                f"gradient_weight: wanted 0 to 1, got {learning.gradient_weight:g}."
            )
        self.emulator = emulator
        self.rules = rules
        self.learning = learning
        # networks: the policy observes all but its place, or what the motion shows
        observed = _observed_entries(system.structure)
        if reference is not None:
            observed = reference.shown
        view = View.fresh(observed, reference)
        count = len(view.mean)
        policy_key, critic_key = jax.random.split(jax.random.key(learning.seed))
        controls = system.control.size
        sizes = (count, *learning.policy_widths, controls)
        network = Perceptron.fresh(sizes, policy_key, FIRST_GAIN)
        counters = Counters()
        rate = learning.policy_rate
        self.critic_first = 0
        # a start keeps its weights, and lets the critic learn first
        if start is not None:
            self.critic_first = CRITIC_FIRST
            # A larger rate could undo in one update what the policy has learnt.
            rate = RATES[0]
            check_start(start, emulator, view)
            states = as_jax(drawn_starts(rules, emulator, [self._rng(-1)] * STARTS))
            view, network = started(start, view, states)
            counters = Counters(observed=int(MAX_OBSERVED))
        values = Perceptron.fresh((count, *learning.critic_widths, 1), critic_key, 1.0)
        actor = Actor(network, jnp.full(controls, np.log(learning.spread), jnp.float32))
        # optimisers and their states
        of_policy = clipped(optax.adam(1.0))
        of_critic = clipped(optax.adam(learning.critic_rate))
        of_emulator = optax.adam(EMULATOR_RATE)
        self.optimizers = (of_policy, of_critic, of_emulator)
        # Trees of weights do not match the types that optax declares.
        weights: Any = (actor, values, emulator.network)
        # bodies on the physics; rewards are those of whole rollouts at once: `advantages`.
        moving = replace(rules, reward=unpaid)
        stepper = physics_stepper(system, system.scheme, emulator.dt)
        self.bodies = Bodies(stepper, moving, emulator, self._rng(-1), learning.bodies)
        # replay buffer: empty if no gradients count
        size = system.state.size
        stored = REPLAY_SIZE if self._uses_emulator else 0
        before, held, after = (
            np.zeros((stored, width), np.float32) for width in (size, controls, size)
        )
        self.progress = LearnerState(
            actor=actor,
            critic=Critic(values, jnp.ones(())),
            network=emulator.network,
            view=view,
            rate=as_jax(rate),
            optimizer_states=(
                of_policy.init(weights[0]),
                of_critic.init(weights[1]),
                of_emulator.init(weights[2]),
            ),
            states=self.bodies.states,
            ages=self.bodies.ages,
            replay_buffer=(before, held, after),
            best=(network, view, emulator.network),
        )
        self.counters = counters
        if learning.gradient_weight is not None:
            self.counters = counters._replace(gradient_weight=learning.gradient_weight)
        self.emulator_error = 0.0

    def resume(self, progress: LearnerState, counters: Counters) -> None:
        """Resume from `progress`."""
        # Arrays read from a file are read-only.
        ring = tuple(part.copy() for part in progress.replay_buffer)
        self.progress = progress._replace(replay_buffer=ring)
        self.counters = counters
        self.bodies.resume(progress.states, progress.ages)

    def _rng(self, update: int) -> np.random.Generator:
        return np.random.default_rng([self.learning.seed, update + 1])

    @property
    def policy(self) -> StatePolicy:
        """The current policy, and its emulator."""
        return self._policy(self.progress.actor.network, self.progress.view, self.progress.network)

    @property
    def best(self) -> StatePolicy:
        """The best policy so far, and its emulator at that time."""
        return self._policy(*self.progress.best)

    def _policy(self, network: Perceptron, view: View, leaps: Any) -> StatePolicy:
        emulator = eqx.tree_at(lambda emulator: emulator.network, self.emulator, leaps)
        return StatePolicy(emulator, view, network)

    def keep_if_best(self, mean_return: float) -> None:
        """Keep the policy if its return is the best so far."""
        best = self.counters.best_return
        if best is not None and mean_return <= best:
            return
        now = self.progress
        kept = (now.actor.network, now.view, now.network)
        self.progress = now._replace(best=kept)
        self.counters = self.counters._replace(best_return=mean_return)

    def advance(self) -> None:
        """Do one update. ArgumentError if a reward is not finite."""
        rng = self._rng(self.counters.update)
        policy = self.policy
        rollouts = self._roll_out(rng, policy)
        learning = self.learning
        critic = self.progress.critic
        earned = advantages(
            critic, policy.view, self.rules, rollouts, learning.discount, learning.trace, policy.dt
        )
        if not bool(jnp.isfinite(earned).all()):
            raise ArgumentError(
                "rules.reward: wanted finite numbers, got others in states that bodies went through. Bound what it divides by, "
                "takes the root of or raises to a power."
            )
        reading = _read(policy, critic, rollouts.states)
        values = _by_body(earned) + reading.values
        if self.counters.update >= self.critic_first:
            self._improve_policy(
                rng, self._policy_data(policy, rollouts, reading, _by_body(earned))
            )
        self._improve_critic(rng, reading.observations, values)
        self._update_normaliser(reading)
        if self._uses_emulator:
            self._store(rollouts)
            self._improve_emulator(rng)
        self.counters = self.counters._replace(update=self.counters.update + 1)
        self.progress = self.progress._replace(states=self.bodies.states, ages=self.bodies.ages)

    @property
    def _uses_emulator(self) -> bool:
        return self.learning.gradient_weight != 0

    def _roll_out(self, rng: np.random.Generator, policy: StatePolicy) -> Rollouts:
        spread = np.exp(np.asarray(self.progress.actor.log_spread))
        shape = (self.learning.bodies, len(spread))
        noises = (
            (spread * rng.normal(size=shape)).astype(np.float32)
            for _ in range(self.learning.horizon)
        )
        return roll_out(policy, self.bodies, noises, rng)

    def _policy_data(
        self,
        policy: StatePolicy,
        rollouts: Rollouts,
        reading: NetworkOutputs,
        earned: Float[Array, " B"],
    ) -> Minibatch:
        """Return the policy's training data, in units of the advantages' deviation."""
        unit = earned.std() + TINY
        noise = _by_body(rollouts.noise)
        gradients = jnp.zeros(noise.shape)
        if self._uses_emulator:
            learning = self.learning
            gradients = action_gradients(
                policy, self.progress.critic, self.rules, rollouts, learning.discount,
                learning.gradient_trace,
            )  # fmt: skip
            gradients = _by_body(gradients) / unit
        gained = (earned - earned.mean()) / unit
        return Minibatch(reading.observations, noise, reading.means, gained, gradients)

    def _improve_policy(self, rng: np.random.Generator, data: Minibatch) -> None:
        actor = self.progress.actor
        weight = self.counters.gradient_weight
        if self.learning.gradient_weight is None:
            found = float(weight_of_gradients(actor, data, GROUPS))
            weight = WEIGHT_KEPT * weight + (1 - WEIGHT_KEPT) * found
            self.counters = self.counters._replace(gradient_weight=weight)
        of_policy, _, _ = self.optimizers
        optimizer_state, *others = self.progress.optimizer_states
        actor, optimizer_state, rate = _policy_epochs(
            of_policy, actor, optimizer_state, self.progress.rate, self.learning.divergence, as_jax(weight),
            data, _minibatches(rng, len(data.noise)),
        )  # fmt: skip
        if not np.isfinite(float(rate)) or not _is_finite(actor):
            return
        self.progress = self.progress._replace(
            actor=actor, rate=rate, optimizer_states=(optimizer_state, *others)
        )

    def _improve_critic(
        self,
        rng: np.random.Generator,
        observations: Float[Array, "B O"],
        values: Float[Array, " B"],
    ) -> None:
        critic = self.progress.critic
        kept = UNIT_KEPT if self.counters.update else 0.0
        unit = kept * critic.unit + (1 - kept) * (jnp.sqrt((values**2).mean()) + TINY)
        _, of_critic, _ = self.optimizers
        of_actor, optimizer_state, of_leaps = self.progress.optimizer_states
        rows = _minibatches(rng, len(values))
        batches = (observations[rows], (values / unit)[rows])
        network, optimizer_state, _ = _descend(
            of_critic, critic_loss, critic.network, optimizer_state, batches
        )
        self.progress = self.progress._replace(
            critic=Critic(network, unit), optimizer_states=(of_actor, optimizer_state, of_leaps)
        )

    def _update_normaliser(self, reading: NetworkOutputs) -> None:
        """Update the mean and deviation that normalise the networks' inputs."""
        view = self.progress.view
        count = len(reading.observations)
        observed = self.counters.observed
        share = count / (observed + count)
        mean = np.asarray(view.mean, float)
        away = np.asarray(reading.mean, float) - mean
        square = np.asarray(view.deviation, float) ** 2
        variance = np.asarray(reading.variance, float)
        square += share * (variance - square) + share * (1 - share) * away**2
        renewed = replace(
            view,
            mean=jnp.asarray(mean + share * away, jnp.float32),
            deviation=jnp.asarray(np.sqrt(square), jnp.float32),
        )
        self.progress = self.progress._replace(view=renewed)
        self.counters = self.counters._replace(observed=min(observed + count, int(MAX_OBSERVED)))

    def _store(self, rollouts: Rollouts) -> None:
        count = rollouts.is_last.size
        places = (self.counters.update * count + np.arange(count)) % REPLAY_SIZE
        parts = (rollouts.states, rollouts.controls, rollouts.following)
        for kept, part in zip(self.progress.replay_buffer, parts, strict=True):
            kept[places] = np.asarray(part).reshape(count, -1)

    def _improve_emulator(self, rng: np.random.Generator) -> None:
        count = self.learning.bodies * self.learning.horizon
        stored = min((self.counters.update + 1) * count, REPLAY_SIZE)
        rows = rng.integers(0, stored, (self.learning.emulator_updates, EMULATOR_BATCH))
        batches = tuple(as_jax(kept[rows]) for kept in self.progress.replay_buffer)
        _, _, of_emulator = self.optimizers
        *others, optimizer_state = self.progress.optimizer_states
        loss_of = eqx.Partial(emulator_loss, self.emulator)
        network, optimizer_state, loss = _descend(
            of_emulator, loss_of, self.progress.network, optimizer_state, batches
        )
        self.progress = self.progress._replace(
            network=network, optimizer_states=(*others, optimizer_state)
        )
        self.emulator_error = float(np.sqrt(loss))


def _is_finite(tree: Any) -> bool:
    return all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(tree))


def _by_body(part: Float[Array, "T N ..."]) -> Float[Array, "B ..."]:
    """Return an array of actions as rows, those of a body one after another."""
    return part.swapaxes(0, 1).reshape(-1, *part.shape[2:])


def _minibatches(rng: np.random.Generator, count: int) -> Int[Array, "U M"]:
    """Return the rows of the minibatches of some epochs."""
    order = np.stack([rng.permutation(count) for _ in range(EPOCHS)])
    return as_jax(order.reshape(EPOCHS * BATCHES, -1), np.int32)


@eqx.filter_jit
def _read(policy: StatePolicy, critic: Critic, states: Float[Array, "T N S"]) -> NetworkOutputs:
    own = policy.view.of(states).reshape(-1, len(policy.view.mean))
    observations = _by_body(policy.view(states))
    return NetworkOutputs(
        observations,
        critic(observations),
        policy.network(observations),
        own.mean(axis=0),
        own.var(axis=0),
    )


@eqx.filter_jit
def _policy_epochs(
    optimizer: optax.GradientTransformation,
    actor: Actor,
    optimizer_state: Any,
    rate: Float[Array, ""],
    divergence: float,
    weight: Float[Array, ""],
    data: Minibatch,
    rows: Int[Array, "U M"],
) -> tuple[Actor, Any, Float[Array, ""]]:
    """Return (actor, optimiser state, learning rate) after some epochs; the rate stays if the policy changes as it should."""
    before = actor.log_spread

    def update(carry: tuple, chosen: Array) -> tuple[tuple, None]:
        actor, optimizer_state, rate = carry
        batch = jax.tree.map(lambda part: part[chosen], data)
        graded = jax.value_and_grad(policy_loss, has_aux=True)
        (_, apart), gradient = graded(actor, before, weight, batch)
        rate = jnp.where(apart > 2 * divergence, rate / FASTER, rate)
        rate = jnp.where(apart < divergence / 2, rate * FASTER, rate)
        rate = jnp.clip(rate, *RATES)
        step, optimizer_state = optimizer.update(gradient, optimizer_state)
        scaled = jax.tree.map(lambda part: rate * part, step)
        return (eqx.apply_updates(actor, scaled), optimizer_state, rate), None

    carry, _ = jax.lax.scan(update, (actor, optimizer_state, rate), rows)
    return carry


@eqx.filter_jit
def _descend(
    optimizer: optax.GradientTransformation,
    loss: Callable[..., Array],
    network: Any,
    optimizer_state: Any,
    batches: tuple[Array, ...],
) -> tuple[Any, Any, Array]:
    """Return (network, optimiser state, mean loss) after a step on each of `batches`, which lie along their first axes."""

    def update(carry: tuple, batch: tuple[Array, ...]) -> tuple[tuple, Array]:
        network, optimizer_state = carry
        value, gradient = jax.value_and_grad(loss)(network, *batch)
        step, optimizer_state = optimizer.update(gradient, optimizer_state)
        return (eqx.apply_updates(network, step), optimizer_state), value

    (network, optimizer_state), losses = jax.lax.scan(update, (network, optimizer_state), batches)
    return network, optimizer_state, losses.mean()


def _observed_entries(structure: Structure) -> tuple[int, ...]:
    """Return the state entries that matter to a policy: all but a body's position along the ground."""
    observed: set[int] = set()
    for placed in place_segments(structure.segments):
        skipped = 2 if isinstance(placed.segment, Position) else 0
        observed.update(range(placed.entries.start + skipped, placed.entries.stop))
    if not observed:
        observed.update(structure.plain)
        for angle in structure.angles:
            observed.update(np.flatnonzero(angle).tolist())
    return tuple(sorted(observed))
