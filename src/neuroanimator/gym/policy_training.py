"""Train a policy by back-propagation through time, through its emulator."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int, PRNGKeyArray

from neuroanimator.animation.showcase import swims_under_a_surface, whole_body
from neuroanimator.control.policies.policy import (
    COMMAND,
    Policy,
    check_steerable,
    fresh_policy,
    latent_structure,
)
from neuroanimator.control.policies.policy_loss import (
    LossWeights,
    Swimmers,
    start_swimmers,
    swim_loss,
)
from neuroanimator.control.policies.steering import SteeringTarget
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks.network import Network
from neuroanimator.emulator.tensors import emulator_tensors
from neuroanimator.errors import ArgumentError
from neuroanimator.files.atomic import append_line, canonical_json, digest, locked
from neuroanimator.files.unfinished import remove_stale
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.learn.training.checkpoint import TrainingState, read_checkpoint, write_checkpoint
from neuroanimator.learn.training.optimizer import clipped
from neuroanimator.learn.training.train import METRICS, run_folder
from neuroanimator.state.layout import Bounds
from neuroanimator.state.pose import read_pose
from neuroanimator.systems.system import System

MAX_TURN = 1.5
"""Maximum command to turn, climb or roll [rad]: beyond a quarter of a circle the body turns as fast as it can anyway."""

UPDATES_PER_REPORT = 100
"""Number of updates in one compiled chunk, after which the policy is validated and a checkpoint written."""

VALIDATION_SHARE = 0.25
"""Share of starts set aside for validation."""

VALIDATION_SECONDS = 6.0
"""Duration of validation swims [s]."""

GAIT_SECONDS = 6.0
"""Time until a gait is steady [s]."""

GAIT_PERIODS = 2
"""Number of periods of the gait over which its speed is measured."""

STEERABLE_SPEED = 0.9
"""Maximum commanded speed, as a share of the gait's at full strength: steering needs spare strength."""

FRESH_SHARE = 0.2
"""Share of bodies that restart before every update; the others go on."""

NEW_TARGET_SHARE = 0.5
"""Share of bodies that get another target before every update, besides those that restart."""

STARTS_STREAM = 21
"""Number joined to the seed for the random numbers of the starts."""

FIRST_BODIES_STREAM = 2**30
"""Stream of the first bodies' random numbers, other than those of the chunks, which are numbered from 0."""


@dataclass(frozen=True)
class PolicyTraining:
    """All settings that a policy's weights depend on, besides its emulator."""

    widths: tuple[int, ...] = (64, 48)
    updates: int = 5_000
    batch: int = 64
    steps: int = 30
    """Number of super steps through which gradients are back-propagated."""
    starts: int = 1024
    """Number of random states of the true physics from which bodies start."""
    deeper: float = 3.0
    """Maximum depth added to the start of a body that lives under a surface [body lengths].

    Near it a body is steered otherwise than below, which its policy cannot see.
    """
    learning_rate: float = 1e-3
    weights: LossWeights = field(default_factory=LossWeights)
    observes_parameters: bool = True
    """Whether the policy of a family gets the parameters of the body; in either case bodies are random ones of the family."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("updates", 1), ("batch", 1), ("steps", 1), ("starts", 8)):
            if getattr(self, name) < least:
                raise ArgumentError(f"{name}: wanted at least {least}, got {getattr(self, name)}.")
        if not 0 <= self.deeper < math.inf:
            raise ArgumentError(f"deeper: wanted 0 or more, got {self.deeper:g}.")
        if not 0 < self.learning_rate < 1:
            raise ArgumentError(
                f"learning_rate: wanted a number between 0 and 1, got {self.learning_rate:g}."
            )


class PolicyReport(NamedTuple):
    """One line of `metrics.jsonl`."""

    update: int
    loss: float
    """Mean loss of the updates since the last report."""
    validation: float
    """Loss from starts and to targets unseen in training."""
    seconds: float
    """Time since the run began or resumed [s]."""


def train_policy(
    emulator: Emulator,
    system: System,
    out: str | Path,
    training: PolicyTraining = PolicyTraining(),
    *,
    on_report: Callable[[PolicyReport], None] = lambda report: None,
) -> Policy:
    """Train a policy for `system` through its `emulator`, write the best by validation to `out` and return it.

    Checkpoints and `metrics.jsonl` are beside `out` in a folder that ends in `.run`; a run found there is resumed.
    """
    check_steerable(emulator)
    out = Path(out)
    folder = run_folder(out)
    with locked(folder):
        run = _Run.prepare(emulator, system, training, folder)
        remove_stale(folder)
        while not run.is_over:
            on_report(run.advance())
        provenance = {"training": json.loads(canonical_json(asdict(training)))}
        run.best.save(out, provenance)
    return run.best


@dataclass
class _Run:
    """A training run between two reports; bodies in motion are part of the optimiser's memory."""

    training: PolicyTraining
    folder: Path
    base: Policy
    """The policy with its initial weights."""
    progress: TrainingState
    pool: Float[Array, "P I"]
    """Latent states from which bodies start."""
    validation: Swimmers
    """Bodies of the validation swims."""
    identity: str
    """Key that distinguishes this run's checkpoints from those of other settings or starts."""
    began: float = field(default_factory=time.monotonic)

    @classmethod
    def prepare(
        cls, emulator: Emulator, system: System, training: PolicyTraining, folder: Path
    ) -> _Run:
        rng = np.random.default_rng([training.seed, STARTS_STREAM])
        base = fresh_policy(
            emulator,
            command_ranges(emulator),
            training.widths,
            training.seed,
            observes_parameters=training.observes_parameters,
        )
        states = draw_starts(emulator, system, training, rng)
        starts = np.asarray(emulator.encode(states), np.float32)
        set_aside, pool = np.split(starts, [round(VALIDATION_SHARE * len(starts))])
        pool = as_jax(pool)
        key = jax.random.key(training.seed + 1)
        validation = start_swimmers(base, as_jax(set_aside), key)
        fresh = _fresh_progress(base, training, pool)
        contents = {"starts": starts, **emulator_tensors(emulator)}
        identity = f"{digest(contents)[:16]}-{canonical_json(asdict(training))}"
        progress = read_checkpoint(folder, identity, fresh)
        return cls(training, folder, base, progress, pool, validation, identity)

    @property
    def is_over(self) -> bool:
        return self.progress.chunk * UPDATES_PER_REPORT >= self.training.updates

    @property
    def best(self) -> Policy:
        return _with_network(self.base, self.progress.best)

    def advance(self) -> PolicyReport:
        """Train until the next report, then validate, log and checkpoint."""
        progress = self.progress
        network, memory, loss = _train_chunk(
            self.training,
            self.base,
            progress.network,
            progress.optimizer_state,
            self.pool,
            as_jax(progress.chunk, np.int32),
        )
        done = progress.chunk + 1
        progress = progress._replace(network=network, optimizer_state=memory, chunk=done)
        steps = round(VALIDATION_SECONDS / self.base.dt)
        trained = _with_network(self.base, network)
        loss_of_swim, _ = swim_loss(self.training.weights, trained, self.validation, steps)
        validation = float(loss_of_swim)
        self.progress = progress.judged(validation)
        seconds = time.monotonic() - self.began
        report = PolicyReport(done * UPDATES_PER_REPORT, float(loss), validation, seconds)
        write_checkpoint(self.folder, self.identity, self.progress)
        append_line(self.folder / METRICS, json.dumps(report._asdict()))
        return report


def draw_starts(
    emulator: Emulator, system: System, training: PolicyTraining, rng: np.random.Generator
) -> Float[np.ndarray, "P S"]:
    """Return random states from which bodies start, at all depths of a water that has a surface."""
    states = sample_starts(system, rng, training.starts)
    if swims_under_a_surface(emulator):
        entries, length = whole_body(emulator)
        lowered = length * rng.uniform(0, training.deeper, (len(states), 1))
        states[:, entries][:, 2::3] -= lowered
    return states


def _fresh_progress(
    base: Policy, training: PolicyTraining, pool: Float[Array, "P I"]
) -> TrainingState:
    """Return the initial progress of a run: its first bodies start from the `pool`."""
    key = jax.random.fold_in(jax.random.key(training.seed), FIRST_BODIES_STREAM)
    starts = jax.random.choice(key, pool, (training.batch,))
    progress = TrainingState.fresh(base.network, make_optimizer(training))
    memory = (progress.optimizer_state, start_swimmers(base, starts, key))
    return progress._replace(optimizer_state=memory)


def _with_network(policy: Policy, network: Network) -> Policy:
    """Return `policy` with another network."""
    return eqx.tree_at(lambda policy: policy.network, policy, network)


def command_ranges(emulator: Emulator) -> Bounds:
    """Return the range of each command: speeds up to nearly that of the gait at full strength."""
    top_speed = STEERABLE_SPEED * gait_speed(emulator)
    angles = COMMAND.size - 1
    return Bounds((0.0, *(-MAX_TURN,) * angles), (top_speed, *(MAX_TURN,) * angles))


def gait_speed(emulator: Emulator) -> float:
    """Return the steady speed of the emulated body under its gait [m/s].

    Raises ArgumentError for a system without a gait.
    """
    spec = emulator.spec
    if spec.gait is None:
        raise ArgumentError(
            f"The system {spec.system} has no gait, which sets its speed. Add one to its definition."
        )
    steps = round(GAIT_SECONDS / emulator.dt)
    controls = spec.gait.controls(steps, emulator.dt, spec.bounds)
    latent = emulator.encode(emulator.rollout(np.array(spec.rest), controls))
    positions = read_pose(latent_structure(emulator), latent).position
    measured = GAIT_PERIODS * max(1, round(spec.gait.period / emulator.dt))
    travelled = positions[-1] - positions[-1 - measured]
    return float(np.linalg.norm(travelled)) / (measured * emulator.dt)


def make_optimizer(training: PolicyTraining) -> optax.GradientTransformation:
    """Return Adam with clipped gradients and a learning rate that decays to zero."""
    rate = optax.cosine_decay_schedule(training.learning_rate, training.updates)
    return clipped(optax.adam(rate))


@eqx.filter_jit
def _train_chunk(
    training: PolicyTraining,
    base: Policy,
    network: Network,
    memory: tuple,
    pool: Float[Array, "P I"],
    chunk: Int[Array, ""],
) -> tuple[Network, tuple, Float[Array, ""]]:
    """Return (network, (optimiser state, bodies), mean loss) after one chunk of updates.

    Random numbers depend on the seed and the chunk's number alone, so that a resumed run gets the same.
    """
    optimizer = make_optimizer(training)
    key = jax.random.fold_in(jax.random.key(training.seed), chunk)

    def loss_of(network: Network, swimmers: Swimmers) -> tuple[Array, Swimmers]:
        policy = _with_network(base, network)
        return swim_loss(training.weights, policy, swimmers, training.steps)

    def update(carry: tuple, key: PRNGKeyArray) -> tuple[tuple, Array]:
        network, (state, swimmers) = carry
        (loss, following), gradient = jax.value_and_grad(loss_of, has_aux=True)(network, swimmers)
        step, state = optimizer.update(gradient, state)
        following = _renewed(base, jax.lax.stop_gradient(following), pool, key)
        return (eqx.apply_updates(network, step), (state, following)), loss

    keys = jax.random.split(key, UPDATES_PER_REPORT)
    (network, memory), losses = jax.lax.scan(update, (network, memory), keys)
    return network, memory, losses.mean()


def _renewed(
    policy: Policy, swimmers: Swimmers, pool: Float[Array, "P I"], key: PRNGKeyArray
) -> Swimmers:
    """Return the bodies, some of them reset to random starts and some with another target.

    Those whose numbers are no longer finite are reset, too.
    """
    fresh_key, target_key, choice_key, start_key = jax.random.split(key, 4)
    shape = swimmers.phase.shape
    is_fresh = jax.random.bernoulli(fresh_key, FRESH_SHARE, shape)
    is_fresh |= ~jnp.isfinite(swimmers.latent).all(axis=1)
    has_new_target = is_fresh | jax.random.bernoulli(target_key, NEW_TARGET_SHARE, shape)
    chosen = jax.random.choice(choice_key, pool, shape)
    latent = jnp.where(is_fresh[:, None], chosen, swimmers.latent)
    other = start_swimmers(policy, latent, start_key)
    target = SteeringTarget(
        jnp.where(has_new_target[:, None], other.target.direction, swimmers.target.direction),
        jnp.where(has_new_target, other.target.speed, swimmers.target.speed),
    )
    return Swimmers(latent, jnp.where(is_fresh, other.phase, swimmers.phase), target)
