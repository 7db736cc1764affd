"""Every shipped system over a million super steps, at rest and under random controls; writes long_runs.csv.

python -m benchmarks.lasting.long_runs          about a quarter of an hour on 2 cores
python -m benchmarks.lasting.long_runs --quick  10,000 super steps; writes no file
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from benchmarks.harness import keep_rows, parser_of, show_rows
from neuroanimator import Emulator, load_emulator, load_system
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.super_step import rollout_latent
from neuroanimator.systems.random_controls import sample_control_runs
from neuroanimator.systems.system import System

SYSTEMS = ("pendulum", "truck", "lander", "fish", "dolphin")
"""The systems measured, those that an emulator ships of."""

STEPS = 1_000_000
"""The super steps of a run."""

QUICK_STEPS = 10_000
"""The super steps of a run with --quick."""

STARTS = 8
"""Number of motions driven by random controls, all from rest."""

BLOCK = 1_000
"""Number of super steps rolled out at once: a million would take gigabytes."""

PHYSICS_SECONDS = 60.0
"""Time for which the physics is left at rest [s]: after that nothing is new."""

RANGE_SCALE = 1.1
"""Maximum multiple of its range in training within which a feature is inside."""

SEED = 7
"""The random controls are drawn from this seed."""

_rollouts = eqx.filter_jit(jax.vmap(rollout_latent, in_axes=(None, 0, 0)))


def moved(states: Float[np.ndarray, "T S"]) -> float:
    """Return the largest distance of any state entry from where `states` begin [m, rad, m/s or rad/s]."""
    return float(np.abs(states - states[0]).max())


def physics_at_rest(system: System, dt: float) -> float:
    """Return how far the physics strays at rest, without control."""
    controls = np.tile(system.bounds.idle, (1, round(PHYSICS_SECONDS / dt), 1))
    runs = system.simulate(system.rest[None], controls, dt, scheme=system.scheme)
    return moved(runs.states[0])


def emulator_at_rest(emulator: Emulator, steps: int) -> tuple[float, float]:
    """Return how far the emulator strays at rest, without control: in a minute, and in `steps` super steps."""
    idle = emulator.bounds.idle
    minute = np.tile(idle, (round(PHYSICS_SECONDS / emulator.dt), 1))
    in_a_minute = moved(np.asarray(emulator.rollout(emulator.rest, minute), float)[1:])
    latent = emulator.encode(as_jax(emulator.rest))
    controls = emulator.encode_control(as_jax(np.tile(idle, (BLOCK, 1))))
    first = np.asarray(_rollouts(emulator, latent[None], controls[None])[:, 0])
    furthest = 0.0
    current = jnp.asarray(first)
    for _ in range(0, steps, BLOCK):
        path = np.asarray(_rollouts(emulator, current, controls[None]))
        distances = np.abs(emulator.decode(path[0]) - emulator.decode(first))
        furthest = max(furthest, float(distances.max()))
        current = jnp.asarray(path[:, -1])
    return in_a_minute, furthest


def driven(emulator: Emulator, system: System, steps: int) -> dict[str, float]:
    """Return how many motions under random controls stay finite and within the range of training, and how high."""
    rng = np.random.default_rng(SEED)
    start = emulator.encode(as_jax(emulator.rest))
    current = jnp.tile(start, (STARTS, 1))
    is_alive = np.ones(STARTS, bool)
    is_inside = np.ones(STARTS, bool)
    low, high = emulator.domain.widened(RANGE_SCALE - 1, slice(None))
    low = np.asarray(low, float)
    high = np.asarray(high, float)
    for _ in range(0, steps, BLOCK):
        controls = sample_control_runs(rng, STARTS, BLOCK, emulator.dt, system)
        encoded = jnp.asarray(emulator.encode_control(controls), jnp.float32)
        path = np.asarray(_rollouts(emulator, current, encoded))
        features = np.asarray(emulator.features.plain_of(path, emulator.frame.local(path)))
        count = features.shape[-1]
        is_in_range = (features >= low[:count]) & (features <= high[:count])
        is_alive &= np.isfinite(path).all(axis=(1, 2))
        is_inside &= is_in_range.all(axis=(1, 2))
        current = jnp.asarray(path[:, -1])
    return {
        "random_starts": STARTS,
        "random_alive": int(is_alive.sum()),
        "random_inside": int(is_inside.sum()),
    }


def row(name: str, steps: int) -> dict[str, Any]:
    """Return one system's row."""
    emulator = load_emulator(f"{name}-50")
    system = load_system(name)
    in_a_minute, in_all = emulator_at_rest(emulator, steps)
    at_rest = {
        "system": name,
        "super_steps": steps,
        "physics_moves_in_60_s": physics_at_rest(system, emulator.dt),
        "emulator_moves_in_60_s": in_a_minute,
        "emulator_moves_in_all": in_all,
    }
    return at_rest | driven(emulator, system, steps)


def main() -> None:
    parser = parser_of(__doc__, quick="10,000 super steps")
    options = parser.parse_args()
    steps = QUICK_STEPS if options.quick else STEPS
    rows = [row(name, steps) for name in SYSTEMS]
    show_rows(rows)
    keep_rows(Path(__file__).with_name("long_runs.csv"), rows, options)


if __name__ == "__main__":
    main()
