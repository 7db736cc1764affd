"""Episodes by rules: an emulator or the physics steps the states; the rules define observations, rewards and ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Bool, Float, Shaped
from numpy.typing import ArrayLike

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.super_step import locate
from neuroanimator.emulator.trust import EDGE
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.batched_step import step_rows
from neuroanimator.gym.rules import EpisodeRules, drawn_starts
from neuroanimator.gym.vector_env import EpisodeRows, StepResults
from neuroanimator.physics import tied_system
from neuroanimator.state.slowness import slowness
from neuroanimator.systems.system import Scheme, System, closed_starts

SECONDS = 10.0
"""Default length of an episode [s]; longer for a slow system."""

NOISE = 0.1
"""Distance of starts from rest, in standard deviations of the change in one super step: barely visible."""

MAX_PENALISED = 10.0
"""Score above which the penalty stays the same: the error already exceeds the signal."""


class Leap(NamedTuple):
    """Result of a super step, a row each."""

    states: Float[np.ndarray, "B S"]
    is_lost: Bool[np.ndarray, " B"]
    """Whether the motion is no longer trustworthy, so that the episode ends."""
    penalties: Float[np.ndarray, " B"] | float = 0.0
    """Penalties on the step's reward beyond the rules."""
    info: dict[str, Shaped[np.ndarray, " B"]] = {}  # noqa: RUF012 - never changed


Stepper = Callable[
    [Float[np.ndarray, "B S"], Float[np.ndarray, "B C"], Bool[np.ndarray, " B"]], Leap
]
"""(states, controls, whether each row restarts) → the super step."""


class EmulatorStepper:
    """A stepper by an emulator, which ends episodes outside training; a copy steps its own bodies."""

    def __init__(self, emulator: Emulator, trust_limit: float, trust_penalty: float):
        if not trust_limit > 0 or not 0 <= trust_penalty < np.inf:
            raise ArgumentError(
                "trust_limit and trust_penalty: wanted a score above 0 and a penalty of 0 or more, "
                f"got {trust_limit:g} and {trust_penalty:g}."
            )
        self._emulator = emulator
        self._trust_limit = trust_limit
        self._trust_penalty = trust_penalty
        # Kept from step to step: decoding and encoding a latent state changes it slightly.
        self._body = locate(emulator, emulator.rest[None])

    def __call__(
        self,
        states: Float[np.ndarray, "B S"],
        controls: Float[np.ndarray, "B C"],
        is_new: Bool[np.ndarray, " B"],
    ) -> Leap:
        emulator = self._emulator
        if is_new.all():
            self._body = locate(emulator, states)
        elif is_new.any():
            for kept, new in zip(self._body, locate(emulator, states[is_new]), strict=True):
                kept[is_new] = new
        made = step_rows(emulator, self._body.latent, controls)
        self._body, following = self._body.moved_on(emulator.origin, made.latent, made.states)
        # NaN is beyond every limit.
        trust = np.nan_to_num(made.trust, nan=np.inf)
        beyond = np.clip(trust, EDGE, MAX_PENALISED) - EDGE
        is_lost = made.begins_far | made.ends_far | (trust > self._trust_limit)
        return Leap(following, is_lost, self._trust_penalty * beyond, made.info)


def physics_stepper(system: System, scheme: Scheme, dt: float) -> Stepper:
    """Return a stepper by a system, which ends episodes where it diverges."""
    scheme.steps(dt)  # refuses a super step that is not a whole number of steps
    return partial(_leap_in_physics, system, scheme, dt)


def _leap_in_physics(
    system: System,
    scheme: Scheme,
    dt: float,
    states: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B C"],
    is_new: Bool[np.ndarray, " B"],
) -> Leap:
    held = controls[:, None].astype(float)
    runs = system.simulate_fastest(states.astype(float), held, dt, scheme)
    following = np.where(runs.has_diverged[:, None], states, runs.states[:, 1])
    return Leap(following, runs.has_diverged)


@final
class StateRows(EpisodeRows):
    """Episodes by the same rules for any stepper."""

    option = "state"
    max_observation = np.inf

    def __init__(
        self,
        emulator: Emulator,
        stepper: Stepper,
        rules: EpisodeRules,
        seconds: float | None,
        noise: float,
    ):
        """Episodes have the rules' length unless `seconds` is given."""
        if seconds is None and rules.steps is not None:
            seconds = rules.steps * emulator.dt
        if seconds is None:
            seconds = SECONDS * slowness(emulator.dt)
        if not emulator.dt <= seconds < np.inf:
            raise ArgumentError(
                f"seconds: wanted at least one super step of {emulator.dt:g} s, got {seconds:g}."
            )
        self.emulator = emulator
        self.steps = round(seconds / emulator.dt)
        self.first = emulator.rest
        self._stepper = stepper
        self._rules = rules
        self._noise = noise
        self._is_new: Bool[np.ndarray, ...] = np.zeros((), bool)

    def draw(self, random: Sequence[np.random.Generator]) -> Float[np.ndarray, "R S"]:
        if self._rules.draw_start is None:
            return starts_near_rest(self.emulator, self._noise, random)
        return drawn_starts(self._rules, self.emulator, random)

    def check(self, start: ArrayLike) -> Float[np.ndarray, "*B S"]:
        return self.emulator.state.check(start, "state")

    def place(self, starts: Float[np.ndarray, "B S"], rows: Bool[np.ndarray, " B"]) -> None:
        self._is_new = self._is_new | rows
        self.states = starts if rows.all() else np.where(rows[:, None], starts, self.states)

    def advance(self, controls: Float[np.ndarray, "B C"]) -> StepResults:
        before = self.states
        made = self._stepper(before, controls, self._is_new)
        with np.errstate(all="ignore"):  # a diverged row has no finite reward
            paid = self._rules.reward(before, controls, made.states, self.emulator.dt)
            is_over = self._rules.is_over(made.states) | made.is_lost
        rewards = np.nan_to_num(paid - made.penalties, posinf=0.0, neginf=0.0)
        self._is_new = np.zeros(len(before), bool)
        self.states = made.states
        return StepResults(rewards, is_over, made.info, self._rules.is_cut(made.states))

    def observe(self) -> Float[np.ndarray, "B O"]:
        return np.array(self._rules.observe(self.states), np.float32)


def starts_near_rest(
    emulator: Emulator, noise: float, random: Sequence[np.random.Generator]
) -> Float[np.ndarray, "R S"]:
    """Return rest with noise from each of `random`, in the space of changes: quaternions keep length 1.

    `noise` is in standard deviations of the change in one super step. For a deformable body it is added to the latent
    state, which cannot represent rest itself exactly.
    """
    # Noise is drawn around rest itself, not around where it would coast.
    frame = replace(emulator.frame, dt=0.0)
    rest = emulator.rest
    unit = np.asarray(emulator.normaliser.unit, float)
    still = np.zeros((1, len(unit)))
    drawn = [noise * unit * rng.normal(size=unit.shape) for rng in random]
    changes = np.concatenate([still, drawn])
    latent = np.tile(emulator.encode(rest), (len(changes), 1))
    states = emulator.decode(frame.apply(latent, changes))
    return closed_starts(emulator.spec, rest + (states[1:] - states[0]), tied_system(emulator.spec))
