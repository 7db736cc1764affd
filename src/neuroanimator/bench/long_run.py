"""Does a deformable body keep its shape over a hundred thousand super steps?"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator.bench.spring_relaxation import Correction, follow_corrected
from neuroanimator.data.sampling import sample_control_runs, sample_starts
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.state.reference_shape import points_of
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.systems.deformable.mass_spring import BodyState, internal_energy, strains

BLOCK = 500
"""Super steps rolled out at once."""
LOOKED_AT = 25
"""Super steps from one look at the body to the next."""
MEASURES = ("strain", "energy", "shape")


@dataclass(frozen=True)
class LongRun:
    """The extremes of a body's shape, over those training showed."""

    steps: int
    alive: int
    """Starts whose numbers stayed finite."""
    starts: int
    worst: dict[str, float]
    """Per measure, the largest seen over the largest in training."""
    typical: dict[str, float]
    """Per measure, the median in the last tenth of the run over the median in training."""
    inside: int
    """Starts that stayed within what training showed plus a tenth, in every measure."""


def measures(system: DeformableSystem, states: np.ndarray | jax.Array) -> jax.Array:
    """Return (3, ...) of states (..., S): largest strain, inner energy [J], rms distance of the shape from rest [m]."""
    size, cloud = 3 * len(system.body.masses), system.structure.cloud
    assert cloud is not None
    rows = jnp.asarray(states).reshape(-1, states.shape[-1])
    parts = points_of(rows[:, :size]), points_of(rows[:, size : 2 * size]), rows[:, 2 * size :]
    motion = BodyState(*(jnp.moveaxis(part, 0, -1) for part in parts))
    seen = cloud.own_frame(parts[0])[2]
    shape = jnp.sqrt(
        jnp.mean(jnp.sum((seen - jnp.asarray(cloud.positions)) ** 2, axis=-1), axis=-1)
    )
    strain = jnp.abs(strains(system.body, motion.positions)).max(axis=0)
    found = jnp.stack([strain, internal_energy(system.body, motion), shape])
    return found.reshape(3, *states.shape[:-1])


def measure_long_run(
    emulator: Emulator,
    system: DeformableSystem,
    training: np.ndarray,
    correction: Correction | None,
    *,
    every: int = 1,
    is_bounded: bool = True,
    starts: int = 100,
    steps: int = 100_000,
    seed: int = 3,
) -> LongRun:
    """Return how far bodies stray under random swimming, against the states `training` (N, S) showed."""
    rng = np.random.default_rng(seed)
    known = np.asarray(
        jax.jit(lambda states: measures(system, states))(jnp.asarray(training, jnp.float32))
    )
    latent = jnp.asarray(emulator.encode(sample_starts(system, rng, starts)), jnp.float32)
    way = partial(
        follow_corrected, emulator, correction=correction, every=every, is_bounded=is_bounded
    )
    decode = emulator.decode
    roll = eqx.filter_jit(lambda latent, controls: _block(way, decode, system, latent, controls))
    largest, late = np.zeros((3, starts)), []
    for done in range(0, steps, BLOCK):
        controls = sample_control_runs(rng, starts, BLOCK, emulator.dt, system)
        latent, seen = roll(latent, jnp.asarray(emulator.encode_control(controls), jnp.float32))
        seen = np.asarray(seen)
        largest = np.maximum(largest, np.where(np.isfinite(seen), seen, np.inf).max(axis=2))
        late += [seen] if done + BLOCK > 0.9 * steps else []
    ratios = largest / known.max(axis=1)[:, None]
    middle = np.median(np.concatenate(late, axis=2), axis=(1, 2)) / np.median(known, axis=1)
    return LongRun(
        steps=steps,
        alive=int(np.isfinite(largest).all(axis=0).sum()),
        starts=starts,
        worst=dict(zip(MEASURES, map(float, ratios.max(axis=1)), strict=True)),
        typical=dict(zip(MEASURES, map(float, middle), strict=True)),
        inside=int((ratios <= 1.1).all(axis=0).sum()),
    )


def _block(way, decode, system, latent, controls):
    """Return (states at the end, measures (3, B, looks)) of a block of super steps."""
    path = jax.vmap(way)(latent, controls)
    return path[:, -1], measures(system, decode(path[:, LOOKED_AT - 1 :: LOOKED_AT]))
