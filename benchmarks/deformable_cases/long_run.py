"""How a deformable body's shape stays over a hundred thousand super steps of the emulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deformable_cases.spring_relaxation import Correction, rollout_relaxed
from neuroanimator.data.sampling import sample_control_runs, sample_starts
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.state.reference_shape import points_of
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.systems.deformable.mass_spring import BodyState, internal_energy, strains

BLOCK = 500
"""Number of super steps rolled out at once."""

MEASURED_EVERY = 25
"""Interval between measurements of the body [super steps]."""

MEASURES = ("strain", "energy", "shape")
"""What is measured: the largest strain, the energy within the body, and how far its shape is from rest."""

LATE = 0.9
"""What comes after this share of the run counts as late."""

TOLERANCE = 1.1
"""Maximum ratio of a measure to the largest in training for a body to stay within what training showed."""


@dataclass(frozen=True)
class LongRun:
    """The extremes of a body's shape, over those training showed."""

    steps: int
    alive: int
    """Starts whose numbers stayed finite."""
    starts: int
    worst: dict[str, float]
    """Per measure, the largest of the run over the largest in training."""
    typical: dict[str, float]
    """Per measure, the median in the last tenth of the run over the median in training."""
    inside: int
    """Starts that stayed within what training showed plus a tenth, in every measure."""


def measures(system: DeformableSystem, states: Float[Array, "*B S"]) -> Float[Array, "K ..."]:
    """Return the largest strain, the energy within [J], and the rms distance of the shape from rest [m]."""
    size = 3 * len(system.body.masses)
    cloud = system.structure.cloud
    assert cloud is not None
    rows = states.reshape(-1, states.shape[-1])
    positions = points_of(rows[:, :size])
    velocities = points_of(rows[:, size : 2 * size])
    activations = rows[:, 2 * size :]
    body_state = BodyState(
        jnp.moveaxis(positions, 0, -1),
        jnp.moveaxis(velocities, 0, -1),
        jnp.moveaxis(activations, 0, -1),
    )
    _, _, shape = cloud.own_frame(positions)
    distance = jnp.sum((shape - jnp.asarray(cloud.positions)) ** 2, axis=-1)
    from_rest = jnp.sqrt(jnp.mean(distance, axis=-1))
    strain = jnp.abs(strains(system.body, body_state.positions)).max(axis=0)
    energy = internal_energy(system.body, body_state)
    return jnp.stack([strain, energy, from_rest]).reshape(3, *states.shape[:-1])


def measure_long_run(
    emulator: Emulator,
    system: DeformableSystem,
    training: Float[np.ndarray, "N S"],
    correction: Correction | None,
    *,
    every: int = 1,
    is_bounded: bool = True,
    starts: int = 100,
    steps: int = 100_000,
    seed: int = 3,
) -> LongRun:
    """Return how far bodies stray under random swimming, against the states `training` showed."""
    rng = np.random.default_rng(seed)
    measure = jax.jit(lambda states: measures(system, states))
    known = np.asarray(measure(jnp.asarray(training, jnp.float32)))
    latent = jnp.asarray(emulator.encode(sample_starts(system, rng, starts)), jnp.float32)
    roll = partial(
        rollout_relaxed, emulator, correction=correction, every=every, is_bounded=is_bounded
    )
    roll_block = eqx.filter_jit(
        lambda latent, controls: _roll_block(roll, emulator, system, latent, controls)
    )
    largest = np.zeros((3, starts))
    late = []
    for done in range(0, steps, BLOCK):
        controls = sample_control_runs(rng, starts, BLOCK, emulator.dt, system)
        encoded = jnp.asarray(emulator.encode_control(controls), jnp.float32)
        latent, block = roll_block(latent, encoded)
        block = np.asarray(block)
        finite = np.where(np.isfinite(block), block, np.inf)
        largest = np.maximum(largest, finite.max(axis=2))
        if done + BLOCK > LATE * steps:
            late.append(block)
    ratios = largest / known.max(axis=1)[:, None]
    medians = np.median(np.concatenate(late, axis=2), axis=(1, 2)) / np.median(known, axis=1)
    return LongRun(
        steps=steps,
        alive=int(np.isfinite(largest).all(axis=0).sum()),
        starts=starts,
        worst=dict(zip(MEASURES, ratios.max(axis=1).tolist(), strict=True)),
        typical=dict(zip(MEASURES, medians.tolist(), strict=True)),
        inside=int((ratios <= TOLERANCE).all(axis=0).sum()),
    )


def _roll_block(
    roll: Callable[[Array, Array], Array],
    emulator: Emulator,
    system: DeformableSystem,
    latent: Float[Array, "B L"],
    controls: Float[Array, "B T C"],
) -> tuple[Float[Array, "B L"], Float[Array, "K B M"]]:
    """Return (latent states at the end, measures on the way) of a block of super steps."""
    path = jax.vmap(roll)(latent, controls)
    measured = emulator.decode(path[:, MEASURED_EVERY - 1 :: MEASURED_EVERY])
    return path[:, -1], measures(system, measured)
