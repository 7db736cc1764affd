"""Where an emulator may be weak: usual motions, motions beyond them, and those of users' controllers and recordings."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.control.synthesis.finetune import scattered
from neuroanimator.data.sampling import sample_control_runs
from neuroanimator.improvement.config import STRETCH
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.system import System

FASTEST = 2.0
"""Shifted starts go up to so many times as fast as the states they are made from."""

FASTER_SHARE = 0.5
"""Share of the shifted starts that go faster."""

SMALLEST_SCATTER = 0.05
"""Controls near a motion are scattered by this share of their bounds: enough to learn what they do there."""


class Stretches(NamedTuple):
    """Short runs that may be simulated."""

    starts: Float[np.ndarray, "N S"]
    controls: Float[np.ndarray, "N T C"]
    place: Int[np.ndarray, " N"]
    """Number of the place each was drawn at."""

    def rows(self, rows: Int[np.ndarray, " M"]) -> Stretches:
        """Return some of them."""
        return Stretches(self.starts[rows], self.controls[rows], self.place[rows])


class Place(abc.ABC):
    """Where runs may be drawn: a distribution of starts and controls."""

    name: str

    @abc.abstractmethod
    def draw(
        self, rng: np.random.Generator, known: Float[np.ndarray, "K S"], count: int
    ) -> tuple[Float[np.ndarray, "N S"], Float[np.ndarray, "N T C"]]:
        """Return `count` starts and the controls from there on; `known` are states that the physics was seen in."""


@final
@dataclass(frozen=True)
class Usual(Place):
    """As datasets are drawn, from states on the way."""

    system: System
    dt: float
    name: str = "usual"

    def draw(
        self, rng: np.random.Generator, known: Float[np.ndarray, "K S"], count: int
    ) -> tuple[Float[np.ndarray, "N S"], Float[np.ndarray, "N T C"]]:
        starts = known[rng.integers(0, len(known), count)]
        return starts, sample_control_runs(rng, count, STRETCH, self.dt, self.system)


@final
@dataclass(frozen=True)
class Shifted(Place):
    """Beyond what datasets show: controls at their bounds that jump or stay, and starts that go faster."""

    system: System
    dt: float
    name: str = "shifted"

    def draw(
        self, rng: np.random.Generator, known: Float[np.ndarray, "K S"], count: int
    ) -> tuple[Float[np.ndarray, "N S"], Float[np.ndarray, "N T C"]]:
        starts = known[rng.integers(0, len(known), count)]
        faster = rng.uniform(1, FASTEST, count)
        faster[rng.random(count) >= FASTER_SHARE] = 1
        rates = rate_entries(self.system)
        starts[:, rates] *= faster[:, None]
        bounds = self.system.bounds
        size = len(bounds.half)
        usual = sample_control_runs(rng, count, STRETCH, self.dt, self.system)
        jumping = bounds.middle + rng.choice([-1, 1], (count, STRETCH, size)) * bounds.half
        staying = np.repeat(jumping[:, :1], STRETCH, axis=1)
        kind = rng.integers(0, 3, count)[:, None, None]
        return starts, np.where(kind == 0, usual, np.where(kind == 1, jumping, staying))


@final
@dataclass(frozen=True)
class Motion(Place):
    """Near motions: what a controller does to the physics, or what was recorded."""

    system: System
    name: str
    states: tuple[Float[np.ndarray, "_ S"], ...]
    """The states of each motion, a super step apart."""
    controls: tuple[Float[np.ndarray, "_ C"], ...]
    """The controls between them."""

    def draw(
        self, rng: np.random.Generator, known: Float[np.ndarray, "K S"], count: int
    ) -> tuple[Float[np.ndarray, "N S"], Float[np.ndarray, "N T C"]]:
        frame = Frame.of(self.system.structure, 0.0)
        lengths = np.array([len(controls) for controls in self.controls])
        motion = rng.choice(len(lengths), count, p=lengths / lengths.sum())
        starts = np.empty((count, self.system.state.size))
        controls = np.empty((count, STRETCH, self.system.control.size))
        for number, (states, held) in enumerate(zip(self.states, self.controls, strict=True)):
            rows = np.flatnonzero(motion == number)
            steps = rng.integers(0, len(held), len(rows))
            starts[rows] = scattered(frame, states, steps, rng)
            following = np.minimum(steps[:, None] + np.arange(STRETCH), len(held) - 1)
            controls[rows] = held[following]
        bounds = self.system.bounds
        noise = rng.normal(size=controls.shape) * SMALLEST_SCATTER * bounds.half
        return starts, bounds.clip(controls + noise)


def rate_entries(system: System) -> list[int]:
    """Return the state entries that say how fast something moves."""
    entries = []
    for part in system.state.slices:
        if part.unit.endswith("/s"):
            entries += range(system.state.size)[system.state.index(part.name)]
    return entries


def drawn(
    places: tuple[Place, ...],
    rng: np.random.Generator,
    known: Float[np.ndarray, "K S"],
    count: int,
) -> Stretches:
    """Return about `count` runs that may be simulated, as many of each place."""
    of_each = -(-count // len(places))
    starts = []
    controls = []
    for place in places:
        place_starts, place_controls = place.draw(rng, known, of_each)
        starts.append(place_starts)
        controls.append(place_controls)
    numbers = np.repeat(np.arange(len(places)), of_each)
    return Stretches(np.concatenate(starts), np.concatenate(controls), numbers)
