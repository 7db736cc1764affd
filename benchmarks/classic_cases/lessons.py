"""Networks of 1998 trained on transitions of a system, several seeds at a time, and their errors on unseen runs."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PRNGKeyArray

import neuroanimator as na
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.data.store import Transitions
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks import make_network
from neuroanimator.emulator.networks.network import Network
from neuroanimator.emulator.super_step import rollout
from neuroanimator.evaluation.accuracy import error_after, rollout_error, root_mean_square
from neuroanimator.evaluation.held_out import HeldOut, held_out_runs
from neuroanimator.state.structure import Structure
from neuroanimator.training.chunk import RestStreams, with_network
from neuroanimator.training.initialise import build_emulator
from neuroanimator.training.lesson import keeps_still
from neuroanimator.training.loss import squared_error
from neuroanimator.training.recipes import RECIPES
from neuroanimator.training.survey import base_windows

NetworkOf = Callable[[PRNGKeyArray], Network]
"""key → a fresh network."""

Sampler = Callable[[PRNGKeyArray, Array], Any]
"""(key of the update, its number) → rows of its batch."""

PLAIN = "plain"
"""Inputs as in 1998: the numbers of state and control as they are; of a deformable body those of its shapes."""

FEATURES = "features"
"""Inputs as the package has them: sines and cosines of angles, and the mirror."""


SAMPLES_PER_RUN = 36
"""Number of super steps of a simulated run that become examples: physics costs more than storing."""


TEST_SECONDS = 2.0
"""Length of an unseen run [s]."""


@dataclass(frozen=True)
class Lesson:
    """Windows of one super step of a system, what normalises them, and unseen runs."""

    base: Emulator
    """The emulator whose network is replaced by those that are trained."""
    rest: RestStreams | None
    """Network inputs at rest; None where the body does not keep still, or where nobody asks it to."""
    states: Float[Array, "N 2 I"]
    """Latent states, before and after."""
    controls: Float[Array, "N 1 C"]
    """Latent controls between them."""
    test: HeldOut

    @classmethod
    def of(cls, system: str, substeps: int, count: int, inputs: str) -> Lesson:
        """Return the lesson of `count` transitions of `system` over `substeps` physics steps."""
        config = na.DatasetConfig(
            system=system, substeps=substeps, count=count, samples_per_run=SAMPLES_PER_RUN
        )
        data = simulate_transitions(config)
        if inputs == PLAIN:
            data = with_plain_state(data)
        position_modes, velocity_modes = RECIPES[system].modes
        settings = na.TrainingConfig(
            network="classic", position_modes=position_modes, velocity_modes=velocity_modes
        )
        base = build_emulator(data, settings)
        rest = None
        if inputs == PLAIN:
            features = replace(base.features, is_odd=False)
            base = replace(base, features=features)
        elif keeps_still(data.system, base):
            rest = base.rest_streams()
        windows = base_windows(base, data)
        return cls(
            base=base,
            rest=rest,
            states=as_jax(windows.states[:, :2]),
            controls=as_jax(windows.controls[:, :1]),
            test=held_out_runs(base, seconds=TEST_SECONDS),
        )

    @property
    def size(self) -> int:
        """Number of transitions."""
        return self.states.shape[0]

    def network(self, kind: str, widths: tuple[int, ...]) -> NetworkOf:
        """Return what draws networks of this `kind`: "classic" has one hidden layer of logistic units."""
        raw = self.base.raw_features(self.states[0, 0], self.controls[0, 0])
        others = raw.shape[-1] - len(self.base.features.plain)
        odd, even = self.base.features.sizes(others)
        out = self.base.network.leaves()["out.weight"].shape[1]
        return lambda key: make_network(kind, odd, even, out, widths, key)

    def emulator(self, network: Network) -> Emulator:
        """Return the emulator with this `network`."""
        return with_network(self.base, network, self.rest)

    def loss(
        self, network: Network, states: Float[Array, "B 2 I"], controls: Float[Array, "B 1 C"]
    ) -> Float[Array, ""]:
        """Return the mean squared error (eq. 5), in units of the change's variance."""
        return jnp.mean(squared_error(self.emulator(network), states, controls))

    def one_step_error(self, network: Network) -> float:
        """Return the root mean square one-step error on unseen runs, over the standard deviation of the change."""
        test = self.test
        starts, controls, truth = test.transitions
        following = rollouts(self.emulator(network), starts, controls[:, None])[:, 1]
        errors = test.frame.difference(truth, np.asarray(following, float))
        return float(root_mean_square(test.relative(errors), axis=(0, 1)))

    def error_after(self, network: Network, seconds: float) -> float:
        """Return the error of rollouts after `seconds` on unseen runs, over the distance the truth gets by then."""
        emulator = self.emulator(network)
        test = self.test
        emulated = np.asarray(rollouts(emulator, test.states[:, 0], test.controls), float)
        along = rollout_error(test.frame, emulated, test.states)
        return error_after(along, emulator.dt, seconds)


def with_plain_state(data: Transitions) -> Transitions:
    """Return `data` of the same system, whose numbers a network is shown as they are: no sines, no mirror."""
    system = copy.copy(data.system)
    size = system.state.size
    system.structure = Structure(
        angles=(), rates=system.structure.rates, plain=tuple(range(size)), is_odd=False
    )
    return replace(data, system=system)


@eqx.filter_jit
def rollouts(
    emulator: Emulator, starts: Float[Any, "B S"], controls: Float[Any, "B T C"]
) -> Float[Array, "B F S"]:
    """Return the trajectories (B, T+1, S); a motion may come to numbers that are not finite."""
    of_one = jax.vmap(lambda start, held: rollout(emulator, start, held))
    return of_one(jnp.asarray(starts, jnp.float32), jnp.asarray(controls, jnp.float32))


def random_batches(size: int, rows: int) -> Sampler:
    """Return what draws `size` of so many rows at random."""
    return lambda key, update: jax.random.randint(key, (size,), 0, rows)


def train_side_by_side(
    lesson: Lesson,
    network_of: NetworkOf,
    optimizer: optax.GradientTransformation,
    sampler: Sampler,
    stops: tuple[int, ...],
    seeds: int,
) -> list[list[Network]]:
    """Return the networks of the seeds 0, 1, … after each number of updates in `stops`; one program trains them all."""
    keys = jax.vmap(jax.random.key)(jnp.arange(seeds))
    fresh = [network_of(keys[seed]) for seed in range(seeds)]
    networks = jax.tree.map(lambda *leaves: jnp.stack(leaves), *fresh)
    states = eqx.filter_vmap(optimizer.init)(networks)

    def update_of(key: PRNGKeyArray, number: Array, carry: tuple[Any, Any]) -> Any:
        network, state = carry
        rows = sampler(jax.random.fold_in(key, number), number)
        gradient = jax.grad(lesson.loss)(network, lesson.states[rows], lesson.controls[rows])
        step, state = optimizer.update(gradient, state, network)
        return eqx.apply_updates(network, step), state

    @eqx.filter_jit
    def advance(networks: Network, states: Any, first: Array, last: Array) -> Any:
        def of_seed(network: Network, state: Any, key: PRNGKeyArray) -> Any:
            update = partial(update_of, key)
            return jax.lax.fori_loop(first, last, update, (network, state))

        return eqx.filter_vmap(of_seed)(networks, states, keys)

    snapshots = []
    done = 0
    for stop in stops:
        networks, states = advance(networks, states, jnp.array(done), jnp.array(stop))
        snapshots.append([_part(networks, seed) for seed in range(seeds)])
        done = stop
    return snapshots


def _part(networks: Network, seed: int) -> Network:
    """Return the network of one seed."""
    return jax.tree.map(lambda leaf: leaf[seed], networks)
