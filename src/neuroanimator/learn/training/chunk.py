"""One compiled chunk of updates, which a training run repeats."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks.network import Network
from neuroanimator.learn.training.batches import (
    draw_batches,
    draw_first_steps,
    folded,
    parts_of,
    seen_by,
)
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.learn.training.loss import calm_weights, robust_loss, unrolled_loss
from neuroanimator.learn.training.optimizer import make_optimizer
from neuroanimator.state.shape_contacts import FREE
from neuroanimator.state.structure import Structure
from neuroanimator.state.symmetry import Symmetry

RestStreams = tuple[Float[Array, " O"], Float[Array, " E"]]
"""Network inputs at rest: see `Emulator.rest_streams`."""


VARYING = ("seed", "updates", "patience", "validation_share", "memory")
"""Settings that the compiled chunk does not depend on."""


class TrainingProblem(eqx.Module):
    """The constants of every update of a run."""

    config: TrainingConfig = eqx.field(static=True)
    structure: Structure = eqx.field(static=True)
    """Structure of the system's states."""
    symmetries: tuple[Symmetry, ...] = eqx.field(static=True)
    """Symmetries under which every window may be transformed."""
    base: Emulator
    """The emulator whose network is trained."""
    rest: RestStreams | None
    """Network inputs at rest; None if the system does not stay there."""

    @property
    def of_any_run(self) -> TrainingProblem:
        """The same without what differs between runs of one kind, so that a chunk is compiled once for all."""
        usual = TrainingConfig.model_fields
        varying = {name: usual[name].default for name in VARYING}
        return replace(self, config=self.config.model_copy(update=varying))


class WindowsInMemory(eqx.Module):
    """The windows from which batches are drawn."""

    states: Float[Array, "N T I"]
    """Windows of T = H + 1 latent states."""
    controls: Float[Array, "N H C"]
    """Latent controls between them."""
    rare: Int[Array, " M"]
    """Rows of the windows with the most unusual changes; none if no share of a minibatch is drawn from them."""
    count: Int[Array, ""]
    """Number of windows. The arrays may have more rows, so that a chunk is compiled once for many counts."""


class RunPosition(NamedTuple):
    """Where a chunk is in a run, as arrays: Python numbers would be compiled in, and every chunk and run recompiled."""

    seed: Int[Array, ""]
    updates: Int[Array, ""]
    """Number of updates in the whole run."""
    chunk: Int[Array, ""]

    @classmethod
    def of(cls, config: TrainingConfig, chunk: int) -> RunPosition:
        """Return the position of chunk number `chunk`."""
        return cls(*(as_jax(n, np.int32) for n in (config.seed, config.whole_updates, chunk)))


def with_network(base: Emulator, network: Network, rest: RestStreams | None) -> Emulator:
    """Return `base` with another network, which, given its inputs at rest, stays at rest there."""
    emulator = eqx.tree_at(lambda emulator: emulator.network, base, network)
    if rest is None:
        return emulator
    return emulator.at_rest(rest)


completed = eqx.filter_jit(with_network)
"""`with_network` as one compiled function, for use outside compiled code."""


@eqx.filter_jit
def train_chunk(
    problem: TrainingProblem,
    windows: WindowsInMemory,
    network: Network,
    optimizer_state: Any,
    position: RunPosition,
    unroll: int,
) -> tuple[Network, Any, Float[Array, ""]]:
    """Return (network, optimiser state, mean loss) after the chunk at `position`, whose loss spans `unroll` super steps.

    Batches follow from the seed and the chunk's number alone, so that a resumed run sees the same.
    """
    config = problem.config
    size = config.batch_at(unroll)
    key = jax.random.fold_in(jax.random.key(position.seed), position.chunk)
    rows = windows.states.shape[0] if config.rare_share else windows.count
    rows_of_updates, weights = draw_batches(key, size, rows, windows.rare, config.rare_share)

    steps = windows.controls.shape[1]
    first_of_updates = draw_first_steps(key, rows_of_updates.shape, steps, unroll)

    def loss_of(
        network: Network, rows: Int[Array, " B"], first: Int[Array, " B"]
    ) -> Float[Array, ""]:
        row_weights = None if weights is None else weights[rows]
        fold_key = jax.random.fold_in(key, rows[0])
        states, controls = parts_of(windows.states, windows.controls, rows, first, unroll)
        return _batch_loss(problem, network, fold_key, states, controls, row_weights)

    optimizer = make_optimizer(config, position.updates)

    def update(
        carry: tuple[Any, Any], drawn: tuple[Int[Array, " B"], Int[Array, " B"]]
    ) -> tuple[tuple[Any, Any], Float[Array, ""]]:
        network, optimizer_state = carry
        loss, gradient = jax.value_and_grad(loss_of)(network, *drawn)
        step, optimizer_state = optimizer.update(gradient, optimizer_state, network)
        return (eqx.apply_updates(network, step), optimizer_state), loss

    start = (network, optimizer_state)
    drawn = (rows_of_updates, first_of_updates)
    (network, optimizer_state), losses = jax.lax.scan(update, start, drawn)
    return network, optimizer_state, losses.mean()


def _batch_loss(
    problem: TrainingProblem,
    network: Network,
    fold_key: PRNGKeyArray,
    states: Float[Array, "N F I"],
    controls: Float[Array, "N H C"],
    weights: Float[Array, " N"] | None,
) -> Float[Array, ""]:
    """Return the loss of some windows, each unchanged or under one of the symmetries."""
    structure = problem.structure
    emulator = with_network(problem.base, network, problem.rest)
    if problem.symmetries:
        view_key = jax.random.fold_in(fold_key, 1)
        states, controls = seen_by(problem.symmetries, view_key, states, controls)
    if structure.symmetry_order > 1:
        states, controls = folded(structure, problem.base.frame, fold_key, states, controls)
    growth = problem.config.error_growth
    contacts = structure.shape_contacts
    if contacts is not None and contacts.anchor == FREE:
        return robust_loss(emulator, states, controls, growth)
    if problem.config.calm > 0:
        calm = calm_weights(emulator, states, problem.config.calm)
        weights = calm if weights is None else weights * calm
    return unrolled_loss(emulator, states, controls, weights, growth)
