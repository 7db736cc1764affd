"""Rules of episodes as a TOML table, in the terms of Gymnasium's documents.

steps = 1000                                           # an episode has at most so many

[reward]
forward = { part = "rootx", weight = 1.0 }             # how fast this number of the state grows, a second
control_cost = 0.001                                   # times the sum of the squared controls, taken off
healthy = 1.0                                          # for every step after which the state is healthy

[healthy]                                              # between these, both excluded; else the episode is over
rootz = [0.7, inf]

[observation]
leave_out = ["rootx"]
clip_velocities = 10.0

[start]
noise = 0.005                                          # uniform, of every number of the state
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import Field

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.rules import EpisodeRules, never
from neuroanimator.state.layout import Layout
from neuroanimator.state.start import start_state
from neuroanimator.tables import Finite, Positive, Table, check_table, read_toml

GYMNASIUM_TABLES = {"Hopper-v5": "hopper.toml", "Swimmer-v5": "swimmer.toml"}
"""The tables of Gymnasium's own environments that come with the package."""

VELOCITY_UNITS = ("m/s", "rad/s")
"""Parts of the state in these are velocities."""

MAX_STEPS = 10_000_000
"""Longest episode."""

Limit = Annotated[float, Field(ge=-np.inf, le=np.inf)]
"""Any number, infinite ones too: no limit on that side."""


class ForwardTable(Table):
    """Pay for the velocity by which a number of the state grows."""

    part: str
    entry: Annotated[int, Field(ge=0)] = 0
    """Which number of the part."""
    weight: Finite = 1.0


class RewardTable(Table):
    """What a step earns: the sum of these."""

    forward: ForwardTable | None = None
    control_cost: Finite = 0.0
    """Times Σ u², taken off."""
    healthy: Finite = 0.0
    """For a step after which the state is healthy."""


class ObservationTable(Table):
    """What of the state is shown to a policy."""

    leave_out: tuple[str, ...] = ()
    clip_velocities: Positive | None = None
    """Velocities are shown within ± this."""


class StartTable(Table):
    """Where episodes begin."""

    parts: dict[str, tuple[Finite, ...]] = {}  # noqa: RUF012 - pydantic copies it
    """Numbers of the state that are not as at rest."""
    noise: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    """Every number is moved by a uniform one within ± this, in its unit."""


class RulesTable(Table):
    """The rules of a task's episodes."""

    steps: Annotated[int, Field(ge=1, le=MAX_STEPS)] | None = None
    reward: RewardTable
    healthy: dict[str, tuple[Limit, Limit]] = {}  # noqa: RUF012 - pydantic copies it
    """Parts of the state, and between what each of their numbers must be."""
    end_when_unhealthy: bool = True
    observation: ObservationTable = ObservationTable()
    start: StartTable | None = None


def find_rules(rules: EpisodeRules | str | Path, emulator: Emulator) -> EpisodeRules:
    """Return the rules of an environment's name such as `Swimmer-v5`, or of a TOML file; rules themselves as they are.

    Raises ArgumentError or BadFileError: for a name there is not, a file that cannot be read, parts that the emulator's
    state has not.
    """
    if isinstance(rules, EpisodeRules):
        return rules
    name = str(rules)
    if name in GYMNASIUM_TABLES:
        folder = resources.files("neuroanimator.gym") / "tables"
        with resources.as_file(folder / GYMNASIUM_TABLES[name]) as path:
            return read_rules(path, emulator)
    if not name.endswith(".toml"):
        valid = ", ".join(GYMNASIUM_TABLES)
        raise ArgumentError(
            f"No rules called '{name[:60]}'. Wanted a TOML file, or one of: {valid}."
        )
    return read_rules(Path(name), emulator)


def read_rules(path: Path, emulator: Emulator) -> EpisodeRules:
    """Return the rules that a TOML file declares for states of `emulator`."""
    table = check_table(read_toml(path), path.name, RulesTable)
    try:
        return rules_of(table, emulator)
    except ArgumentError as error:
        raise ArgumentError(f"{path.name}: {error}") from error


def rules_of(table: RulesTable, emulator: Emulator) -> EpisodeRules:
    """Return the rules of a table as functions of states of `emulator`."""
    layout = emulator.state
    declared = _Declared(
        table.reward,
        _forward_entry(table.reward.forward, layout),
        *_healthy_limits(table.healthy, layout),
        _shown_entries(table.observation.leave_out, layout),
        _observed_limits(table.observation.clip_velocities, layout),
        _start(table.start, emulator),
        0.0 if table.start is None else table.start.noise,
    )
    return EpisodeRules(
        declared.reward,
        declared.observe,
        declared.is_unhealthy if table.end_when_unhealthy else never,
        declared.draw_start if table.start is not None else None,
        table.steps,
    )


@dataclass(frozen=True)
class _Declared:
    """A table, its names turned into entries of the state."""

    weights: RewardTable
    forward: int
    healthy_low: Float[np.ndarray, " S"]
    healthy_high: Float[np.ndarray, " S"]
    shown: Int[np.ndarray, " O"]
    observed_limit: Float[np.ndarray, " S"]
    start: Float[np.ndarray, " S"]
    noise: float

    def reward(
        self,
        states: Float[np.ndarray, "B S"],
        controls: Float[np.ndarray, "B C"],
        following: Float[np.ndarray, "B S"],
        dt: float,
    ) -> Float[np.ndarray, " B"]:
        """Return weight · forward velocity − control cost + healthy reward, as Gymnasium's MuJoCo environments have it."""
        effort = (np.asarray(controls, float) ** 2).sum(axis=1)
        earned = -self.weights.control_cost * effort
        earned += self.weights.healthy * ~self.is_unhealthy(following)
        if self.weights.forward is not None:
            moved = following[:, self.forward].astype(float) - states[:, self.forward]
            earned += self.weights.forward.weight * moved / dt
        return earned

    def is_unhealthy(self, states: Float[np.ndarray, "B S"]) -> Bool[np.ndarray, " B"]:
        """Return whether any number is not between its limits, NaN included."""
        is_within = (states > self.healthy_low) & (states < self.healthy_high)
        is_free = np.isinf(self.healthy_low) & np.isinf(self.healthy_high)
        return np.asarray(~(is_within | is_free).all(axis=1))

    def observe(self, states: Float[np.ndarray, "B S"]) -> Float[np.ndarray, "B O"]:
        """Return the numbers that are shown, in the state's order."""
        clipped = np.clip(states, -self.observed_limit, self.observed_limit)
        return clipped[:, self.shown]

    def draw_start(self, rng: np.random.Generator) -> Float[np.ndarray, " S"]:
        """Return a start with uniform noise."""
        return self.start + rng.uniform(-self.noise, self.noise, len(self.start))


def _forward_entry(forward: ForwardTable | None, layout: Layout) -> int:
    """Return the entry of the state that `forward` names, or 0 where nothing is named."""
    if forward is None:
        return 0
    place = layout.index(forward.part)
    size = place.stop - place.start
    if forward.entry >= size:
        raise ArgumentError(
            f"reward.forward: '{forward.part}' has {size} numbers, so entry is 0 to {size - 1}, came {forward.entry}."
        )
    return place.start + forward.entry


def _healthy_limits(
    healthy: dict[str, tuple[float, float]], layout: Layout
) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, " S"]]:
    """Return between what each number of the state must be."""
    low = np.full(layout.size, -np.inf)
    high = np.full(layout.size, np.inf)
    for part, (least, largest) in healthy.items():
        if not least < largest:
            raise ArgumentError(
                f"healthy.{part}: wanted the least value below the largest, came {least:g} and {largest:g}."
            )
        low[layout.index(part)] = least
        high[layout.index(part)] = largest
    return low, high


def _shown_entries(leave_out: tuple[str, ...], layout: Layout) -> Int[np.ndarray, " O"]:
    """Return the entries of the state that are observed."""
    is_shown = np.ones(layout.size, bool)
    for part in leave_out:
        is_shown[layout.index(part)] = False
    if not is_shown.any():
        raise ArgumentError("observation.leave_out: nothing is left. Leave out fewer parts.")
    return np.flatnonzero(is_shown)


def _observed_limits(clip: float | None, layout: Layout) -> Float[np.ndarray, " S"]:
    """Return within ± what each number of the state is observed."""
    limits = [
        np.full(part.size, clip if clip and part.unit in VELOCITY_UNITS else np.inf)
        for part in layout.slices
    ]
    return np.concatenate(limits)


def _start(table: StartTable | None, emulator: Emulator) -> Float[np.ndarray, " S"]:
    """Return the state about which episodes begin."""
    parts = {} if table is None else table.parts
    orientations = [entry for entry, _ in emulator.state_structure.orientations]
    return start_state(emulator.state, emulator.rest, parts, orientations=orientations)
