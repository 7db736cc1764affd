"""Deformable bodies stepped many at a time, in C and in JAX."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from neuroanimator.learn.evaluation.speed_mass_spring import Player, body_state_of, jax_run
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.physics.deformable.native.compiled import SINGLE_LANES, c_twin

BATCH_STEPS = 200
"""Physics steps of every body in one timed run of a batch."""


def random_bodies(
    system: DeformableSystem, batch: int
) -> tuple[Float[np.ndarray, "B S"], Float[np.ndarray, "B C"]]:
    """Return random states and controls to time a batch from."""
    rng = np.random.default_rng(0)
    states = system.sample_starts(rng, batch)
    controls = rng.uniform(-1, 1, (batch, system.control.size))
    return states, controls


def c_batch_players(
    system: DeformableSystem, batch: int, integrator: str, steps: int = BATCH_STEPS
) -> dict[str, Player]:
    """Return the C twin stepping `batch` bodies one after another and side by side; nothing without a compiler."""
    starts, controls = random_bodies(system, batch)
    twins = {
        "in turn": c_twin(system.body),
        "side by side": c_twin(system.body, lanes=SINGLE_LANES),
    }
    players: dict[str, Player] = {}
    for name, twin in twins.items():
        if twin is not None:
            players[name] = twin.player(starts, controls, integrator, system.physics_dt, steps)
    return players


def jax_batch_player(
    system: DeformableSystem, batch: int, integrator: str, steps: int = BATCH_STEPS
) -> Player:
    """Return the JAX physics stepping `batch` bodies, already compiled."""
    starts, controls = random_bodies(system, batch)
    begin = body_state_of(system, starts)
    held = jnp.asarray(controls[0] if batch == 1 else controls.T, jnp.float32)
    run = jax_run(system, integrator, steps)
    jax.block_until_ready(run(begin, held))
    return lambda: jax.block_until_ready(run(begin, held))
