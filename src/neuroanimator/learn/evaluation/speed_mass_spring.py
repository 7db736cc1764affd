"""The opponent of an emulator of a deformable body: its C twin, or the JAX physics where nothing compiles C."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from neuroanimator.learn.evaluation.accuracy import runs_error, scheme_error
from neuroanimator.learn.evaluation.held_out import HeldOut
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.physics.deformable.mass_spring import BodyState, advance
from neuroanimator.physics.deformable.native.compiled import INTEGRATORS, c_twin
from neuroanimator.systems.system import Runs, Scheme

C_TWIN = "C twin"
"""Name in reports of the body's physics in C, generated for this body: the fastest physics."""

JAX = "JAX"
"""Name in reports of the body's physics where there is no C compiler."""

NO_COMPILER = "There was no C compiler, so the physics is timed in JAX; a C twin would be faster, and speed-ups smaller."
"""Sentence on speed-ups against JAX."""

Player = Callable[[], Any]
"""A function that is timed."""


def deformable_players(
    system: DeformableSystem, test: HeldOut, steps: int, pieces: int
) -> tuple[str, dict[str, Player]]:
    """Return the name of the physics, and by integrator a function that takes `steps` steps, already compiled.

    As for MuJoCo, the steps are taken in `pieces`, each from an unseen state under its control.
    """
    starts, controls = test.moments(pieces)
    length = steps // pieces
    twin = c_twin(system.body)
    players: dict[str, Player] = {}
    if twin is None:
        for integrator in INTEGRATORS:
            players[integrator] = _one_by_one(system, starts, controls, integrator, length)
        return JAX, players
    dt = system.physics_dt
    for integrator in INTEGRATORS:
        players[integrator] = twin.player(starts, controls, integrator, dt, length)
    return C_TWIN, players


def _one_by_one(
    system: DeformableSystem,
    starts: Float[np.ndarray, "N S"],
    controls: Float[np.ndarray, "N C"],
    integrator: str,
    steps: int,
) -> Player:
    """Return a function that takes `steps` steps in JAX from each start, already compiled."""
    run = jax_run(system, integrator, steps)
    begins = []
    for start, control in zip(starts, controls, strict=True):
        begins.append((body_state_of(system, start[None]), jnp.asarray(control)))
    run(*begins[0])
    return lambda: jax.block_until_ready([run(*begin) for begin in begins])


def jax_run(
    system: DeformableSystem, integrator: str, steps: int
) -> Callable[[BodyState, jax.Array], BodyState]:
    """Return the JAX physics of `steps` steps of the system's own length as a compiled function."""
    return jax.jit(partial(advance, system.body, integrator, system.physics_dt, steps))


def body_state_of(system: DeformableSystem, states: Float[np.ndarray, "B S"]) -> BodyState:
    """Return states in the physics' layout, in float32: (N, 3, B), without the batch for one body."""
    arrays = []
    for part in system.unpack(states):
        last = np.moveaxis(part, 0, -1)
        if len(states) == 1:
            last = last[..., 0]
        arrays.append(jnp.asarray(last, jnp.float32))
    return BodyState(*arrays)


def twin_error(test: HeldOut, scheme: Scheme) -> float:
    """Return `scheme_error` by the C twin in float64: equal up to rounding, and compiled once for all steps."""
    system = test.system
    assert isinstance(system, DeformableSystem)
    twin = c_twin(system.body, np.float64)
    if twin is None:
        return scheme_error(test, scheme)
    starts, controls, _ = test.transitions
    ends = twin.advance(starts, controls, scheme.integrator, scheme.dt, scheme.steps(test.dt))
    states = np.stack([starts, ends], axis=1)
    return runs_error(test, Runs(states, system.has_diverged(states)))
