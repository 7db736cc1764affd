"""Whether an emulator's long rollouts behave as the physics does: how they spend their time, not where they are.

After seconds no two motions of a pendulum are alike, and comparing states says nothing. How fast they are, with how
much energy and in which postures, can be compared: as histograms over all super steps of many runs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.codegen.cores import core_count
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.learn.evaluation.accuracy import emulate
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.state.pose import read_pose
from neuroanimator.state.rotation import upward
from neuroanimator.systems.random_controls import sample_control_runs
from neuroanimator.systems.system import System

RUNS = 32
"""Number of runs of the physics, and of the emulator."""

STEPS = 10_000
"""Number of super steps of a run."""

BLOCK = 500
"""Number of super steps rolled out at once."""

EVERY = 5
"""Number of super steps between two samples: neighbours are alike."""

BINS = 32
"""Number of bins of a histogram: equally wide for an angle, else equally often visited by the physics."""

DRAWS = 200
"""Number of ways to halve the physics' runs."""

Z = 1.645
"""Number of standard errors from an estimate to its bounds: 90 % confidence."""

SEED = 11


class Drift(NamedTuple):
    """Difference between how physics and emulator spend their time, by one number."""

    quantity: str
    distance: float
    """Total variation: the share of the emulator's time that would have to be spent elsewhere to match the physics."""
    low: float
    high: float
    """Bounds of the distance with 90 % confidence, by leaving out one run after the other (jackknife)."""
    chance: float
    """The same distance between two halves of the physics' runs: what a small number of runs differs by anyway."""


NOT_ANGLES = ("kinetic energy", "speed")
"""Names of the quantities that are not angles within a whole turn [rad]."""


def measure_drift(
    emulator: Emulator,
    *,
    runs: int = RUNS,
    steps: int = STEPS,
    seed: int = SEED,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[Drift]:
    """Return the distances of the emulator's histograms from those of the physics that taught it, number by number.

    Both go through `runs` motions of `steps` super steps from the same random starts under the same random controls.
    `on_progress` is called with (super steps done, of all). Raises ArgumentError for a system that cannot be simulated.
    """
    system = system_of(emulator)
    rng = np.random.default_rng(seed)
    starts = sample_starts(system, rng, runs, core_count())
    begin_true = begin_made = starts
    true_paths = []
    made_paths = []
    for done in range(0, steps, BLOCK):
        controls = sample_control_runs(rng, runs, min(BLOCK, steps - done), emulator.dt, system)
        true = system.simulate_fastest(begin_true, controls, emulator.dt).states
        made = emulate(emulator, begin_made, controls)
        begin_true = _mark_lost(system, true)
        begin_made = _mark_lost(system, made)
        true_paths.append(true[:, EVERY::EVERY].copy())
        made_paths.append(made[:, EVERY::EVERY].copy())
        if on_progress:
            on_progress(min(done + BLOCK, steps), steps)
    physics = _known_quantities(system, np.concatenate(true_paths, axis=1))
    emulated = _known_quantities(system, np.concatenate(made_paths, axis=1))
    return [_drift(name, values, emulated[name]) for name, values in physics.items()]


def _mark_lost(system: System, path: Float[np.ndarray, "B F S"]) -> Float[np.ndarray, "B S"]:
    """Set lost runs to NaN, and return the states from which to go on: rest, for lost runs."""
    is_lost = ~np.isfinite(path).all(axis=(1, 2)) | system.has_diverged(path)
    path[is_lost] = np.nan
    return np.where(is_lost[:, None], system.rest, path[:, -1])


def quantities(
    system: System, states: Float[np.ndarray, "N S"]
) -> dict[str, Float[np.ndarray, " N"]]:
    """Return the quantities of `states` that are compared, by name: kinetic energy [J], speed, and every angle [rad].

    The speed is that of the centroid, or else of all entries in m/s, or else in rad/s. The angle of a body that is free
    to turn is the one between its own vertical and the world's.
    """
    found = {}
    energies = system.kinetic_energies(states)
    if energies is not None:
        found["kinetic energy"] = energies
    if system.structure.cloud is not None:
        pose = read_pose(system.structure, states)
        found["speed"] = np.linalg.norm(pose.velocity, axis=1)
        found["tilt"] = _tilts(pose.upward)
    else:
        found["speed"] = _speeds(system, states)
    for entry, _ in system.structure.orientations:
        name = system.state.names[entry].rsplit(".", 1)[0].rsplit("[", 1)[0]
        found[f"tilt of {name}"] = _tilts(upward(states[:, entry : entry + 4]))
    for part in system.state.slices:
        if part.unit == "rad":
            for number, values in enumerate(system.state.part(states, part.name).T, start=1):
                name = part.name if part.size == 1 else f"{part.name} {number}"
                found[name] = np.arctan2(np.sin(values), np.cos(values))
    return found


def _speeds(system: System, states: Float[np.ndarray, "N S"]) -> Float[np.ndarray, " N"]:
    for unit in ("m/s", "rad/s"):
        parts = [part.name for part in system.state.slices if part.unit == unit]
        if parts:
            rates = [system.state.part(states, name) for name in parts]
            return np.linalg.norm(np.concatenate(rates, axis=1), axis=1)
    return np.linalg.norm(states, axis=1)


def _tilts(upwards: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
    return np.arccos(np.clip(upwards[:, 2], -1, 1))


def _known_quantities(
    system: System, paths: Float[np.ndarray, "B T S"]
) -> dict[str, Float[np.ndarray, "B T"]]:
    """Return the quantities of every run; NaN where it is lost."""
    rows = paths.reshape(-1, paths.shape[-1])
    is_known = np.asarray(np.isfinite(rows).all(axis=1))
    found = quantities(system, np.where(is_known[:, None], rows, system.rest))
    shape = paths.shape[:2]
    return {
        name: np.where(is_known, values, np.nan).reshape(shape) for name, values in found.items()
    }


def _drift(
    name: str, physics: Float[np.ndarray, "B T"], emulated: Float[np.ndarray, "B T"]
) -> Drift:
    if name in NOT_ANGLES:
        edges = np.unique(np.nanquantile(physics, np.linspace(0, 1, BINS + 1)[1:-1]))
    else:
        edges = np.linspace(-np.pi, np.pi, BINS + 1)[1:-1]
    true_counts = _counts(physics, edges)
    made_counts = _counts(emulated, edges)
    distance = _distance(true_counts, made_counts)
    spread = Z * _jackknife(true_counts, made_counts)
    return Drift(
        quantity=name,
        distance=distance,
        low=max(distance - spread, 0.0),
        high=min(distance + spread, 1.0),
        chance=_between_halves(true_counts),
    )


def _jackknife(one: Int[np.ndarray, "B K"], other: Int[np.ndarray, "B K"]) -> float:
    """Return the standard error of the distance of two histograms, by leaving one run out after the other."""
    runs = len(one)
    without = [_distance(np.delete(one, run, 0), np.delete(other, run, 0)) for run in range(runs)]
    return float(np.sqrt((runs - 1) * np.var(without)))


def _between_halves(counts: Int[np.ndarray, "B K"]) -> float:
    """Return the mean distance between one half of the runs and the other."""
    rng = np.random.default_rng(0)
    half = len(counts) // 2
    distances = []
    for _ in range(DRAWS):
        order = rng.permutation(len(counts))
        distances.append(_distance(counts[order[:half]], counts[order[half:]]))
    return float(np.mean(distances))


def _counts(
    values: Float[np.ndarray, "B T"], edges: Float[np.ndarray, " E"]
) -> Int[np.ndarray, "B K"]:
    """Return how often each run is in each bin; the last bin is for lost ones."""
    bins = np.searchsorted(edges, values, side="right")
    bins = np.where(np.isfinite(values), bins, len(edges) + 1)
    return np.stack([np.bincount(row, minlength=len(edges) + 2) for row in bins])


def _distance(one: Int[np.ndarray, "B K"], other: Int[np.ndarray, "D K"]) -> float:
    """Return half of the summed differences of two histograms' shares: 0 if alike, 1 if nothing is shared."""
    first, second = (counts.sum(axis=0) / counts.sum() for counts in (one, other))
    return float(np.abs(first - second).sum() / 2)
