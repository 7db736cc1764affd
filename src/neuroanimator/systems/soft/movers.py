"""What is moved from outside: entries of its positions, headings and rates, its limits, and random paths of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.flex import FlexMoverTable
from neuroanimator.definitions.soft import MoverTable
from neuroanimator.state.layout import Slice
from neuroanimator.state.shape_contacts import FREE, place_movers

WAVES = 3
"""Number of sinusoids in a path along an axis."""

SLOWER = 0.3
"""Lowest frequency of a path's sinusoids over the highest."""

STILL_SHARE = 0.2
"""Share of movers that hardly move in a run."""

STILL = 0.05
"""How far these move at most, over their reach."""

HOLDS = 0.25
"""Share of the time in which a mover holds still."""

HOLDING = (0.1, 0.4)
"""Lowest and highest frequency [Hz] at which it stops and goes on."""

RETURN = 0.5
"""Time constant at which a mover that is off its path comes back to it [s]."""


class Pace(NamedTuple):
    """How lively random paths are."""

    slowest: float
    """Least of the highest frequencies of paths [Hz]."""
    fastest: float
    """Largest of them [Hz]."""
    weakest: float
    """Least size of a path, over the largest there may be."""
    response: float
    """Time constant at which a mover takes up a velocity [s]."""


CARRYING = Pace(slowest=0.05, fastest=1.0, weakest=0.0, response=0.1)
"""Of what holds or strikes a body."""

THROWING = Pace(slowest=0.5, fastest=2.5, weakest=0.3, response=0.03)
"""Of what a body that nothing holds lies on: slower paths seldom throw it."""


def pace_of(anchor: int) -> Pace:
    """Return how lively the movers of a body are that the mover `anchor` holds; `FREE` is thrown by them."""
    return THROWING if anchor == FREE else CARRYING


class Movers:
    """M movers, whose positions and headings are D numbers; so are their rates."""

    def __init__(self, tables: dict[str, MoverTable]):
        self.tables = list(tables.values())
        self.names = list(tables)
        self.turning = tuple(mover.turns for mover in self.tables)
        self.places = place_movers(self.turning)
        self.size = sum(place.size for place in self.places)
        """D."""
        self.rest = self._entries("position")
        """Positions [m] and headings [rad] at rest (D,)."""
        self.speed = self._entries("speed", "turn_speed")
        """Largest rates (D,) [m/s, rad/s]."""
        self.reach = self._entries("reach", "turn_reach")
        """Distance from rest (D,) within which random paths stay [m, rad]."""

    def _entries(self, name: str, turning: str = "") -> Float[np.ndarray, " D"]:
        """Return this value of all movers, and that called `turning` of those that turn; 0 if that is empty."""
        values: list[float] = []
        for mover in self.tables:
            values += getattr(mover, name)
            if mover.turns:
                values.append(getattr(mover, turning) if turning else 0.0)
        return np.array(values)

    def slices(self, rate: str = "") -> list[Slice]:
        """Return the parts of a state that hold positions and headings; their rates if `rate` is "rate"."""
        parts = []
        for name, mover in zip(self.names, self.tables, strict=True):
            parts.append(Slice(f"{name}_velocity", 3, "m/s") if rate else Slice(name, 3, "m"))
            if mover.turns and rate:
                parts.append(Slice(f"{name}_turning_rate", 1, "rad/s"))
            elif mover.turns:
                parts.append(Slice(f"{name}_heading", 1, "rad"))
        return parts

    def controls(self) -> list[Slice]:
        """Return the parts of a control: velocities and turning rates."""
        parts = []
        for name, mover in zip(self.names, self.tables, strict=True):
            parts.append(Slice(name, 3, "m/s"))
            if mover.turns:
                parts.append(Slice(f"{name}_turning", 1, "rad/s"))
        return parts

    def poses(
        self, paths: Float[np.ndarray, "F D ..."], origin: Float[np.ndarray, " ..."]
    ) -> Float[np.ndarray, "F P 4 ..."]:
        """Return positions from `origin` [m] and headings [rad] of M movers, and last those of the world."""
        poses = np.zeros((len(paths), len(self.places) + 1, 4, *paths.shape[2:]))
        for number, place in enumerate(self.places):
            poses[:, number, : place.size] = paths[:, place.entry : place.entry + place.size]
        poses[:, :, :3] -= origin
        return poses

    def random_paths(
        self,
        rng: np.random.Generator,
        starts: Float[np.ndarray, "B D"],
        rates: Float[np.ndarray, "B D"],
        steps: int,
        dt: float,
        pace: Pace,
    ) -> Float[np.ndarray, "B T D"]:
        """Return rates of smooth random paths about rest, one for each of the `starts` and its rates at first.

        Some movers hardly move and others as fast as they may, all hold still now and then, and what begins elsewhere
        comes within reach first.
        """
        wanted = self._waves(rng, len(starts), steps, dt, pace)
        follow = 1 - np.exp(-dt / pace.response)
        position = starts
        rate = rates
        path = []
        for step in range(steps):
            onwards = (wanted[:, step + 1] - wanted[:, step]) / dt
            aim = onwards + (wanted[:, step] - position) / RETURN
            rate = rate + follow * (np.clip(aim, -self.speed, self.speed) - rate)
            position = position + dt * rate
            path.append(rate)
        return np.stack(path, axis=1) if path else np.zeros((len(starts), 0, self.size))

    def _waves(
        self,
        rng: np.random.Generator,
        count: int,
        steps: int,
        dt: float,
        pace: Pace,
    ) -> Float[np.ndarray, "B F D"]:
        """Return positions and headings after none to `steps` steps, within reach."""
        movers = len(self.places)
        own = np.repeat(np.arange(movers), [place.size for place in self.places])
        exponents = rng.uniform(np.log(pace.slowest), np.log(pace.fastest), (count, movers))
        highest = np.exp(exponents)[:, own]
        strength = rng.uniform(pace.weakest, 1, (count, movers))
        strength[rng.random((count, movers)) < STILL_SHARE] *= STILL
        farthest = self.speed / (2 * np.pi * highest)
        size = np.minimum(self.reach, farthest) * strength[:, own]
        time = self._own_time(rng, count, steps, dt)[:, :, own]
        total = np.zeros((count, steps + 1, self.size))
        for _ in range(WAVES):
            frequency = highest * rng.uniform(SLOWER, 1, highest.shape)
            phase = rng.uniform(0, 2 * np.pi, highest.shape)
            total += np.sin(2 * np.pi * frequency[:, None] * time + phase[:, None])
        # Their sum is pressed into ±1: beyond its reach no mover goes.
        return self.rest + size[:, None] * np.sin(total * np.sqrt(2 / WAVES))

    def _own_time(
        self, rng: np.random.Generator, count: int, steps: int, dt: float
    ) -> Float[np.ndarray, "B F M"]:
        """Return times [s] that stand still for a share `HOLDS` of the run, mover by mover."""
        shape = (count, 1, len(self.places))
        now = dt * np.arange(steps + 1)[:, None]
        wave = np.sin(
            2 * np.pi * rng.uniform(*HOLDING, shape) * now + rng.uniform(0, 2 * np.pi, shape)
        )
        threshold = np.sin(np.pi * (HOLDS - 0.5))
        going = np.clip((wave - threshold) / 0.2, 0, 1)
        return np.concatenate([np.zeros(shape), np.cumsum(dt * going[:, 1:], axis=1)], axis=1)


def mocap_movers(tables: dict[str, FlexMoverTable], positions: Float[np.ndarray, "M 3"]) -> Movers:
    """Return the movers of a MuJoCo model, which rest at `positions` [m]."""
    placed = {}
    for (name, table), position in zip(tables.items(), positions, strict=True):
        placed[name] = MoverTable(position=tuple(position.tolist()), **table.model_dump())
    return Movers(placed)
