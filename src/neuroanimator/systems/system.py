"""The interface of every physics model to the rest of the pipeline."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.codegen.cores import core_count
from neuroanimator.emulator.spec import EmulatorSpec, Engine
from neuroanimator.errors import ArgumentError, NeuroAnimatorError
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds, Layout
from neuroanimator.state.parameters import (
    Parameter,
    draw_parameters,
    fixed_parameters,
    nominal_values,
)
from neuroanimator.state.start import Start, start_state
from neuroanimator.state.structure import Structure
from neuroanimator.state.symmetry import Symmetry
from neuroanimator.systems.goal import Goal, goal_in_layout
from neuroanimator.systems.recording_file import RecordingFile

if TYPE_CHECKING:  # pydantic takes a tenth of a second to import, and an emulator does not need it
    from neuroanimator.definitions.parts import GoalTable


TIME_RESOLUTION = 1e-9
"""Difference below which times are the same [s]; two steps never differ by less."""

MAX_STEPS = 2**31
"""Maximum number of physics steps in a super step, which MuJoCo counts in 32 bits."""


@dataclass(frozen=True)
class Scheme:
    """An integrator and its step."""

    integrator: str
    dt: float
    """Physics step [s]."""

    def steps(self, duration: float) -> int:
        """Return the number of steps in `duration` [s]; refuse if it is not a whole number."""
        ratio = duration / self.dt
        if not 0 < ratio < MAX_STEPS:  # refuses NaN, too
            raise ArgumentError(
                f"dt: wanted a finite time above 0 s, got {duration} s of {self.dt} s physics steps."
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
    """States (B, T+1, S): the start and the state after each of T controls."""
    has_diverged: np.ndarray
    """Whether the physics of each run (B,) diverged; such a row holds no usable numbers."""


LONG_WINDOW = 16
"""Number of super steps in the training loss of bodies whose errors show late: soft ones."""


class System(abc.ABC):
    """A true, slow physics model: (s, u) → s a moment later.

    The control u holds what drives the system from outside, by name: motor torques in an active
    system, external forces f in a passive one.
    """

    name: str
    definition_text: str = ""
    """JSON text from which the system can be made again; empty for a shipped one."""
    is_tied: bool = False
    """Whether some of its parts are tied together, so that not every state is possible: see `closed`."""
    is_self_contained: bool = True
    """Whether its definition holds all of its physics.

    If not, it names a user's file, which may be missing or may not be run; so no training or measurement may depend on
    simulating such a system unasked.
    """
    missing: str = ""
    """Reason why its physics is missing, in words; empty if it is not."""
    recordings: RecordingFile | None = None
    """Recordings from which the system is known; None if it has physics."""
    state: Layout
    control: Layout
    bounds: Bounds
    scheme: Scheme
    """Scheme a user would run by default; speed-ups are measured against it."""
    truth: Scheme
    """Finer scheme, close to converged: it teaches emulators and judges controllers."""
    fine: Scheme
    """Reference scheme of every error, with at most a tenth of the physics step."""
    structure: Structure
    skeleton: Skeleton
    rest: np.ndarray
    """State of rest (S,), where motions begin by default."""
    is_pushed: bool = False
    """Whether outside forces move it, not motors or muscles of its own: held for seconds, they throw it."""
    warm_up: float = 0.0
    """Time of random driving from which random starts are taken [s]: contacts have settled in most."""
    run_steps: int = 40
    """Number of super steps in a run of a dataset."""
    window_steps: int = 4
    """Maximum number of super steps in the training loss: those after each example within its run."""
    reset_share: float = 0.0
    """Share of the runs of a dataset that begin at one of the states `sample_resets` returns, without warm-up."""
    parameters: tuple[Parameter, ...] = ()
    """Parameters that vary from body to body, in a family: the last entries of a state, which no motion changes."""
    goals: Mapping[str, Goal] = {}
    gait: Gait | None = None
    """Its default gait; None if it has none."""
    body_length: float | None = None
    """Length of the body at rest, a unit of distances [m]; None if it has none."""
    has_ground: bool = False
    """Whether a skeleton without a ground is drawn on one, at height zero."""
    water_surface: float | None = None
    """Height of the surface of the surrounding water [m]; None without a visible surface."""

    def __repr__(self) -> str:
        kind, sizes = type(self).__name__, f"{self.state.size} states, {self.control.size} controls"
        goals = f", goals {', '.join(self.goals)}" if self.goals else ""
        return f'{kind}("{self.name}", {sizes}, step {self.physics_dt * 1e3:g} ms{goals})'

    @property
    def can_simulate(self) -> bool:
        """Whether there is physics to simulate: not for a system known from recordings alone, nor for a missing model."""
        return self.recordings is None and not self.missing

    def fits(self, spec: EmulatorSpec) -> bool:
        """Return whether its state and control are those of an emulator's `spec`, by names and units."""
        return (self.state, self.control) == (spec.state, spec.control)

    @property
    def parameter_entries(self) -> slice:
        """State entries that are parameters."""
        return slice(self.state.size - len(self.parameters), self.state.size)

    def at(self, /, **values: float) -> System:
        """Return the body of this family with the given parameters, or the smaller family: it rests, and starts, with them.

        `system.at(forearm_mass=1.3)`. Other parameters vary as before, and are nominal at rest.
        Raises ArgumentError for a name that is not a parameter, and for a value out of range.
        """
        fixed = copy(self)
        fixed.parameters = fixed_parameters(self.parameters, values)
        fixed.rest = self.rest.copy()
        fixed.rest[self.parameter_entries] = nominal_values(fixed.parameters)
        return fixed

    @property
    def engine(self) -> Engine | None:
        """MuJoCo's release, and the gains it compiled; None for any other physics."""
        return None

    @property
    def physics_dt(self) -> float:
        """Physics step δt, counted by `substeps` [s]."""
        return self.scheme.dt

    def sample_paths(
        self, rng: np.random.Generator, count: int, steps: int, dt: float
    ) -> Float[np.ndarray, "B T C"] | None:
        """Return the controls of random runs (count, steps, C) along suitable paths; None if any controls in bounds will do."""
        return None

    def symmetries(self, states: np.ndarray, controls: np.ndarray) -> tuple[Symmetry, ...]:
        """Return the symmetries of its motions, tested from `states` (N, S) under `controls` (N, C)."""
        return ()

    def start_at(self, parts: Start) -> np.ndarray:
        """Return the state of rest (S,) with the numbers of `parts` set; see `start_state`.

        `{"root.heading": 0.6}` and `"root.position=3,-2,8"` are parts.
        """
        orientations = [entry for entry, _ in self.structure.orientations]
        return start_state(
            self.state, self.rest, parts, orientations=orientations, cloud=self.structure.cloud
        )

    def goal(self, name: str, table: GoalTable) -> Goal:
        """Return the goal that `table` describes, without its start.

        Raises ArgumentError, which names the goal and the part at fault.
        """
        return goal_in_layout(self.state, name, table)

    def goals_of(self, tables: Mapping[str, GoalTable]) -> dict[str, Goal]:
        """Return the goals that `tables` describe, with their starts.

        Raises ArgumentError, which names the goal and the part at fault.
        """
        goals = {}
        for name, table in tables.items():
            start: tuple[float, ...] = ()
            if table.start:
                start = self._goal_start(name, table)
            goals[name] = replace(self.goal(name, table), start=start)
        return goals

    def _goal_start(self, name: str, table: GoalTable) -> tuple[float, ...]:
        try:
            start = self.start_at(table.start)
        except ArgumentError as error:
            raise ArgumentError(f"goals.{name}: {error}") from error
        return tuple(float(number) for number in start)

    def check_controls(self, controls: np.ndarray) -> np.ndarray:
        """Return `controls` (..., C) if they are finite and within bounds."""
        return self.bounds.check(self.control.check(controls, "control"), self.control.names)

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

        `scheme` defaults to `truth`. Bytes do not depend on `threads`. Raises ArgumentError for
        numbers that are not finite, for controls out of bounds, and for a `dt` that is not a whole
        number of physics steps.
        """
        states, controls, scheme, substeps = self._prepare(starts, controls, dt, scheme)
        self._simulate(states, controls, scheme, substeps, threads)
        return Runs(states, self.has_diverged(states))

    def simulate_fastest(
        self,
        starts: np.ndarray,
        controls: np.ndarray,
        dt: float,
        scheme: Scheme | None = None,
    ) -> Runs:
        """Return the runs of `simulate`, computed in the fastest way: on every core, or in C compiled for the body.

        C and JAX agree up to the last few digits (tests/physics/deformable/native/test_compiled.py).
        """
        states, controls, scheme, substeps = self._prepare(starts, controls, dt, scheme)
        self._simulate_fastest(states, controls, scheme, substeps)
        return Runs(states, self.has_diverged(states))

    def _prepare(
        self, starts: np.ndarray, controls: np.ndarray, dt: float, scheme: Scheme | None
    ) -> tuple[np.ndarray, np.ndarray, Scheme, int]:
        """Return states (B, T+1, S) with the given starts, checked controls, the scheme, and the number of steps per control."""
        starts = self.state.check(starts, "state")
        controls = self.check_controls(controls)
        scheme = scheme or self.truth
        substeps = scheme.steps(dt)
        states = np.empty((len(starts), controls.shape[1] + 1, self.state.size))
        states[:, 0] = starts
        return states, controls, scheme, substeps

    @abc.abstractmethod
    def _simulate(
        self,
        states: np.ndarray,
        controls: np.ndarray,
        scheme: Scheme,
        substeps: int,
        threads: int,
    ) -> None:
        """Fill `states` (B, T+1, S) from the second on: each is `substeps` steps of `scheme` after the one before."""

    def _simulate_fastest(
        self, states: np.ndarray, controls: np.ndarray, scheme: Scheme, substeps: int
    ) -> None:
        """Fill `states` as `_simulate` does, as fast as this system can."""
        self._simulate(states, controls, scheme, substeps, core_count())

    @abc.abstractmethod
    def has_diverged(self, states: np.ndarray) -> np.ndarray:
        """Return whether each run (B, T+1, S) has diverged: it is not finite, or impossibly fast or wide."""

    @abc.abstractmethod
    def sample_starts(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return `count` random states (count, S) that cover those in use."""

    def sample_resets(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return states (count, S) at which motions are started on purpose: rest, and others if there are any."""
        return np.repeat(self.rest[None], count, axis=0)

    def draw_bodies(self, rng: np.random.Generator, starts: np.ndarray) -> None:
        """Give each of `starts` (B, S) the parameters of a random body of the family, in place."""
        starts[:, self.parameter_entries] = draw_parameters(self.parameters, rng, len(starts))

    def closed(
        self, states: Float[np.ndarray, "N S"]
    ) -> tuple[Float[np.ndarray, "N S"], Bool[np.ndarray, " N"]]:
        """Return (the states near `states` in which parts that are tied together meet, whether each was found)."""
        return states, np.full(len(states), not self.is_tied)

    def kinetic_energies(self, states: np.ndarray) -> np.ndarray | None:
        """Return the kinetic energy [J] of each of `states` (N, S): (N,); None if masses are unknown."""
        return None

    def contact_counts(self, states: np.ndarray) -> np.ndarray | None:
        """Return the number of contacts in each of `states` (N, S): (N,).

        None if it is unknown, or nothing can touch anything.
        """
        return None


class SystemWithoutPhysics(System):
    """A system whose states are known, but which cannot be simulated: attempts raise `reason`."""

    @property
    @abc.abstractmethod
    def reason(self) -> NeuroAnimatorError:
        """The error that says why it cannot be simulated, and what to do."""

    def _simulate(
        self,
        states: np.ndarray,
        controls: np.ndarray,
        scheme: Scheme,
        substeps: int,
        threads: int,
    ) -> None:
        raise self.reason

    def has_diverged(self, states: np.ndarray) -> np.ndarray:
        raise self.reason

    def sample_starts(self, rng: np.random.Generator, count: int) -> np.ndarray:
        raise self.reason


def closed_starts(
    spec: EmulatorSpec, states: Float[np.ndarray, "N S"], system: System | None
) -> Float[np.ndarray, "N S"]:
    """Return `states` with parts that are tied together meeting; rest for those that cannot, and without the `system`."""
    if not spec.is_tied:
        return states
    rest = np.tile(spec.rest, (len(states), 1))
    if system is None:
        return rest
    closed, is_closed = system.closed(np.asarray(states, float))
    return np.where(is_closed[:, None], closed, rest)
