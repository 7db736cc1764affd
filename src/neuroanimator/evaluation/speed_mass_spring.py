"""The opponent of an emulator of a deformable body: its C twin, or the JAX physics where nothing compiles C."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator.evaluation.accuracy import HeldOut, runs_error, scheme_error
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.systems.deformable.mass_spring import BodyState, advance
from neuroanimator.systems.deformable.native.compiled import INTEGRATORS, SINGLE_LANES, c_twin
from neuroanimator.systems.deformable.native.reference_loop import plain_player
from neuroanimator.systems.system import Runs, Scheme

C_TWIN, JAX = "C twin", "JAX"

PLAIN = "plain C"
"""The own scheme as one writes it down in C, reading the body from tables as MuJoCo reads its model: what is nominal.
The fastest program for this one body, its C twin, is the opponent of equal error."""

NO_COMPILER = "no C compiler was found, so the physics is timed in JAX; a C twin would be faster, and speed-ups smaller."

BATCH_STEPS = 200
"""Physics steps of every body in one timed run of a batch."""

Player = Callable[[], Any]


def deformable_players(
    system: DeformableSystem, test: HeldOut, steps: int, stretches: int
) -> tuple[str, dict[str, Player]]:
    """Return who steps the physics, and by integrator a function that takes `steps` steps, already compiled.

    As for MuJoCo, an unseen state and its control begin each of the `stretches`.
    """
    starts, controls = test.moments(stretches)
    length, twin = steps // stretches, c_twin(system.body)
    if twin is not None:
        dt = system.physics_dt
        players: dict[str, Player] = {
            kind: twin.player(starts, controls, kind, dt, length) for kind in INTEGRATORS
        }
        plain = plain_player(system.body, starts, controls, dt, length)
        if plain is not None and system.scheme.integrator == "symplectic":
            players[PLAIN] = plain
        return C_TWIN, players
    return JAX, {kind: _one_by_one(system, starts, controls, kind, length) for kind in INTEGRATORS}


def _one_by_one(
    system: DeformableSystem, starts: np.ndarray, controls: np.ndarray, kind: str, steps: int
) -> Player:
    run = jax_run(system, kind, steps)
    motions = [
        (motion_of(system, start[None]), jnp.asarray(held))
        for start, held in zip(starts, controls, strict=True)
    ]
    run(*motions[0])
    return lambda: jax.block_until_ready([run(*each) for each in motions])


def jax_run(
    system: DeformableSystem, kind: str, steps: int
) -> Callable[[BodyState, jax.Array], BodyState]:
    """Return the JAX physics of `steps` steps of the system's own length as a compiled function."""
    return jax.jit(partial(advance, system.body, kind, system.physics_dt, steps))


def motion_of(system: DeformableSystem, states: np.ndarray) -> BodyState:
    """Return states (B, S) as a motion in float32: (N, 3, B), without the batch for one body."""
    parts = (np.moveaxis(part, 0, -1) for part in system.unpack(states))
    return BodyState(
        *(jnp.asarray(part[..., 0] if len(states) == 1 else part, jnp.float32) for part in parts)
    )


def twin_error(test: HeldOut, scheme: Scheme) -> float:
    """Return what `scheme_error` does, by the C twin in float64: equal to rounding, and compiled once for all steps."""
    system = test.system
    assert isinstance(system, DeformableSystem)
    twin = c_twin(system.body, np.float64)
    if twin is None:
        return scheme_error(test, scheme)
    starts, controls, _ = test.transitions
    ends = twin.advance(starts, controls, scheme.integrator, scheme.dt, scheme.steps(test.dt))
    states = np.stack([starts, ends], axis=1)
    return runs_error(test, Runs(states, system.is_sane(states)))


def deformable_schemes(
    system: DeformableSystem, dt: float, divisions: tuple[int, ...]
) -> set[Scheme]:
    """Return the ways to step the body through `dt` [s]; the reference is among them, for it has no error."""
    schemes = {Scheme(kind, dt / parts) for kind in INTEGRATORS for parts in divisions}
    return schemes | {system.scheme, system.truth, system.fine}


def random_bodies(system: DeformableSystem, batch: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random states (batch, S) and controls (batch, C) to time a batch from."""
    rng = np.random.default_rng(0)
    return system.sample_starts(rng, batch), rng.uniform(-1, 1, (batch, system.control.size))


def c_batch_players(
    system: DeformableSystem, batch: int, kind: str, steps: int = BATCH_STEPS
) -> dict[str, Player]:
    """Return the C twin stepping `batch` bodies one after another and side by side; nothing without a compiler."""
    starts, controls = random_bodies(system, batch)
    twins = {
        "in turn": c_twin(system.body),
        "side by side": c_twin(system.body, lanes=SINGLE_LANES),
    }
    return {
        name: twin.player(starts, controls, kind, system.physics_dt, steps)
        for name, twin in twins.items()
        if twin
    }


def jax_batch_player(
    system: DeformableSystem, batch: int, kind: str, steps: int = BATCH_STEPS
) -> Player:
    """Return the JAX physics stepping `batch` bodies, already compiled."""
    starts, controls = random_bodies(system, batch)
    motion, run = motion_of(system, starts), jax_run(system, kind, steps)
    held = jnp.asarray(controls[0] if batch == 1 else controls.T, jnp.float32)
    jax.block_until_ready(run(motion, held))
    return lambda: jax.block_until_ready(run(motion, held))
