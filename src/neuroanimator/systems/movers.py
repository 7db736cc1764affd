"""Movers: entries of their poses and rates, their limits, and random paths."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.carried import read_definition_text
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.definitions.soft import MotionTable, MoverTable, SoftDefinition
from neuroanimator.state.layout import Slice
from neuroanimator.state.mover_poses import (
    FREELY,
    Turns,
    change_between,
    moved,
    moved_as_one,
    place_movers,
    quaternion_entries,
)
from neuroanimator.state.rotation import NO_ROTATION, facing, heading_of
from neuroanimator.state.shape_contacts import FREE
from neuroanimator.systems.named_files import read_definition, shipped_folder

WAVES = 3
"""Number of sinusoids in a path along an axis."""

SLOWER = 0.3
"""Lowest frequency of a path's sinusoids over the highest."""

STILL_SHARE = 0.2
"""Share of movers nearly at rest in a run."""

STILL = 0.05
"""Maximum motion of these, over their reach."""

HOLDS = 0.25
"""Share of the time for which a mover holds still."""

HOLDING = (0.1, 0.4)
"""Lowest and highest frequency of its stops [Hz]."""

FOLLOWING = 0.75
"""Share of runs in which movers follow recorded motions, if there are any."""

PLAYED = (0.7, 1.3)
"""Slowest and fastest playback of these."""

STRAYING = 0.3
"""Largest share of a random path that is added to them."""

RETURN = 0.5
"""Time constant with which a mover returns to its path [s]."""

MOVED = {"pose": ("", "m"), "rate": ("_velocity", "m/s"), "control": ("", "m/s")}
"""Suffixes and units of what moves in a state, in its rates and in a control."""

TURNED: dict[str, dict[Turns, Slice]] = {
    "pose": {True: Slice("_heading", 1, "rad"), FREELY: Slice("_orientation", 4, "quaternion")},
    "rate": {
        True: Slice("_turning_rate", 1, "rad/s"),
        FREELY: Slice("_angular_velocity", 3, "rad/s"),
    },
    "control": {True: Slice("_turning", 1, "rad/s"), FREELY: Slice("_turning", 3, "rad/s")},
}
"""Suffixes, sizes and units of what turns, by how it does."""


class Motions(NamedTuple):
    """Recorded motions of all movers, at even times."""

    poses: Float[np.ndarray, "F D"]
    dt: float
    """Time between two poses [s]."""

    def rates(self, quaternions: tuple[int, ...]) -> Float[np.ndarray, "T R"]:
        """Return the rates from each pose to the next, whose `quaternions` begin there."""
        return change_between(self.poses[:-1], self.poses[1:], quaternions) / self.dt


class Pace(NamedTuple):
    """Speeds of random paths."""

    slowest: float
    """Smallest of the highest frequencies of paths [Hz]."""
    fastest: float
    """Largest of the highest frequencies of paths [Hz]."""
    weakest: float
    """Smallest size of a path, over the largest possible."""
    response: float
    """Time constant with which a mover reaches a velocity [s]."""


CARRYING = Pace(slowest=0.05, fastest=1.0, weakest=0.0, response=0.1)
"""Pace of movers that hold or strike a body."""

THROWING = Pace(slowest=0.5, fastest=2.5, weakest=0.3, response=0.03)
"""Pace of movers under a body that nothing holds: slower paths seldom throw it."""


def pace_of(anchor: int) -> Pace:
    """Return the pace of the movers of a body held by the mover `anchor`; with `FREE` they throw it."""
    return THROWING if anchor == FREE else CARRYING


class Movers:
    """M movers, whose poses have D numbers, and whose rates R: three for a quaternion's four."""

    def __init__(self, tables: dict[str, MoverTable], motions: Motions | None = None):
        """Random paths follow the recorded `motions`, if given."""
        self.motions = motions
        self.tables = list(tables.values())
        self.names = list(tables)
        self.turning: tuple[Turns, ...] = tuple(mover.turns for mover in self.tables)
        self.places = place_movers(self.turning)
        self.quaternions = quaternion_entries(self.places)
        """Where the quaternions begin among the poses."""
        self.size = sum(place.size for place in self.places)
        """Number D of the poses' entries."""
        self.rate_size = sum(place.rate_size for place in self.places)
        """Number R of the rates' entries."""
        self.rest = self._at_rest()
        """Poses at rest (D,) [m, rad]."""
        self.speed = self._limits("speed", "turn_speed")
        """Largest rates (R,) [m/s, rad/s]."""
        self.reach = self._limits("reach", "turn_reach")
        """Distance from rest (R,) within which random paths stay [m, rad]."""

    def _at_rest(self) -> Float[np.ndarray, " D"]:
        turned: dict[Turns, tuple[float, ...]] = {False: (), True: (0.0,), FREELY: NO_ROTATION}
        return np.array([x for mover in self.tables for x in mover.position + turned[mover.turns]])

    def _limits(self, name: str, turning: str) -> Float[np.ndarray, " R"]:
        """Return the value `name` of all movers, and `turning` for each number of their turning rates."""
        values: list[float] = []
        for mover, place in zip(self.tables, self.places, strict=True):
            values += getattr(mover, name)
            values += np.broadcast_to(getattr(mover, turning), place.rate_size - 3).tolist()
        return np.array(values)

    def slices(self, kind: Literal["pose", "rate", "control"]) -> list[Slice]:
        """Return the parts of a state that hold poses, or their rates; or those of a control."""
        suffix, unit = MOVED[kind]
        parts = []
        for name, turns in zip(self.names, self.turning, strict=True):
            parts.append(Slice(name + suffix, 3, unit))
            if turns:
                turned = TURNED[kind][turns]
                parts.append(replace(turned, name=name + turned.name))
        return parts

    def of(
        self, states: Float[np.ndarray, "B S"]
    ) -> tuple[Float[np.ndarray, "B D"], Float[np.ndarray, "B R"]]:
        """Return the movers' poses and rates in states, which begin with them."""
        return states[:, : self.size], states[:, self.size : self.size + self.rate_size]

    def moved(
        self, poses: Float[np.ndarray, "*B D"], changes: Float[np.ndarray, "*B R"]
    ) -> Float[np.ndarray, "*B D"]:
        """Return `poses` after `changes`, which are rates times a duration."""
        return moved(poses, changes, self.quaternions)

    def paths(
        self, starts: Float[np.ndarray, "B D"], rates: Float[np.ndarray, "B T R"], dt: float
    ) -> Float[np.ndarray, "B F D"]:
        """Return the poses at the `starts`, and after each of the `rates`, held for `dt` [s]."""
        poses = [starts]
        for step in range(rates.shape[1]):
            poses.append(self.moved(poses[-1], dt * rates[:, step]))
        return np.stack(poses, axis=1)

    def poses(
        self, paths: Float[np.ndarray, "F D ..."], origin: Float[np.ndarray, " ..."]
    ) -> Float[np.ndarray, "F P 7 ..."]:
        """Return positions from `origin` [m] and quaternions of M movers, and of the world as the last."""
        entries = np.moveaxis(paths, 1, -1)
        poses = np.zeros((*entries.shape[:-1], len(self.places) + 1, 7))
        poses[..., 3] = 1.0
        for number, place in enumerate(self.places):
            poses[..., number, :3] = place.placement.origin(entries)
            turned = place.placement.quaternions(entries)
            if turned is not None:
                poses[..., number, 3:] = turned
        poses = np.moveaxis(poses, (-2, -1), (1, 2))
        poses[:, :, :3] -= origin
        return poses

    def random_paths(
        self,
        rng: np.random.Generator,
        starts: Float[np.ndarray, "B D"],
        rates: Float[np.ndarray, "B R"],
        steps: int,
        dt: float,
        pace: Pace,
    ) -> Float[np.ndarray, "B T R"]:
        """Return rates of smooth random paths about rest, one for each of the `starts` and its initial `rates`.

        Some movers hardly move and others as fast as they may, all hold still now and then, and those that begin elsewhere
        first come within reach.
        """
        wanted = self._waves(rng, len(starts), steps, dt, pace)
        if self.motions is not None:
            following = rng.random(len(starts)) < FOLLOWING
            wanted[following] = self._along_motions(rng, self.motions, wanted[following], dt)
        follow = 1 - np.exp(-dt / pace.response)
        pose = starts
        rate = rates
        path = np.empty((len(starts), steps, self.rate_size))
        for step in range(steps):
            now = wanted[:, step]
            onwards = change_between(now, wanted[:, step + 1], self.quaternions) / dt
            aim = onwards + change_between(pose, now, self.quaternions) / RETURN
            rate = rate + follow * (np.clip(aim, -self.speed, self.speed) - rate)
            pose = self.moved(pose, dt * rate)
            path[:, step] = rate
        return path

    def _waves(
        self,
        rng: np.random.Generator,
        count: int,
        steps: int,
        dt: float,
        pace: Pace,
    ) -> Float[np.ndarray, "B F D"]:
        """Return poses after none to `steps` steps, within reach."""
        movers = len(self.places)
        own = np.repeat(np.arange(movers), [place.rate_size for place in self.places])
        exponents = rng.uniform(np.log(pace.slowest), np.log(pace.fastest), (count, movers))
        highest = np.exp(exponents)[:, own]
        strength = rng.uniform(pace.weakest, 1, (count, movers))
        strength[rng.random((count, movers)) < STILL_SHARE] *= STILL
        farthest = self.speed / (2 * np.pi * highest)
        size = np.minimum(self.reach, farthest) * strength[:, own]
        time = self._own_time(rng, count, steps, dt)[:, :, own]
        total = np.zeros((count, steps + 1, self.rate_size))
        for _ in range(WAVES):
            frequency = highest * rng.uniform(SLOWER, 1, highest.shape)
            phase = rng.uniform(0, 2 * np.pi, highest.shape)
            total += np.sin(2 * np.pi * frequency[:, None] * time + phase[:, None])
        # Their sum is squashed into ±1: no mover goes beyond its reach.
        away = size[:, None] * np.sin(total * np.sqrt(2 / WAVES))
        return self.moved(np.broadcast_to(self.rest, (*away.shape[:2], self.size)), away)

    def _along_motions(
        self,
        rng: np.random.Generator,
        motions: Motions,
        waves: Float[np.ndarray, "B F D"],
        dt: float,
    ) -> Float[np.ndarray, "B F D"]:
        """Return stretches of the motions, each begun where the body rests, with some of the `waves` about rest added."""
        count, frames = waves.shape[:2]
        speed = rng.uniform(*PLAYED, (count, 1))
        last = len(motions.poses) - 2
        begin = rng.uniform(0, np.maximum(last - speed * (frames - 1) * dt / motions.dt, 0))
        frame = (begin + speed * np.arange(frames) * dt / motions.dt).clip(0, last)
        before = frame.astype(int)
        first, second = motions.poses[before], motions.poses[before + 1]
        between = change_between(first, second, self.quaternions)
        poses = self.moved(first, (frame - before)[..., None] * between)
        straying = rng.uniform(0, STRAYING, (count, 1, 1))
        away = change_between(np.broadcast_to(self.rest, waves.shape), waves, self.quaternions)
        return self.moved(self._begun_at_rest(poses), straying * away)

    def _begun_at_rest(self, poses: Float[np.ndarray, "B F D"]) -> Float[np.ndarray, "B F D"]:
        """Return paths turned about the vertical and shifted so that the first mover with pins begins above its rest."""
        holder = next((n for n, table in enumerate(self.tables) if table.pins), 0)
        place = self.places[holder].placement
        start = poses[:, :1]
        about = place.origin(start)
        turned = place.quaternions(start)
        heading = np.zeros(start.shape[:2]) if turned is None else heading_of(turned)
        to = np.concatenate(
            [np.broadcast_to(place.origin(self.rest)[:2], about[..., :2].shape), about[..., 2:]],
            axis=-1,
        )
        return moved_as_one(poses, self.places, facing(-heading), about, to)

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


def mocap_movers(tables: dict[str, MotionTable], positions: Float[np.ndarray, "M 3"]) -> Movers:
    """Return the movers of a MuJoCo model, which rest at `positions` [m]."""
    placed = {}
    for (name, table), position in zip(tables.items(), positions, strict=True):
        placed[name] = MoverTable(position=tuple(position.tolist()), **table.model_dump())
    return Movers(placed)


def movers_of(name: str, text: str, rest: Float[np.ndarray, " S"]) -> Movers | None:
    """Return the movers of the soft body `name` that rests at `rest`, with the definition `text`, empty if it ships.

    None for any other system. Only the definition is read.
    """
    if text:
        definition = read_definition_text(text).definition
    else:
        with shipped_folder() as folder:
            _, definition = read_definition(folder / f"{name}.toml")
    if isinstance(definition, SoftDefinition):
        return Movers(definition.movers)
    if isinstance(definition, FlexDefinition):
        turning: tuple[Turns, ...] = tuple(table.turns for table in definition.movers.values())
        entries = [place.entry for place in place_movers(turning)]
        return mocap_movers(definition.movers, np.stack([rest[i : i + 3] for i in entries]))
    return None
