"""A body to steer: a policy and its emulator, moved on frame by frame at any rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.animation.clip import Clip
from neuroanimator.animation.interpolate import interpolate_hermite
from neuroanimator.control.policies.policy import Policy, load_policy
from neuroanimator.control.policies.steering import SteeringTarget, command
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.state.pose import Pose, read_pose
from neuroanimator.state.rotation import Numbers
from neuroanimator.state.structure import Structure

LEASH = 1.2
"""[rad] The wished heading never leads the body's by more: what it cannot follow is not saved up for later."""
STEEPEST = 1.2
"""[rad] Of a wished climb or dive: straight up there is no heading left to hold."""
MAX_FRAME = 60.0
"""[s] A longer one is a mistake, such as milliseconds for seconds."""


class PilotFrame(NamedTuple):
    """Where the body is at one moment."""

    time: float
    """[s] Since `Pilot.reset`."""
    state: np.ndarray
    """(S,) in the system's own layout."""
    pose: Pose
    """Place (3,) [m], velocity (3,) [m/s] and the directions (3,) of its X and Z, all in the world."""


@final
class Pilot:
    """A body that goes where it is told: `reset` it, then `step` it once per picture, at any rate.

    Every super step the policy looks at the body and sets its muscles, and the emulator leaps; in between,
    states are interpolated. What is asked for takes effect with the next super step.
    """

    def __init__(self, policy: Policy | str | Path):
        """Make it from a policy, its file, or a shipped one's name, such as `fish`; it stands at rest."""
        self.policy = policy if isinstance(policy, Policy) else load_policy(policy)
        self._structure = _structure(self.policy.emulator)
        self.reset()

    @property
    def top_speed(self) -> float:
        """Return the highest speed the policy was trained on [m/s]; more counts as this."""
        return self.policy.ranges.high[0]

    @property
    def controls(self) -> np.ndarray:
        """Return the controls (C,) held since the super step began: for a physics of one's own."""
        return self._controls

    def reset(self, state: ArrayLike | None = None, *, phase: float = 0.0) -> PilotFrame:
        """Return the first frame: the body in `state` (S,), or at rest, its clock at `phase` [rad].

        Bodies with other phases do not beat in time. It holds the heading it has, level, until told otherwise.

        Raises ArgumentError for a state of another shape and for numbers that are not finite.
        """
        emulator = self.policy.emulator
        start = np.array(emulator.spec.rest if state is None else state, float)
        self._begin = self._checked(start)
        self._inner: Numbers = np.asarray(emulator.encode(self._begin), np.float32)
        self._phase = _finite("phase", phase) % (2 * math.pi)
        self._time = 0.0
        self._since = 0.0
        self._end: np.ndarray | None = None
        self._controls = np.asarray(emulator.spec.bounds.middle, float)
        pose = self._pose(self._begin)
        self._heading = _heading(pose)
        return PilotFrame(0.0, self._begin, pose)

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

        `speed` [m/s] is how fast to go ahead, `turn` [rad/s] how fast to turn left, `climb` [rad] how steeply to go
        up. Without `turn`, the heading is held. `state` (S,) says where the body really is now, if something else
        moves it, such as a physics that is given `controls`; the pilot goes on from there.

        Raises ArgumentError for numbers that are not finite, and unless 0 < `dt` ≤ `MAX_FRAME`.
        """
        wanted_speed = _finite("speed", speed)
        turning = _finite("turn", turn)
        steepness = _finite("climb", climb)
        if not TINY < _finite("dt", dt) <= MAX_FRAME:
            raise ArgumentError(
                f"dt: wanted more than 0 s and at most {MAX_FRAME:g} s, came {dt:g}."
            )
        if state is not None:
            self._go_on_from(self._checked(np.array(state, float)))
        length = self.policy.dt
        left = dt
        while left > TINY:
            if self._since > length - TINY:
                self._finish()
            if self._end is None:
                self._leap(wanted_speed, steepness)
            ahead = min(left, length - self._since)
            self._heading += turning * ahead
            self._since += ahead
            left -= ahead
        self._time += dt
        now = self._between()
        return PilotFrame(self._time, now, self._pose(now))

    def bones(self, frame: PilotFrame) -> tuple[np.ndarray, np.ndarray]:
        """Return the places (B, 3) [m] and quaternions wxyz (B, 4) of the body's bones in the world."""
        positions, orientations = self.policy.emulator.spec.skeleton.world_poses(frame.state[None])
        return positions[0], orientations[0]

    def clip(self, frames: Sequence[PilotFrame]) -> Clip:
        """Return two or more evenly spaced frames as a clip, to draw or export.

        Raises ArgumentError for fewer, and where frames are not evenly spaced.
        """
        times = np.array([frame.time for frame in frames])
        gaps = np.diff(times)
        if len(times) < 2 or gaps.min() <= 0 or np.ptp(gaps) > UNEVEN * gaps.mean():
            raise ArgumentError(
                f"frames: wanted two or more, evenly spaced in time, came {len(times)}."
            )
        spec = self.policy.emulator.spec
        states = np.stack([frame.state for frame in frames])
        return Clip(spec.system, spec.skeleton, times - times[0], states, spec.definition)

    def _leap(self, speed: float, climb: float) -> None:
        """Set the muscles for the wished course, and make the super step under them."""
        heading = _heading(self._pose(self._begin))
        lead = (self._heading - heading + math.pi) % (2 * math.pi) - math.pi
        self._heading = heading + float(np.clip(lead, -LEASH, LEASH))
        steepness = float(np.clip(climb, -STEEPEST, STEEPEST))
        level = math.cos(steepness)
        direction = [
            level * math.cos(self._heading),
            level * math.sin(self._heading),
            math.sin(steepness),
        ]
        course = SteeringTarget(
            np.array(direction, np.float32), np.array(max(speed, 0.0), np.float32)
        )
        phase = np.array(self._phase, np.float32)
        self._following, end, controls = _leap(self.policy, self._inner, phase, course)
        self._end = np.asarray(end, float)
        self._controls = np.asarray(controls, float)

    def _finish(self) -> None:
        """Begin the next super step where this one ends."""
        assert self._end is not None
        self._begin = self._end
        self._inner = self._following
        self._phase = (self._phase + self.policy.tick) % (2 * math.pi)
        self._since = 0.0
        self._end = None

    def _go_on_from(self, state: np.ndarray) -> None:
        """Put the body where it really is; its clock goes on."""
        self._phase = (self._phase + self.policy.tick * self._since / self.policy.dt) % (
            2 * math.pi
        )
        self._begin = state
        self._inner = np.asarray(self.policy.emulator.encode(state), np.float32)
        self._since = 0.0
        self._end = None

    def _between(self) -> np.ndarray:
        """Return the state (S,) at this moment of the super step."""
        assert self._end is not None
        emulator = self.policy.emulator
        orientations = (
            emulator.frame.orientations if emulator.modes is None else ()
        )  # mass points have no quaternions to keep
        ends = np.stack([self._begin, self._end])
        now = np.array([min(self._since, emulator.dt)])
        return interpolate_hermite(ends, emulator.dt, now, emulator.spec.rates, orientations)[0]

    def _pose(self, state: np.ndarray) -> Pose:
        return read_pose(self._structure, state)

    def _checked(self, state: np.ndarray) -> np.ndarray:
        checked = self.policy.emulator.spec.state.check(state, "state")
        if checked.ndim != 1:
            raise ArgumentError(
                f"state: wanted one of {checked.shape[-1]} numbers, came shape {checked.shape}."
            )
        return checked


TINY = 1e-9
"""[s] Less than this is nothing: sums of frames round."""
UNEVEN = 1e-3
"""Share of a frame by which frames may differ in length."""


@eqx.filter_jit
def _leap(
    policy: Policy, latent: Numbers, phase: Numbers, course: SteeringTarget
) -> tuple[Float[Array, " I"], Float[Array, " S"], Float[Array, " C"]]:
    """Return where `latent` (I,) is a super step later, as few numbers and as a state, and the controls held."""
    emulator = policy.emulator
    controls = policy.control(latent, phase, command(course, policy.pose(latent)))
    following = emulator.advance(latent, emulator.encode_control(controls))
    return following, emulator.decode(following), controls


def _structure(emulator: Emulator) -> Structure:
    """Return the structure of the emulator's states, as far as a pose needs it."""
    if emulator.modes is None:
        return Structure((), (), (), segments=emulator.frame.segments)
    return Structure((), (), (), cloud=emulator.modes.cloud)


def _heading(pose: Pose) -> float:
    return math.atan2(pose.forward[1], pose.forward[0])


def _finite(label: str, value: float) -> float:
    if not isinstance(value, int | float | np.number) or not math.isfinite(value):
        raise ArgumentError(f"{label}: wanted a finite number, came {value!r}.")
    return float(value)
