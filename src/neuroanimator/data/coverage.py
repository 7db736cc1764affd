"""What a dataset covers: how far its states and controls range, how often, and where its runs diverged.

found = coverage("data/hopper")
found.states[3].counts  # a histogram
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.data.config import RUNS_PER_SHARD, DatasetConfig
from neuroanimator.data.diverged_runs import diverged_by_shard
from neuroanimator.data.readings import Reading, control_readings, state_readings
from neuroanimator.data.spots import find_spots
from neuroanimator.data.store import Transitions, read_config, read_shard, windows_of
from neuroanimator.data.stored import StoredTransitions, super_steps
from neuroanimator.errors import BadFileError
from neuroanimator.state.layout import Bounds
from neuroanimator.storage.places import Place, place_of
from neuroanimator.systems import carried_system
from neuroanimator.systems.system import System
from neuroanimator.text import short_number

BINS = 24
"""Bars of a histogram."""

MAX_SAMPLES = 20_000
"""So many transitions are looked at, about: the quantiles of more are the same to two digits."""

AT_BOUND = 0.01
"""A control nearer to a bound than this share of its range is at the bound."""

NOTHING = 1e-4
"""A number smaller than this share of its whole range is told as zero."""

HISTOGRAM_ENDS = (0.005, 0.995)
"""The quantiles at which a histogram of states begins and ends."""

USUAL = (0.05, 0.5, 0.95)
"""The quantiles that are told."""


@dataclass(frozen=True)
class Spread:
    """How one number is spread over the samples."""

    name: str
    unit: str
    least: float
    low: float
    """5 % of the samples are smaller."""
    median: float
    high: float
    """5 % of the samples are larger."""
    most: float
    edges: Float[np.ndarray, " B1"]
    """Ends of the histogram's bars, in the number's unit."""
    counts: Int[np.ndarray, " B"]
    """Samples in each bar; those beyond the outermost edges are counted in the outermost bars."""
    at_bounds: float | None = None
    """Share of the samples at a bound, of a control; None of a state."""

    @property
    def tidy(self) -> tuple[str, ...]:
        """Least, 5 %, median, 95 % and most with three digits, as 0 what is nothing beside the others."""
        numbers = (self.least, self.low, self.median, self.high, self.most)
        nothing = NOTHING * (self.most - self.least)
        return tuple(short_number(number) if abs(number) > nothing else "0" for number in numbers)

    @classmethod
    def of(cls, reading: Reading, bounds: tuple[float, float] | None = None) -> Spread:
        """Return the spread of a reading; of a control its histogram goes from bound to bound."""
        values = reading.values
        low, median, high = np.quantile(values, USUAL)
        at_bounds = None
        if bounds is None:
            edges = _edges(values)
        else:
            first, last = bounds
            edges = _even_edges(first, last)
            margin = AT_BOUND * (last - first)
            is_at_bound = (values <= first + margin) | (values >= last - margin)
            at_bounds = float(is_at_bound.mean())
        counts, _ = np.histogram(np.clip(values, edges[0], edges[-1]), edges)
        return cls(
            name=reading.name,
            unit=reading.unit,
            least=float(values.min()),
            low=float(low),
            median=float(median),
            high=float(high),
            most=float(values.max()),
            edges=edges,
            counts=counts,
            at_bounds=at_bounds,
        )


def _edges(values: Float[np.ndarray, " N"]) -> Float[np.ndarray, " B1"]:
    """Return the edges of a histogram of states: a few far away must not leave all others in one bar."""
    least, most = values.min(), values.max()
    if most - least < BINS and not (values % 1).any():  # of counts, a bar each
        return np.arange(least, most + 2) - 0.5
    low, high = np.quantile(values, HISTOGRAM_ENDS)
    return _even_edges(float(low), float(high))


def _even_edges(first: float, last: float) -> Float[np.ndarray, " B1"]:
    """Return edges between two ends; a unit around them where they are the same."""
    if not last > first:
        return np.linspace(first - 0.5, first + 0.5, BINS + 1)
    return np.linspace(first, last, BINS + 1)


@dataclass(frozen=True)
class Divergence:
    """The runs that were left out because the physics diverged."""

    runs: int
    share: float
    """Of all runs that were simulated."""
    starts: tuple[Spread, ...] = ()
    """Where they began; empty where they are not kept."""
    conditions: tuple[str, ...] = ()
    """From which starts runs diverge more often than from others, in words; empty if no start tells."""

    @property
    def advice(self) -> str:
        """What to do about it; empty if no run diverged."""
        if not self.runs:
            return ""
        return (
            "take a shorter truth_step in the TOML file, narrow [sampling] or [control] to what occurs in use, or leave "
            "it if such states never do"
        )


@dataclass(frozen=True)
class Coverage:
    """What a dataset covers."""

    system: str
    samples: int
    """Transitions looked at: evenly taken from those that are there."""
    transitions: int
    """Transitions that are there."""
    runs: int
    """Runs they come from; of recordings, segments."""
    states: tuple[Spread, ...]
    """Of each number of the state, or of what can be read off it: see `data.readings`."""
    controls: tuple[Spread, ...]
    diverged: Divergence
    missing: tuple[str, ...] = ()
    """Files that are not there, or damaged: 'generate' makes them."""

    @property
    def spreads(self) -> tuple[Spread, ...]:
        """Those of states and controls."""
        return self.states + self.controls

    def to_json(self) -> dict[str, Any]:
        """Return all of it as plain lists and numbers."""
        return as_plain(asdict(self))


def coverage(data: Transitions | StoredTransitions | str | Place) -> Coverage:
    """Return what the dataset `data` covers: one that was opened, or the folder of one, which may be half generated.

    Raises BadFileError for a folder that holds no dataset, or no whole shard of one yet.
    """
    if isinstance(data, Transitions):
        return _coverage_in_memory(data)
    if isinstance(data, StoredTransitions):
        return _coverage_of_stored(data)
    folder = place_of(data)
    config = read_config(folder)
    system = carried_system(config.system, config.definition)
    shards, missing = _read_some(folder, config, system)
    if not shards:
        raise BadFileError(f"{folder} holds no whole shard yet. Run the same 'generate' again.")
    samples = _evenly(_joined(shards))
    divergence = Divergence(0, 0.0)
    present = [
        shard for shard in range(config.shards) if config.shard_path(folder, shard).is_file()
    ]
    simulated = sum(_runs_in(config, shard) for shard in present)
    if system.recordings is None:
        divergence = _divergence(folder, system, shards, simulated)
    kept = simulated - divergence.runs
    runs = kept if system.recordings is None else len(np.unique(samples.run))
    return Coverage(
        system=config.system,
        samples=len(samples.states),
        transitions=kept * config.samples_per_run,
        runs=runs,
        states=spreads_of(state_readings(system, samples.states)),
        controls=spreads_of(control_readings(system, samples.controls), system.bounds),
        diverged=divergence,
        missing=tuple(missing),
    )


def coverage_of_states(
    system: System, states: Float[np.ndarray, "N S"], controls: Float[np.ndarray, "N C"], runs: int
) -> Coverage:
    """Return what `states` and the controls given in them cover, of so many runs."""
    return Coverage(
        system=system.name,
        samples=len(states),
        transitions=len(states),
        runs=runs,
        states=spreads_of(state_readings(system, states)),
        controls=spreads_of(control_readings(system, controls), system.bounds),
        diverged=Divergence(0, 0.0),
    )


def spreads_of(readings: Sequence[Reading], bounds: Bounds | None = None) -> tuple[Spread, ...]:
    """Return the spread of each reading; of controls within their `bounds`."""
    if bounds is None:
        return tuple(Spread.of(reading) for reading in readings)
    ends = zip(readings, bounds.low, bounds.high, strict=True)
    return tuple(Spread.of(reading, (low, high)) for reading, low, high in ends)


class _Samples(NamedTuple):
    """Training examples: a state, the control given there, and the run they are of."""

    states: Float[np.ndarray, "N S"]
    controls: Float[np.ndarray, "N C"]
    run: Int[np.ndarray, " N"]


class _Shard(NamedTuple):
    """What is looked at of a shard."""

    samples: _Samples
    starts: Float[np.ndarray, "B S"]
    """Where its runs began."""
    efforts: Float[np.ndarray, " B"]
    """How strongly they were driven, see `_efforts`."""


def _coverage_in_memory(data: Transitions) -> Coverage:
    samples = _evenly(_Samples(data.states[:, 0], data.controls[:, 0], data.run))
    runs = len(np.unique(data.run))
    return _coverage_of_whole(data, samples, len(data.states), runs, data.diverged)


def _coverage_of_stored(data: StoredTransitions) -> Coverage:
    """Return what `_coverage_in_memory` would, a shard at a time."""
    every = _every(data.windows)
    states = []
    controls = []
    first = 0
    for steps in super_steps(data):
        states.append(steps.states[first::every].copy())
        controls.append(steps.controls[first::every].copy())
        first = (first - len(steps.states)) % every
    runs = int(data.kept_runs.sum())
    samples = _Samples(np.concatenate(states), np.concatenate(controls), np.zeros(0, int))
    return _coverage_of_whole(data, samples, data.windows, runs, data.config.runs - runs)


def _coverage_of_whole(
    data: Transitions | StoredTransitions,
    samples: _Samples,
    transitions: int,
    runs: int,
    diverged: int,
) -> Coverage:
    """Return what a dataset covers of which everything is there, by `samples` of its `transitions`."""
    _check_finite(samples, f"The dataset of {data.config.system}")
    found = coverage_of_states(data.system, samples.states, samples.controls, runs)
    divergence = Divergence(diverged, share=diverged / max(runs + diverged, 1))
    return replace(found, transitions=transitions, diverged=divergence)


def _read_some(
    folder: Place, config: DatasetConfig, system: System
) -> tuple[list[_Shard], list[str]]:
    """Return enough of the shards for `MAX_SAMPLES`, evenly taken, and the names of those missing or damaged."""
    missing = []
    present = []
    for shard in range(config.shards):
        path = config.shard_path(folder, shard)
        if path.is_file():
            present.append(shard)
        else:
            missing.append(path.name)
    shard_size = RUNS_PER_SHARD * config.samples_per_run
    wanted = -(-MAX_SAMPLES // shard_size)
    chosen = np.unique(np.linspace(0, len(present) - 1, wanted).round().astype(int))
    shards = []
    for number in chosen if present else ():
        shard = present[number]
        try:
            tensors, _ = read_shard(folder, config, system, shard)
        except BadFileError:
            missing.append(config.shard_path(folder, shard).name)
            continue
        windows = windows_of(tensors, shard)
        # Copies, for a view would keep the whole shard in memory.
        first_states = windows.states[:, 0].copy()
        samples = _Samples(first_states, windows.controls[:, 0].copy(), windows.run)
        _check_finite(samples, config.shard_path(folder, shard))
        efforts = _efforts(system, tensors["controls"])
        shards.append(_Shard(samples, tensors["states"][:, 0].copy(), efforts))
    return shards, missing


def _check_finite(samples: _Samples, whose: object) -> None:
    for array in (samples.states, samples.controls):
        if not np.isfinite(array).all():
            raise BadFileError(f"{whose} holds numbers that are not finite. Generate it again.")


def _joined(shards: list[_Shard]) -> _Samples:
    states = np.concatenate([shard.samples.states for shard in shards])
    controls = np.concatenate([shard.samples.controls for shard in shards])
    return _Samples(states, controls, np.concatenate([shard.samples.run for shard in shards]))


def _evenly(samples: _Samples) -> _Samples:
    """Return at most `MAX_SAMPLES` of the samples."""
    every = _every(len(samples.states))
    return _Samples(samples.states[::every], samples.controls[::every], samples.run[::every])


def _every(count: int) -> int:
    """Return which of `count` samples is taken, so that at most `MAX_SAMPLES` are: one in so many."""
    return max(1, -(-count // MAX_SAMPLES))


def _runs_in(config: DatasetConfig, shard: int) -> int:
    """Return how many runs a shard is made of, those that diverged included."""
    return min(RUNS_PER_SHARD, config.runs - shard * RUNS_PER_SHARD)


def _divergence(folder: Place, system: System, shards: list[_Shard], runs: int) -> Divergence:
    """Return how many of the `runs` diverged, and which starts and controls make that likelier."""
    diverged_starts = []
    efforts = [shard.efforts for shard in shards]
    for diverged in diverged_by_shard(folder):
        diverged_starts.append(diverged.starts)
        efforts.append(_efforts(system, diverged.controls))
    if not diverged_starts:
        return Divergence(0, 0.0)
    starts = np.concatenate(diverged_starts)
    sound_starts = np.concatenate([shard.starts for shard in shards])
    # As round as those of the shards: else the rounding would tell them apart.
    every_start = np.concatenate([sound_starts, starts.astype(sound_starts.dtype)])
    has_diverged = np.arange(len(every_start)) >= len(sound_starts)
    readings = state_readings(system, every_start)
    readings.append(Reading("controls, rms share of their range", "1", np.concatenate(efforts)))
    # Dealt out in turn, so that each half of the runs has its share of those that diverged.
    dealt = np.arange(len(every_start))
    conditions = []
    for spot, _ in find_spots(has_diverged.astype(float), dealt, readings):
        often = f"{spot.ratio:.2g} times as often" if np.isfinite(spot.ratio) else "only"
        conditions.append(f"{often} where {spot.condition}")
    return Divergence(
        runs=len(starts),
        share=len(starts) / runs,
        starts=spreads_of(state_readings(system, starts)),
        conditions=tuple(conditions),
    )


def _efforts(system: System, controls: Float[np.ndarray, "B T C"]) -> Float[np.ndarray, " B"]:
    """Return how strongly each run is driven: its controls' root mean square, as a share of half their range."""
    half = np.where(system.bounds.half > 0, system.bounds.half, 1.0)
    shares = (controls - system.bounds.middle) / half
    return np.sqrt(np.mean(shares**2, axis=(1, 2)))


def as_plain(value: Any) -> Any:
    """Return `value` with lists instead of arrays and tuples, and None for numbers JSON has no word for."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {key: as_plain(inner) for key, inner in value.items()}
    if isinstance(value, tuple | list):
        return [as_plain(inner) for inner in value]
    return value
