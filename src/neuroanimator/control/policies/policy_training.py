"""Train a policy by back-propagation through time: its emulator tells how every muscle moves the goal."""

from __future__ import annotations

import json
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
from jaxtyping import Array

from neuroanimator.control.policies.policy import Policy, fresh_policy
from neuroanimator.control.policies.policy_file import save_policy
from neuroanimator.control.policies.policy_loss import (
    LossWeights,
    Swimmers,
    begin,
    motion_loss,
    swim,
)
from neuroanimator.data.sampling import sample_starts
from neuroanimator.emulator.artifact import tensors_of
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks.network import Network
from neuroanimator.errors import ArgumentError
from neuroanimator.state.layout import Bounds
from neuroanimator.storage.files import append_line, canonical_json, digest, locked
from neuroanimator.storage.unfinished import remove_stale
from neuroanimator.systems.system import System
from neuroanimator.training.checkpoint import Progress, read_checkpoint, write_checkpoint

MAX_TURN = 1.5
"""[rad] Commands to turn further count as this: a quarter of a circle is turned as fast as the body can anyway."""

UPDATES_PER_REPORT = 100
CHECKED_SHARE = 0.25
"""Of the starts, kept for validation."""
CHECKED_SECONDS = 6.0
"""How long bodies swim for validation [s]."""
GAIT_SECONDS = 6.0
"""After which a gait is under way [s]."""
STEERABLE = 0.9
"""Highest commanded speed over the gait's own at full strength: what steers must have strength to spare."""
FRESH_SHARE, NEW_COURSE_SHARE = 0.2, 0.5
"""Shares of bodies that start anew, and that get another course, before every update; others go on."""


@dataclass(frozen=True)
class PolicyTraining:
    """Every choice a policy's weights depend on, besides its emulator."""

    widths: tuple[int, ...] = (64, 48)
    updates: int = 5_000
    batch: int = 64
    steps: int = 30
    """Super steps gradients go back through."""
    starts: int = 1024
    """Random states of the true physics, from which bodies start."""
    learning_rate: float = 1e-3
    weights: LossWeights = field(default_factory=LossWeights)
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("updates", 1), ("batch", 1), ("steps", 1), ("starts", 8)):
            if getattr(self, name) < least:
                raise ArgumentError(f"{name}: wanted at least {least}, came {getattr(self, name)}.")
        if not 0 < self.learning_rate < 1:
            raise ArgumentError(
                f"learning_rate: wanted a number between 0 and 1, came {self.learning_rate:g}."
            )


class PolicyReport(NamedTuple):
    """One line of `metrics.jsonl`."""

    update: int
    loss: float
    validation: float
    """The loss from starts and to courses unseen in training."""
    seconds: float


def train_policy(
    emulator: Emulator,
    system: System,
    out: Path,
    training: PolicyTraining = PolicyTraining(),
    *,
    on_report: Callable[[PolicyReport], None] = lambda report: None,
) -> Policy:
    """Train a policy for `system` through its `emulator`, write the best by validation to `out` and return it.

    Checkpoints and `metrics.jsonl` lie beside `out` in a folder that ends in `.run`; a run found there is continued.
    """
    folder = out.with_name(out.name.removesuffix(".safetensors") + ".run")
    with locked(folder):
        run = _Run.prepare(emulator, system, training, folder)
        remove_stale(folder)
        while not run.is_over:
            on_report(run.advance())
        save_policy(run.best, out, {"training": json.loads(canonical_json(asdict(training)))})
    return run.best


@dataclass
class _Run:
    """A training run between two reports; bodies on their way are part of what the optimiser remembers."""

    training: PolicyTraining
    folder: Path
    base: Policy
    progress: Progress
    pool: Array
    """(P, I) starts."""
    checked: Swimmers
    identity: str
    began: float = field(default_factory=time.monotonic)

    @classmethod
    def prepare(
        cls, emulator: Emulator, system: System, training: PolicyTraining, folder: Path
    ) -> _Run:
        rng = np.random.default_rng([training.seed, 21])
        ranges = command_ranges(emulator)
        base = fresh_policy(emulator, ranges, training.widths, training.seed)
        starts = np.asarray(
            emulator.encode(sample_starts(system, rng, training.starts)), np.float32
        )
        kept, pool = (
            jnp.asarray(part) for part in np.split(starts, [round(CHECKED_SHARE * len(starts))])
        )
        checked = begin(base, kept, jax.random.key(training.seed + 1))
        key = jax.random.fold_in(jax.random.key(training.seed), 2**30)
        swimmers = begin(base, jax.random.choice(key, pool, (training.batch,)), key)
        optimizer = make_optimizer(training)
        memory = optimizer.init(eqx.filter(base.network, eqx.is_array)), swimmers
        fresh = Progress(base.network, memory, base.network, 1e30, 0, 0)
        contents = {"starts": starts, **tensors_of(emulator)}
        identity = f"{digest(contents)[:16]}-{canonical_json(asdict(training))}"
        return cls(
            training,
            folder,
            base,
            read_checkpoint(folder, identity, fresh),
            pool,
            checked,
            identity,
        )

    @property
    def is_over(self) -> bool:
        return self.progress.chunk * UPDATES_PER_REPORT >= self.training.updates

    @property
    def best(self) -> Policy:
        return eqx.tree_at(lambda policy: policy.network, self.base, self.progress.best)

    def advance(self) -> PolicyReport:
        """Train until the next report, then validate, log and checkpoint."""
        progress = self.progress
        network, memory, loss = _train_chunk(
            self.training,
            self.base,
            progress.network,
            progress.optimizer_state,
            self.pool,
            jnp.asarray(progress.chunk),
        )
        progress = progress._replace(
            network=network, optimizer_state=memory, chunk=progress.chunk + 1
        )
        steps = round(CHECKED_SECONDS / self.base.dt)
        validation = float(_validate(self.training, self.base, network, self.checked, steps))
        self.progress = progress.judged(validation)
        update, seconds = progress.chunk * UPDATES_PER_REPORT, time.monotonic() - self.began
        report = PolicyReport(update, float(loss), validation, seconds)
        write_checkpoint(self.folder, self.identity, self.progress)
        append_line(self.folder / "metrics.jsonl", json.dumps(report._asdict()))
        return report


def command_ranges(emulator: Emulator) -> Bounds:
    """Return the range of each command: speeds up to nearly that of the gait at full strength."""
    speed = STEERABLE * gait_speed(emulator)
    return Bounds((0.0, *(-MAX_TURN,) * 3), (speed, *(MAX_TURN,) * 3))


def gait_speed(emulator: Emulator) -> float:
    """Return how fast the gait drives the emulated body once it is under way [m/s]."""
    identity = emulator.spec
    if identity.gait is None:
        raise ArgumentError(
            f"The system {identity.system} has no gait. Give its definition one, to know its speed."
        )
    steps, period = (
        round(GAIT_SECONDS / emulator.dt),
        max(1, round(identity.gait.period / emulator.dt)),
    )
    controls = identity.gait.controls(steps, emulator.dt, identity.bounds)
    latent = emulator.encode(emulator.rollout(np.array(identity.rest), controls))
    way = latent[-1, :3] - latent[-1 - 2 * period, :3]
    return float(np.linalg.norm(way)) / (2 * period * emulator.dt)


def make_optimizer(training: PolicyTraining) -> optax.GradientTransformation:
    """Return Adam with clipped gradients and a rate that falls to nothing."""
    rate = optax.cosine_decay_schedule(training.learning_rate, training.updates)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adam(rate))


@eqx.filter_jit
def _train_chunk(
    training: PolicyTraining,
    base: Policy,
    network: Network,
    memory: tuple,
    pool: Array,
    chunk: Array,
) -> tuple[Network, tuple, Array]:
    """Return (network, (optimiser state, bodies), mean loss) after one chunk of updates.

    Random numbers follow from the seed and the chunk's number alone, so that a resumed run sees the same.
    """
    optimizer, key = (
        make_optimizer(training),
        jax.random.fold_in(jax.random.key(training.seed), chunk),
    )

    def loss_of(network: Network, swimmers: Swimmers) -> tuple[Array, Swimmers]:
        policy = eqx.tree_at(lambda policy: policy.network, base, network)
        following, path, controls = swim(policy, swimmers, training.steps)
        return motion_loss(training.weights, policy, swimmers, path, controls), following

    def update(carry, key):
        network, (state, swimmers) = carry
        (loss, following), gradient = jax.value_and_grad(loss_of, has_aux=True)(network, swimmers)
        step, state = optimizer.update(gradient, state)
        following = _renewed(base, jax.lax.stop_gradient(following), pool, key)
        return (eqx.apply_updates(network, step), (state, following)), loss

    (network, memory), losses = jax.lax.scan(
        update, (network, memory), jax.random.split(key, UPDATES_PER_REPORT)
    )
    return network, memory, losses.mean()


def _renewed(policy: Policy, swimmers: Swimmers, pool: Array, key: Array) -> Swimmers:
    """Return the bodies, some put back to random starts and some with another course."""
    keys, count = jax.random.split(key, 4), len(swimmers.phase)
    is_fresh = jax.random.bernoulli(keys[0], FRESH_SHARE, (count,))
    is_fresh |= ~jnp.isfinite(swimmers.latent).all(axis=1)
    is_sent = is_fresh | jax.random.bernoulli(keys[1], NEW_COURSE_SHARE, (count,))
    latent = jnp.where(
        is_fresh[:, None], jax.random.choice(keys[2], pool, (count,)), swimmers.latent
    )
    other = begin(policy, latent, keys[3])
    course = jax.tree.map(
        lambda new, old: jnp.where(is_sent.reshape(-1, *(1,) * (new.ndim - 1)), new, old),
        other.course,
        swimmers.course,
    )
    return Swimmers(latent, jnp.where(is_fresh, other.phase, swimmers.phase), course)


@eqx.filter_jit
def _validate(
    training: PolicyTraining, base: Policy, network: Network, swimmers: Swimmers, steps: int
) -> Array:
    policy = eqx.tree_at(lambda policy: policy.network, base, network)
    _, path, controls = swim(policy, swimmers, steps)
    return motion_loss(training.weights, policy, swimmers, path, controls)
