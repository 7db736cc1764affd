"""What every physics model offers to the rest of the pipeline."""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.errors import ArgumentError
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds, Layout
from neuroanimator.state.start import start_state
from neuroanimator.state.structure import Structure

if TYPE_CHECKING:  # pydantic takes a tenth of a second to import, and an emulator does not need it
    from neuroanimator.definitions.goal import GoalTable

TIME_RESOLUTION = 1e-9
"""Times closer than this are the same time [s]; two steps never differ by so little."""

MAX_STEPS = 2**31
"""Physics steps in a super step, which MuJoCo counts in 32 bits."""


@dataclass(frozen=True)
class Scheme:
    """An integrator and its step."""

    integrator: str
    dt: float
    """Physics step [s]."""

    def steps(self, duration: float) -> int:
        """Return how many steps make up `duration` [s]; refuse if it is not a whole number."""
        ratio = duration / self.dt
        if not 0 < ratio < MAX_STEPS:  # NaN is refused too
            raise ArgumentError(
                f"dt: wanted a finite time above 0 s, came {duration} s of {self.dt} s physics steps."
            )
        count = round(ratio)
        if count < 1 or abs(count * self.dt - duration) > TIME_RESOLUTION:
            raise ArgumentError(
                f"dt: {duration} s is not a whole number of {self.dt} s physics steps."
            )
        return count


class Runs(NamedTuple):
    """Simulated motions, one per row."""

    states: np.ndarray
    """(B, T+1, S): the start and the state after each of T controls."""
    is_alive: np.ndarray
    """(B,): False where the physics blew up; such a row holds no usable numbers."""


@dataclass(frozen=True)
class Goal:
    """A state, or part of one, worth reaching."""

    values: tuple[tuple[int, float], ...]
    """(state entry, wanted value) pairs; all four entries of a quaternion or none."""
    tolerances: tuple[float, ...]
    """How far off still counts as reached, per pair and in its unit (a quaternion's: of the angle [rad])."""
    seconds: float = 2.0
    """A sensible length of the motion [s]."""
    start: tuple[float, ...] = ()
    """A state (S,) to reach it from, if nothing else is said; empty for the state of rest."""


class System(abc.ABC):
    """A true, slow physics model: (s, u) → s a moment later.

    The control u holds whatever drives the system from outside, by name: motor torques in an
    active system, external forces f in a passive one.
    """

    name: str
    definition: str = ""
    """JSON text the system can be made from again; empty for one that comes with the package."""
    state: Layout
    control: Layout
    bounds: Bounds
    scheme: Scheme
    """What a user would run by default; speed-ups are measured against it."""
    truth: Scheme
    """A finer scheme, close to converged: teacher of emulators and judge of controllers."""
    fine: Scheme
    """The reference every error is measured against: at most a tenth of the physics step."""
    structure: Structure
    skeleton: Skeleton
    rest: np.ndarray
    """(S,) a state of rest, where motions begin if nothing else is said."""
    warm_up: float = 0.0
    """Random starts are taken from this first stretch of random driving [s]: contacts have settled in most."""
    goals: Mapping[str, Goal] = {}
    gait: Gait | None = None
    """How it moves along if nothing else is said; None if it has no such way."""

    def __repr__(self) -> str:
        kind, sizes = type(self).__name__, f"{self.state.size} states, {self.control.size} controls"
        goals = f", goals {', '.join(self.goals)}" if self.goals else ""
        return f'{kind}("{self.name}", {sizes}, step {self.physics_dt * 1e3:g} ms{goals})'

    @property
    def physics_dt(self) -> float:
        """The step δt that `substeps` counts [s]."""
        return self.scheme.dt

    def start_at(self, parts: Mapping[str, Sequence[float]]) -> np.ndarray:
        """Return the state of rest (S,) with the numbers of each of `parts` in their places; see `start_state`."""
        orientations = [entry for entry, _ in self.structure.orientations]
        return start_state(
            self.state, self.rest, parts, orientations=orientations, cloud=self.structure.cloud
        )

    def with_starts(
        self, goals: Mapping[str, Goal], tables: Mapping[str, GoalTable]
    ) -> dict[str, Goal]:
        """Return `goals` with the starts their tables name; ArgumentError says which of them is wrong."""
        found = {}
        for name, goal in goals.items():
            parts = tables[name].start
            try:
                start = tuple(map(float, self.start_at(parts))) if parts else ()
            except ArgumentError as error:
                raise ArgumentError(f"goals.{name}: {error}") from error
            found[name] = replace(goal, start=start)
        return found

    def check_controls(self, controls: np.ndarray) -> np.ndarray:
        """Return `controls` (..., C) if finite and within bounds."""
        return self.bounds.check(self.control.check(controls, "control"), self.control.names)

    @abc.abstractmethod
    def simulate(
        self,
        starts: np.ndarray,
        controls: np.ndarray,
        dt: float,
        *,
        scheme: Scheme | None = None,
        threads: int = 1,
    ) -> Runs:
        """Return the runs from `starts` (B, S) under `controls` (B, T, C), each held for `dt` [s].

        `scheme` defaults to `truth`. Bytes do not depend on `threads`.
        """

    @abc.abstractmethod
    def sample_starts(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return `count` random states (count, S) covering what occurs in use."""
