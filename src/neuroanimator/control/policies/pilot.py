"""A body to steer: a policy and its emulator, advanced frame by frame at any rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Protocol, final, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.animation.clip import Clip
from neuroanimator.animation.interpolate import interpolate_hermite
from neuroanimator.control.policies.pilot_motions import (
    CommandedMotion,
    EmulatorPilotMotion,
    PilotCommand,
    PilotMotion,
)
from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.state_policy import StatePolicy, load_any_policy
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.files.zoo import find_policy
from neuroanimator.state.pose import Pose, read_pose
from neuroanimator.systems.system import System

MAX_FRAME = 60.0
"""Maximum duration of a frame [s]: a longer one is a mistake, such as milliseconds for seconds."""

TINY = 1e-9
"""Time that counts as zero [s]: sums of frames round."""

MAX_LEAD = 1.2
"""Maximum lead of the commanded heading over the body's [rad]: excess turning is not saved up for later."""

UNEVEN = 1e-3
"""Maximum relative difference in duration between the frames of a clip."""


class PilotFrame(NamedTuple):
    """The pose of the body at one moment."""

    time: float
    """Time since `Pilot.reset` [s]."""
    state: Float[np.ndarray, " S"]
    """The state in the system's own layout."""
    pose: Pose
    """Pose in the world: `position` (3,) [m], `velocity` (3,) [m/s], `heading` [rad], directions (3,) of its X and Z."""


@runtime_checkable
class Estimator(Protocol):
    """What estimates a body's parameters from its motion, such as `ParameterEstimator`."""

    emulator: Emulator
    """An emulator of the body's family."""

    def observe(
        self,
        state: Float[np.ndarray, " S"],
        control: Float[np.ndarray, " C"],
        following: Float[np.ndarray, " S"],
    ) -> object:
        """Learn from one super step: `state`, the `control` held, and the state that followed."""

    def believed(self, state: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
        """Return `state` with the estimated parameters."""
        ...


@final
class Pilot:
    """A body that follows commands: `reset` it, then `step` it once per picture, at any rate.

    At every super step the policy observes the body and sets its muscles, and the emulator, or the physics if given,
    advances; in between, states are interpolated. Commands take effect with the next super step.
    """

    def __init__(
        self,
        policy: Policy | StatePolicy | str | Path,
        system: System | None = None,
        *,
        estimator: Estimator | None = None,
    ):
        """Make a pilot, at rest, from a policy, its file, or the name of a shipped one, such as `fish`.

        A policy that follows a motion on command moves the physics of `system`, its own body; without one its emulator, which
        `train` makes from the policy's motions. A policy of a family is given the parameters in the state; with an
        `estimator`, those it estimates from the states passed to `step`.

        Raises ArgumentError for a policy that takes no commands, for a needless `system`, and for an estimator of another
        body's parameters.
        """
        if not isinstance(policy, Policy | StatePolicy):
            policy = load_any_policy(find_policy(str(policy)))
        self.policy = policy
        self._motion = _motion_of(self.policy, system)
        self.estimator = estimator
        if estimator is not None:
            _check_estimator(estimator, self.policy, system)
        # Reading attributes of an equinox module takes longer than a super step.
        emulator = self.policy.emulator
        self._structure = emulator.state_structure
        self._rates = emulator.rates
        self._super_step = emulator.dt
        self.reset()

    @classmethod
    def load(cls, path: str | Path, system: System | None = None) -> Pilot:
        """Return the pilot of the policy in the file at `path`, or of the shipped one of that name, such as `fish`."""
        return cls(path, system)

    def __repr__(self) -> str:
        system = self.policy.emulator.system
        return f'Pilot("{system}", up to {self.top_speed:.2g} m/s, at {self._time:.2f} s)'

    @property
    def top_speed(self) -> float:
        """Return the maximum speed of the policy's training [m/s]; higher speeds count as this."""
        return self._motion.top_speed

    @property
    def controls(self) -> Float[np.ndarray, " C"]:
        """Return the controls held since the super step began, for a user's own physics."""
        return self._controls

    def reset(self, state: ArrayLike | None = None, *, phase: float = 0.0) -> PilotFrame:
        """Return the first frame: the body in `state` (S,), or at rest, its clock at `phase` [rad].

        Bodies with different phases are not synchronised. It holds its heading, level, until commanded otherwise.

        Raises ArgumentError for a state of another shape and for numbers that are not finite.
        """
        phase = _finite("phase", phase) % (2 * math.pi)
        start = np.array(self._motion.first(phase) if state is None else state, float)
        self._phase = phase
        self._since_begin = 0.0
        self._place(self._believed(self._checked(start)))
        self._heading = float(self._pose(self._begin).heading)
        self._time = 0.0
        self._controls = np.asarray(self.policy.emulator.bounds.middle, float)
        return PilotFrame(0.0, self._begin, self._pose(self._begin))

    def step(
        self,
        *,
        speed: float,
        turn: float = 0.0,
        climb: float = 0.0,
        dt: float = 1 / 60,
        state: ArrayLike | None = None,
    ) -> PilotFrame:
        """Return the frame `dt` [s] later.

        `speed` [m/s] is the forward speed, `turn` [rad/s] the turning rate to the left, `climb` [rad] the angle of
        climb. Without `turn`, the heading is held. `state` (S,) is the body's actual state now, if something else
        moves it, such as a physics driven by `controls`; the pilot goes on from there. With an estimator,
        states must be one super step, `policy.dt`, apart.

        Raises ArgumentError for numbers that are not finite, unless 0 < `dt` ≤ `MAX_FRAME`, and for states that are not a
        super step apart.
        """
        asked_speed = _finite("speed", speed)
        asked_turn = _finite("turn", turn)
        asked_climb = _finite("climb", climb)
        if not TINY < _finite("dt", dt) <= MAX_FRAME:
            raise ArgumentError(
                f"dt: wanted more than 0 s and at most {MAX_FRAME:g} s, got {dt:g}."
            )
        if state is not None:
            self._go_on_from(self._checked(np.array(state, float)))
        super_step = self._super_step
        left = dt
        while left > TINY:
            if self._since_begin > super_step - TINY:
                assert self._end is not None
                # Exactly a super step, whatever frames it was cut into.
                self._begin_at(self._end, super_step, is_measured=False)
            if self._end is None:
                self._leap(asked_speed, asked_turn, asked_climb)
            ahead = min(left, super_step - self._since_begin)
            self._heading += asked_turn * ahead
            self._since_begin += ahead
            left -= ahead
        self._time += dt
        now = self._interpolated()
        return PilotFrame(self._time, now, self._pose(now))

    def bones(self, frame: PilotFrame) -> tuple[Float[np.ndarray, "B 3"], Float[np.ndarray, "B 4"]]:
        """Return the positions [m] and quaternions wxyz of the body's bones in the world."""
        positions, orientations = self.policy.emulator.skeleton.world_poses(frame.state[None])
        return positions[0], orientations[0]

    def clip(self, frames: Sequence[PilotFrame]) -> Clip:
        """Return two or more evenly spaced frames as a clip, to draw or export.

        Raises ArgumentError for fewer, or unevenly spaced, frames.
        """
        times = np.array([frame.time for frame in frames])
        gaps = np.diff(times)
        if len(times) < 2 or gaps.min() <= 0 or np.ptp(gaps) > UNEVEN * gaps.mean():
            raise ArgumentError(
                f"frames: wanted two or more, evenly spaced in time, got {len(times)}."
            )
        spec = self.policy.emulator.spec
        states = np.stack([frame.state for frame in frames])
        return Clip(spec.system, spec.skeleton, times - times[0], states, spec.definition)

    def _leap(self, speed: float, turn: float, climb: float) -> None:
        """Make the super step that begins now."""
        heading = float(self._pose(self._begin).heading)
        lead = (self._heading - heading + math.pi) % (2 * math.pi) - math.pi
        self._heading = heading + float(np.clip(lead, -MAX_LEAD, MAX_LEAD))
        command = PilotCommand(speed, turn, climb, self._heading, self._phase)
        leap = self._motion.leap(self._begin, command)
        self._end = leap.state
        self._controls = leap.controls

    def _begin_at(
        self, state: Float[np.ndarray, " S"], passed: float, *, is_measured: bool
    ) -> None:
        """Begin a super step in `state`, `passed` [s] after the last one began; the clock has gone on."""
        self._phase = (self._phase + self._motion.clock_rate * passed) % (2 * math.pi)
        self._begin = state
        self._is_begin_measured = is_measured
        self._since_begin = 0.0
        self._end: Float[np.ndarray, " S"] | None = None

    def _place(self, state: Float[np.ndarray, " S"]) -> None:
        """Put the body in `state`, and begin a super step there."""
        self._motion.place(state)
        self._begin_at(state, self._since_begin, is_measured=True)

    def _go_on_from(self, state: Float[np.ndarray, " S"]) -> None:
        """Put the body in its actual state, and let the estimator learn from the way there."""
        if self.estimator is not None and self._end is not None:
            self._check_whole_step()
            self.estimator.observe(self._begin, self._controls, state)
        self._place(self._believed(state))

    def _believed(self, state: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
        """Return the state with the estimated parameters, if there is an estimator."""
        if self.estimator is None:
            return state
        return self.estimator.believed(state)

    def _check_whole_step(self) -> None:
        """Raise ArgumentError unless one super step has passed since a state was measured."""
        passed = self._since_begin
        if not self._is_begin_measured or abs(passed - self._super_step) > TINY:
            raise ArgumentError(
                f"state: an estimator learns from states one super step, {self._super_step:g} s, apart. "
                "Pass one at each, with dt=pilot.policy.dt."
            )

    def _interpolated(self) -> Float[np.ndarray, " S"]:
        """Return the state at this moment of the super step."""
        assert self._end is not None
        dt = self._super_step
        ends = np.stack([self._begin, self._end])
        now = np.array([min(self._since_begin, dt)])
        return interpolate_hermite(ends, dt, now, self._rates, self._structure.orientations)[0]

    def _pose(self, state: Float[np.ndarray, " S"]) -> Pose:
        return read_pose(self._structure, state)

    def _checked(self, state: np.ndarray) -> Float[np.ndarray, " S"]:
        checked = self.policy.emulator.state.check(state, "state")
        if checked.ndim != 1:
            raise ArgumentError(
                f"state: wanted one of {checked.shape[-1]} numbers, got shape {checked.shape}."
            )
        return checked


def _motion_of(policy: Policy | StatePolicy, system: System | None) -> PilotMotion:
    """Return the motion of a policy's body."""
    if isinstance(policy, Policy):
        if system is not None:
            raise ArgumentError("system: this policy moves its emulator. Leave it out.")
        return EmulatorPilotMotion(policy)
    return CommandedMotion(policy, system)


def _check_estimator(
    estimator: Estimator, policy: Policy | StatePolicy, system: System | None
) -> None:
    """Raise ArgumentError unless the estimator fits the policy's body and can be given its states."""
    if system is not None:
        raise ArgumentError(
            "estimator: the pilot moves the physics of a system whose parameters are known. Leave one of the two out."
        )
    if estimator.emulator.state != policy.emulator.state:
        raise ArgumentError(
            f"estimator: wanted one of the policy's body, {policy.emulator.system}, got one of {estimator.emulator.system}."
        )


def _finite(label: str, value: object) -> float:
    if not isinstance(value, int | float | np.number) or not math.isfinite(value):
        raise ArgumentError(f"{label}: wanted a finite number, got {value!r}.")
    return float(value)
