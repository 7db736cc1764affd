"""Whether an emulator left to itself for long goes on as the physics does: how it spends its time, not where it is.

After seconds no two motions of a pendulum are alike, and their states tell nothing. What they do is: how fast, with
how much energy and in which postures. That is compared as histograms over all super steps of many runs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.cores import core_count
from neuroanimator.data.sampling import sample_control_runs, sample_starts
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.evaluation.accuracy import emulate
from neuroanimator.evaluation.held_out import system_of
from neuroanimator.state.rotation import rotation_rows
from neuroanimator.systems.system import System

RUNS = 32
"""Number of runs of each."""

STEPS = 10_000
"""Super steps of a run."""

BLOCK = 500
"""Number of super steps rolled out at once."""

EVERY = 5
"""Interval, in super steps, between those looked at: neighbours are alike."""

BINS = 32
"""Bins of a histogram: of an angle equally wide, of all else equally often visited by the physics."""

DRAWS = 200
"""Number of ways to halve the physics' runs."""

Z = 1.645
"""Number of standard errors from an estimate to its bounds: 90 % confidence."""

SEED = 11


class Drift(NamedTuple):
    """How differently physics and emulator spend their time, by one number."""

    quantity: str
    distance: float
    """Total variation: the share of the emulator's time that would have to be spent elsewhere to be the physics'."""
    low: float
    high: float
    """Bounds of the distance with 90 % confidence, by leaving out one run after the other (jackknife)."""
    chance: float
    """The same distance between two halves of the physics' runs: what so few runs differ by anyhow."""


class Quantity(NamedTuple):
    """A number whose histogram is looked at."""

    values: Float[np.ndarray, " N"]
    is_angle: bool
    """Whether it is an angle within a whole turn [rad]."""


def measure_drift(
    emulator: Emulator,
    *,
    runs: int = RUNS,
    steps: int = STEPS,
    seed: int = SEED,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[Drift]:
    """Return how far the emulator's histograms are from those of the physics that taught it, number by number.

    Both go through `runs` motions of `steps` super steps from the same random starts under the same random controls.
    `on_progress` is told (super steps done, of all). Raises ArgumentError for a system that cannot be simulated.
    """
    system = system_of(emulator)
    rng = np.random.default_rng(seed)
    starts = sample_starts(system, rng, runs, core_count())
    current = {"physics": starts, "emulator": starts}
    seen: dict[str, list[dict[str, Quantity]]] = {"physics": [], "emulator": []}
    for done in range(0, steps, BLOCK):
        controls = sample_control_runs(rng, runs, min(BLOCK, steps - done), emulator.dt, system)
        true = system.simulate_fastest(current["physics"], controls, emulator.dt)
        emulated = emulate(emulator, current["emulator"], controls)
        paths = {"physics": true.states, "emulator": emulated}
        for name, path in paths.items():
            is_lost = ~np.isfinite(path).all(axis=(1, 2)) | system.has_diverged(path)
            path[is_lost] = np.nan
            seen[name].append(_looked_at(system, path[:, EVERY::EVERY]))
            # What is lost goes on from rest: it was counted.
            current[name] = np.where(is_lost[:, None], system.rest, path[:, -1])
        if on_progress:
            on_progress(min(done + BLOCK, steps), steps)
    drifts = []
    for name in seen["physics"][0]:
        physics = [block[name] for block in seen["physics"]]
        emulated = [block[name] for block in seen["emulator"]]
        drifts.append(_drift(name, physics, emulated, runs))
    return drifts


def quantities(system: System, states: Float[np.ndarray, "N S"]) -> dict[str, Quantity]:
    """Return what is looked at of `states`, by name: kinetic energy [J], speed, and every angle [rad].

    The speed is that of the centroid, or else of all that is counted in m/s, or else in rad/s. Of what is free to turn the
    angle is the one between its own vertical and the world's.
    """
    found = {}
    energies = system.kinetic_energies(states)
    if energies is not None:
        found["kinetic energy"] = Quantity(energies, is_angle=False)
    found["speed"] = Quantity(_speeds(system, states), is_angle=False)
    cloud = system.structure.cloud
    if cloud is not None:
        positions = states[:, : 3 * cloud.count].reshape(len(states), -1, 3)
        found["tilt"] = Quantity(_tilts(cloud.orientation(positions)), is_angle=True)
    for entry, _ in system.structure.orientations:
        name = system.state.names[entry].rsplit(".", 1)[0].rsplit("[", 1)[0]
        tilt = _tilts(states[:, entry : entry + 4])
        found[f"tilt of {name}"] = Quantity(tilt, is_angle=True)
    for part in system.state.slices:
        if part.unit == "rad":
            for number, values in enumerate(system.state.part(states, part.name).T, start=1):
                name = part.name if part.size == 1 else f"{part.name} {number}"
                found[name] = Quantity(_wrapped(values), is_angle=True)
    return found


def _speeds(system: System, states: Float[np.ndarray, "N S"]) -> Float[np.ndarray, " N"]:
    cloud = system.structure.cloud
    if cloud is not None:
        size = 3 * cloud.count
        velocities = states[:, size : 2 * size].reshape(len(states), -1, 3)
        return np.linalg.norm(cloud.centroid(velocities), axis=1)
    for unit in ("m/s", "rad/s"):
        parts = [part.name for part in system.state.slices if part.unit == unit]
        if parts:
            rates = [system.state.part(states, name) for name in parts]
            return np.linalg.norm(np.concatenate(rates, axis=1), axis=1)
    return np.linalg.norm(states, axis=1)


def _tilts(orientations: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, " N"]:
    upward = rotation_rows(orientations)[2][2]
    return np.arccos(np.clip(upward, -1, 1))


def _wrapped(angles: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    return np.arctan2(np.sin(angles), np.cos(angles))


def _looked_at(system: System, states: Float[np.ndarray, "B T S"]) -> dict[str, Quantity]:
    """Return the quantities of every run, row after row; what is lost is no number."""
    rows = states.reshape(-1, states.shape[-1])
    is_known = np.asarray(np.isfinite(rows).all(axis=1))
    found = quantities(system, np.where(is_known[:, None], rows, system.rest))
    return {
        name: Quantity(np.where(is_known, values, np.nan), is_angle)
        for name, (values, is_angle) in found.items()
    }


def _drift(name: str, physics: list[Quantity], emulated: list[Quantity], runs: int) -> Drift:
    is_angle = physics[0].is_angle
    true, made = (
        np.concatenate([block.values.reshape(runs, -1) for block in blocks], axis=1)
        for blocks in (physics, emulated)
    )
    edges = _edges(true, is_angle)
    true_counts, made_counts = _counts(true, edges), _counts(made, edges)
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


def _edges(values: Float[np.ndarray, "B T"], is_angle: bool) -> Float[np.ndarray, " E"]:
    """Return where one bin ends and the next begins, open at both ends."""
    if is_angle:
        return np.linspace(-np.pi, np.pi, BINS + 1)[1:-1]
    shares = np.linspace(0, 1, BINS + 1)[1:-1]
    return np.unique(np.nanquantile(values, shares))


def _counts(
    values: Float[np.ndarray, "B T"], edges: Float[np.ndarray, " E"]
) -> Int[np.ndarray, "B K"]:
    """Return how often each run is in each bin; the last one is for what is lost."""
    bins = np.searchsorted(edges, values, side="right")
    bins = np.where(np.isfinite(values), bins, len(edges) + 1)
    return np.stack([np.bincount(row, minlength=len(edges) + 2) for row in bins])


def _distance(one: Int[np.ndarray, "B K"], other: Int[np.ndarray, "D K"]) -> float:
    """Return half of the summed differences of two histograms' shares: 0 if alike, 1 if nothing is shared."""
    first, second = (counts.sum(axis=0) / counts.sum() for counts in (one, other))
    return float(np.abs(first - second).sum() / 2)
