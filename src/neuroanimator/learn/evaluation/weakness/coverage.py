"""Coverage of a dataset: ranges and histograms of its states and controls, and where its runs diverged.

found = coverage("data/hopper")
found.states[3].counts  # a histogram
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from pydantic_core import to_json

from neuroanimator.errors import BadFileError
from neuroanimator.files.places import Place, place_of
from neuroanimator.learn.data.config import RUNS_PER_SHARD
from neuroanimator.learn.data.diverged_runs import diverged_by_shard
from neuroanimator.learn.data.store import (
    Dataset,
    Transitions,
    read_config,
    read_shard,
    shard_transitions,
)
from neuroanimator.learn.evaluation.weakness.conditions import find_spots
from neuroanimator.learn.evaluation.weakness.readings import (
    Reading,
    control_readings,
    state_readings,
)
from neuroanimator.physics import carried_system
from neuroanimator.systems.system import System
from neuroanimator.text import short_number

BINS = 24
"""Number of bars in a histogram."""

MAX_SAMPLES = 20_000
"""Approximate maximum number of transitions examined: more give the same quantiles to two digits."""

AT_BOUND = 0.01
"""Largest distance from a bound that counts as at the bound, as a share of the control's range."""

NOTHING = 1e-4
"""Smallest number that is not shown as zero, as a share of the whole range."""

HISTOGRAM_ENDS = (0.005, 0.995)
"""Quantiles at which a histogram of states begins and ends."""

QUANTILES = (0, 0.05, 0.5, 0.95, 1)
"""Quantiles that are shown."""


@dataclass(frozen=True)
class Spread:
    """Distribution of one number over the samples."""

    name: str
    unit: str
    least: float
    low: float
    """Quantile 0.05 of the samples."""
    median: float
    high: float
    """Quantile 0.95 of the samples."""
    most: float
    edges: Float[np.ndarray, " B1"]
    """Ends of the histogram's bars, in the number's unit."""
    counts: Int[np.ndarray, " B"]
    """Number of samples in each bar; those beyond the outermost edges are counted in the outermost bars."""
    at_bounds: float | None = None
    """Share of a control's samples at a bound; None for a state."""

    @property
    def tidy(self) -> tuple[str, ...]:
        """Minimum, 5 %, median, 95 % and maximum with three digits; 0 for what is negligible beside the others."""
        numbers = (self.least, self.low, self.median, self.high, self.most)
        nothing = NOTHING * (self.most - self.least)
        return tuple(short_number(number) if abs(number) > nothing else "0" for number in numbers)

    @classmethod
    def of(cls, reading: Reading, bounds: tuple[float, float] | None = None) -> Spread:
        """Return the spread of a reading; a control's histogram goes from bound to bound."""
        values = reading.values
        if bounds is None:
            edges = _edges(values)
            at_bounds = None
        else:
            first, last = bounds
            edges = _even_edges(first, last)
            margin = AT_BOUND * (last - first)
            at_bounds = float(np.mean((values <= first + margin) | (values >= last - margin)))
        counts, _ = np.histogram(np.clip(values, edges[0], edges[-1]), edges)
        least, low, median, high, most = np.quantile(values, QUANTILES).tolist()
        spread = (least, low, median, high, most)
        return cls(reading.name, reading.unit, *spread, edges, counts, at_bounds)


def _edges(values: Float[np.ndarray, " N"]) -> Float[np.ndarray, " B1"]:
    """Return the edges of a histogram of states: a few outliers must not leave all others in one bar."""
    least, most = values.min(), values.max()
    if most - least < BINS and not (values % 1).any():  # integers: a bar each
        return np.arange(least, most + 2) - 0.5
    return _even_edges(*np.quantile(values, HISTOGRAM_ENDS).tolist())


def _even_edges(first: float, last: float) -> Float[np.ndarray, " B1"]:
    """Return even edges between two ends; one unit around them if they are equal."""
    if not last > first:
        return np.linspace(first - 0.5, first + 0.5, BINS + 1)
    return np.linspace(first, last, BINS + 1)


@dataclass(frozen=True)
class Divergence:
    """The runs that were left out because the physics diverged."""

    runs: int
    share: float
    """Share of all simulated runs."""
    conditions: tuple[str, ...] = ()
    """Conditions on starts from which runs diverge more often than from others; empty if there are none."""

    @property
    def advice(self) -> str:
        """A remedy; empty if no run diverged."""
        if not self.runs:
            return ""
        return (
            "take a shorter truth_step in the TOML file, narrow [sampling] or [control] to what occurs in use, or leave "
            "it if such states never do"
        )


@dataclass(frozen=True)
class Coverage:
    """The ranges and histograms of all numbers in a dataset."""

    system: str
    samples: int
    """Number of transitions examined, evenly taken from those that are there."""
    transitions: int
    """Number of transitions that are there."""
    runs: int
    """Number of runs they come from; of segments, for recordings."""
    states: tuple[Spread, ...]
    """Spread of each number of the state, or of its readings: see `weakness.readings`."""
    controls: tuple[Spread, ...]
    diverged: Divergence
    missing: tuple[str, ...] = ()
    """Missing or damaged files: 'generate' makes them."""

    @property
    def spreads(self) -> tuple[Spread, ...]:
        """Spreads of states and controls."""
        return self.states + self.controls

    def to_json(self) -> dict[str, Any]:
        """Return it as plain lists and numbers."""
        return as_plain(self)


def coverage(data: Dataset | str | Place) -> Coverage:
    """Return the coverage of the dataset `data`: an open one, or the folder of one, which may be partly generated.

    Raises BadFileError for a folder without a dataset, or without a whole shard of one.
    """
    if not isinstance(data, Dataset):
        return _coverage_of_folder(place_of(data))
    counts = []
    runs = 0
    diverged = 0
    for part in data.parts(unroll=1):
        counts.append(len(part.states))
        runs += len(np.unique(part.run))
        diverged += part.diverged
    states, controls = _evenly(data.parts(unroll=1), sum(counts))
    found = coverage_of_states(data.system, states, controls, runs)
    divergence = Divergence(diverged, diverged / max(runs + diverged, 1))
    return replace(found, transitions=sum(counts), diverged=divergence)


def coverage_of_states(
    system: System, states: Float[np.ndarray, "N S"], controls: Float[np.ndarray, "N C"], runs: int
) -> Coverage:
    """Return the coverage of `states` and their controls, of `runs` runs."""
    if not (np.isfinite(states).all() and np.isfinite(controls).all()):
        raise BadFileError(
            f"The dataset of {system.name} holds numbers that are not finite. Generate it again."
        )
    readings = control_readings(system, controls)
    bounds = zip(readings, system.bounds.low, system.bounds.high, strict=True)
    return Coverage(
        system=system.name,
        samples=len(states),
        transitions=len(states),
        runs=runs,
        states=tuple(Spread.of(reading) for reading in state_readings(system, states)),
        controls=tuple(Spread.of(reading, (low, high)) for reading, low, high in bounds),
        diverged=Divergence(0, 0.0),
    )


def _evenly(
    parts: Iterable[Transitions], total: int
) -> tuple[Float[np.ndarray, "N S"], Float[np.ndarray, "N C"]]:
    """Return at most `MAX_SAMPLES` of the `total` states and controls at the beginnings of the windows in `parts`."""
    every = max(1, -(-total // MAX_SAMPLES))
    first = 0
    states = []
    controls = []
    for part in parts:
        # Copies, as a view would keep the whole part in memory.
        states.append(part.states[first::every, 0].copy())
        controls.append(part.controls[first::every, 0].copy())
        first = (first - len(part.states)) % every
    return np.concatenate(states), np.concatenate(controls)


def _coverage_of_folder(folder: Place) -> Coverage:
    """Return the coverage of the shards that are there, from some of them."""
    config = read_config(folder)
    system = carried_system(config.system, config.definition)
    paths = [config.shard_path(folder, shard) for shard in range(config.shards)]
    present = [shard for shard, path in enumerate(paths) if path.is_file()]
    missing = [path.name for shard, path in enumerate(paths) if shard not in present]
    parts = []
    starts = []
    efforts = []
    for shard in _some(present, RUNS_PER_SHARD * config.samples_per_run):
        try:
            tensors, metadata = read_shard(folder, config, system, shard)
        except BadFileError:
            missing.append(paths[shard].name)
            continue
        parts.append(shard_transitions(config, system, tensors, metadata, unroll=1))
        starts.append(tensors["states"][:, 0].copy())
        efforts.append(_efforts(system, tensors["controls"]))
    if not parts:
        raise BadFileError(f"{folder} holds no complete shard yet. Run the same 'generate' again.")
    states, controls = _evenly(parts, sum(len(part.states) for part in parts))
    runs = sum(min(RUNS_PER_SHARD, config.runs - shard * RUNS_PER_SHARD) for shard in present)
    divergence = Divergence(0, 0.0)
    kept = runs
    if system.recordings is not None:
        kept = len(np.unique(np.concatenate([part.run for part in parts])))
    else:
        divergence = _divergence(folder, system, starts, efforts, runs)
        kept -= divergence.runs
    found = coverage_of_states(system, states, controls, kept)
    transitions = (runs - divergence.runs) * config.samples_per_run
    return replace(found, transitions=transitions, diverged=divergence, missing=tuple(missing))


def _some(shards: Sequence[int], size: int) -> list[int]:
    """Return enough of the shards, of `size` samples each, for `MAX_SAMPLES`, evenly taken."""
    if not shards:
        return []
    rows = np.linspace(0, len(shards) - 1, -(-MAX_SAMPLES // size)).round().astype(int)
    return [shards[row] for row in np.unique(rows)]


def _divergence(
    folder: Place,
    system: System,
    starts: Sequence[Float[np.ndarray, "_ S"]],
    efforts: Sequence[Float[np.ndarray, " _"]],
    runs: int,
) -> Divergence:
    """Return the number of `runs` that diverged, and the starts and controls that make divergence likelier."""
    diverged = list(diverged_by_shard(folder))
    if not diverged:
        return Divergence(0, 0.0)
    sound_starts = np.concatenate(starts)
    lost_starts = np.concatenate([part.starts for part in diverged])
    # Rounded as those of the shards: otherwise the rounding would distinguish them.
    every = np.concatenate([sound_starts, lost_starts.astype(sound_starts.dtype)])
    driven = [*efforts, *(_efforts(system, part.controls) for part in diverged)]
    readings = state_readings(system, every)
    readings.append(Reading("controls, rms share of their range", "1", np.concatenate(driven)))
    order = np.arange(len(every))
    is_lost = order >= len(sound_starts)
    conditions = []
    # Dealt in turn, so that each half of the runs has its share of diverged ones.
    for spot, _ in find_spots(is_lost.astype(float), order, readings):
        often = f"{spot.ratio:.2g} times as often" if np.isfinite(spot.ratio) else "only"
        conditions.append(f"{often} where {spot.condition}")
    return Divergence(len(lost_starts), len(lost_starts) / runs, tuple(conditions))


def _efforts(system: System, controls: Float[np.ndarray, "B T C"]) -> Float[np.ndarray, " B"]:
    """Return the effort of each run: the root mean square of its controls, as a share of half their range."""
    half = np.where(system.bounds.half > 0, system.bounds.half, 1.0)
    return np.sqrt(np.mean(((controls - system.bounds.middle) / half) ** 2, axis=(1, 2)))


def as_plain(result: Any) -> Any:
    """Return a dataclass as plain lists and numbers, with None for numbers that JSON cannot write."""
    return json.loads(to_json(result, inf_nan_mode="null", fallback=np.ndarray.tolist))
