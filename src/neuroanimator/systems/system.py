"""What every physics model offers to the rest of the pipeline."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from neuroanimator.errors import ArgumentError
from neuroanimator.systems.layout import Layout
from neuroanimator.systems.skeleton import Skeleton

TIME_RESOLUTION = 1e-9
"""Times closer than this are the same time [s]; two steps never differ by so little."""


@dataclass(frozen=True)
class Scheme:
    """An integrator and its step."""

    integrator: str
    dt: float
    """Physics step [s]."""

    def steps(self, duration: float) -> int:
        """Return how many steps make up `duration` [s]; refuse if it is not a whole number."""
        count = round(duration / self.dt)
        if count < 1 or abs(count * self.dt - duration) > TIME_RESOLUTION:
            raise ArgumentError(f"dt: {duration} s is not a whole number of {self.dt} s physics steps.")
        return count


class Runs(NamedTuple):
    """Simulated motions, one per row."""

    states: np.ndarray
    """(B, T+1, S): the start and the state after each of T controls."""
    is_alive: np.ndarray
    """(B,): False where the physics blew up; such a row holds no usable numbers."""


@dataclass(frozen=True)
class Structure:
    """What an emulator may exploit, because it holds exactly.

    `angles`: integer combinations of the state whose sine and cosine are all that matters of them.
    `rates`: (i, j) where state entry j is the time derivative of entry i.
    `plain`: state entries that enter as they are.
    `is_odd`: negating state and control negates the motion (mirror symmetry).
    """

    angles: tuple[tuple[int, ...], ...]
    rates: tuple[tuple[int, int], ...]
    plain: tuple[int, ...]
    is_odd: bool


class System(abc.ABC):
    """A true, slow physics model: (s, u) → s a moment later.

    The control u holds whatever drives the system from outside, by name: motor torques in an
    active system, external forces f in a passive one.
    """

    name: str
    state: Layout
    control: Layout
    control_limit: np.ndarray
    """(C,): largest magnitude of each control, in its own unit."""
    scheme: Scheme
    """What a user would run by default; speed-ups are measured against it."""
    truth: Scheme
    """A finer scheme, converged to rounding error: teacher of emulators and judge of controllers."""
    structure: Structure
    skeleton: Skeleton

    @property
    def physics_dt(self) -> float:
        """The step δt that `substeps` counts [s]."""
        return self.scheme.dt

    def check_controls(self, controls: np.ndarray) -> np.ndarray:
        """Return `controls` (..., C) if finite and within bounds."""
        array = self.control.check(controls, "control")
        beyond = np.abs(array) > self.control_limit * (1 + 1e-6)
        if beyond.any():
            entry = int(np.argwhere(beyond)[0][-1])
            limit = self.control_limit[entry]
            raise ArgumentError(
                f"control: {self.control.names[entry]} out of bounds; wanted between {-limit:g} and {limit:g}, "
                f"came {array[..., entry].flat[np.abs(array[..., entry]).argmax()]:g}."
            )
        return array

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
