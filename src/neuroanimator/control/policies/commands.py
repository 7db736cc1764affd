"""Commands carried by the state: hinges beside a body, on which nothing acts, turn at commanded rates.

The clock's rate encodes the speed, the heading hinge's rate the turning rate and its angle the heading. So a steered policy stays
a function of the state alone.

    speed = own speed · pace · stride

Below the recorded speed the clock turns slower and strides are shorter, as when people walk; above it the clock turns faster.
With a faster gait, a run, pace and stride grow together up to those of the run; only beyond that the clock alone turns faster:

    pace = c + (1 − c) · speed / own speed          below the own speed
    pace = 1 + (P − 1) s,  stride = 1 + (Q − 1) s   from there to the run, whose pace and stride are P and Q: 0 ≤ s ≤ 1

At a pace of c, the minimum, the stride is zero, and the body stands.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.files.numbers import number, whole
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import Bounds, Layout, Slice

TINY = 1e-6

MAX_RATE = 1e3
"""Maximum speed [m/s] and turning rate [rad/s]."""

STANDING_PACE = 0.7
"""Pace of the clock while the body stands: if slower, a foot would be in the air for too long."""

MAX_STANDING_PACE = 0.99

STANDING_SHARE = 0.3
"""Share of commands to stand among random ones whose range allows it: a uniform draw would never be exactly zero."""

LEAST_FASTER = 1.01
"""Minimum pace and stride of a faster gait."""

MAX_PACE = 100.0
"""Maximum pace and stride of a faster gait."""

MAX_FASTER_LAPS = 100

MAX_ACCELERATION = 1.5
"""Maximum lateral acceleration of a body with a faster gait [m/s²]: the faster it goes, the wider it turns."""

MAX_CHANGE = 1.0
"""Maximum change of the commanded speed between two commands while a policy learns [m/s]."""

SLOW_SHARE = 0.5
"""Share of commands up to the motion's own speed among those during learning whose range allows it: below that speed strides are
of every length, and bodies fell while turning at a tenth of it."""

MIN_RADIUS = 0.6
"""Minimum radius of a turn on shorter strides [m]: a standing body does not turn, since its feet do not leave the floor."""


class Command(NamedTuple):
    """A commanded speed and turning rate."""

    speed: float
    """[m/s]"""
    turning: float = 0.0
    """Rate of the heading, to the left [rad/s]."""


COMMAND_LAYOUT = Layout((Slice("speed", 1, "m/s"), Slice("turning", 1, "rad/s")))
"""Layout of a `Command` as an array."""


class FasterGait(NamedTuple):
    """A gait for higher speeds, such as a run, relative to the slower one."""

    pace: float
    """Number of its laps in the time of one lap of the slower gait."""
    stride: float
    """Length of its lap, in laps of the slower gait."""
    laps: int
    """Number of stored laps with strides longer than the slower gait's."""

    def pace_at(self, share: Float[AnyArray, " *B"]) -> Float[AnyArray, " *B"]:
        """Return the pace at `share` own speeds, at least 1: from the root s of (1 + (P − 1) s)(1 + (Q − 1) s) = share."""
        xp = share.__array_namespace__()
        p, q = self.pace - 1, self.stride - 1
        root = (xp.sqrt((p + q) ** 2 + 4 * p * q * (share - 1)) - p - q) / (2 * p * q)
        return xp.where(root < 1, 1 + p * root, share / self.stride)


class Commands(NamedTuple):
    """Entries of the state that hold commands, and the relation between the clock's rate and the speed."""

    heading: int
    """Entry of the commanded heading [rad]."""
    turning: int
    """Entry of its rate [rad/s]."""
    clock_rate: int
    """Entry of the clock's rate [rad/s]."""
    own_rate: float
    """Rate of the clock in the recorded motion [rad/s]."""
    own_speed: float
    """Mean speed of the recorded motion [m/s]."""
    least: Command
    most: Command
    standing_pace: float = 0.0
    """Pace of the clock at a speed of zero; 0: strides keep their recorded length at all lower speeds."""
    faster: FasterGait | None = None
    """Gait for higher speeds; None: the clock alone turns faster."""

    def pace(self, states: Float[AnyArray, "*B S"]) -> Float[AnyArray, " *B"]:
        """Return the commanded pace, the clock's rate relative to the recording."""
        return states[..., self.clock_rate] / self.own_rate

    def stride(self, states: Float[AnyArray, "*B S"]) -> Float[AnyArray, " *B"]:
        """Return the commanded stride length relative to the recording: 0 while standing, 1 as recorded, above 1 with a run."""
        xp = states.__array_namespace__()
        pace = self.pace(states)
        stride = xp.ones_like(pace)
        if self.standing_pace > 0:
            share = (pace - self.standing_pace) / (1 - self.standing_pace)
            stride = xp.clip(share / xp.maximum(pace, self.standing_pace), 0, 1)
        if self.faster is None:
            return stride
        run = self.faster
        share = xp.clip((pace - 1) / (run.pace - 1), 0, 1)
        return xp.where(pace > 1, 1 + (run.stride - 1) * share, stride)

    def lap_number(self, states: Float[AnyArray, "*B S"], longest: int) -> Float[AnyArray, " *B"]:
        """Return the fractional index of the stored lap for the commanded stride, where `longest` is the lap of stride 1."""
        stride = self.stride(states)
        if self.faster is None:
            return longest * stride
        xp = states.__array_namespace__()
        run = self.faster
        share = (xp.maximum(stride, 1) - 1) / (run.stride - 1)
        return longest * xp.minimum(stride, 1) + run.laps * share

    def speed(self, states: Float[AnyArray, "*B S"]) -> Float[AnyArray, " *B"]:
        """Return the commanded speed [m/s]."""
        return self.own_speed * self.pace(states) * self.stride(states)

    @property
    def bounds(self) -> Bounds:
        """Return the bounds of a command, in the order of `COMMAND_LAYOUT`."""
        return Bounds(tuple(self.least), tuple(self.most))

    def give(
        self,
        states: Float[AnyArray, "*B S"],
        speed: Float[AnyArray, " *B"],
        turning: Float[AnyArray, " *B"],
    ) -> Float[AnyArray, "*B S"]:
        """Return the states with new commands, clipped to the ranges that the policy learns. NumPy and JAX alike."""
        xp = states.__array_namespace__()
        pressed = xp.clip(speed, self.least.speed, self.most.speed)
        share = pressed / self.own_speed
        shortened = self.standing_pace + (1 - self.standing_pace) * share
        pace = xp.where(share < 1, shortened, share)
        turned = xp.clip(turning, self.least.turning, self.most.turning)
        if self.standing_pace > 0:
            fastest = pressed / MIN_RADIUS
            turned = xp.clip(turned, -fastest, fastest)
        if self.faster is not None:
            running = self.faster.pace_at(xp.maximum(share, 1))
            pace = xp.where(share < 1, pace, running)
            fastest = MAX_ACCELERATION / xp.maximum(pressed, TINY)
            turned = xp.clip(turned, -fastest, fastest)
        told = with_entry(states, self.clock_rate, self.own_rate * pace)
        return with_entry(told, self.turning, turned)

    def draw(
        self, rng: np.random.Generator, states: Float[np.ndarray, "B S"]
    ) -> Float[np.ndarray, "B S"]:
        """Return the states with random commands."""
        return self._drawn(rng, states, self.least.speed, self.most.speed)

    def draw_change(
        self, rng: np.random.Generator, states: Float[np.ndarray, "B S"]
    ) -> Float[np.ndarray, "B S"]:
        """Return the states with random commands whose speeds differ from the present ones by at most `MAX_CHANGE`."""
        now = np.clip(self.speed(states), self.least.speed, self.most.speed)
        low = np.maximum(now - MAX_CHANGE, self.least.speed)
        high = np.minimum(now + MAX_CHANGE, self.most.speed)
        is_slow = (rng.random(len(states)) < SLOW_SHARE) & (low < self.own_speed)
        high = np.where(is_slow, np.minimum(high, self.own_speed), high)
        return self._drawn(rng, states, low, high)

    def _drawn(
        self,
        rng: np.random.Generator,
        states: Float[np.ndarray, "B S"],
        low: float | Float[np.ndarray, " B"],
        high: float | Float[np.ndarray, " B"],
    ) -> Float[np.ndarray, "B S"]:
        speed = rng.uniform(low, high, len(states))
        stands = (rng.random(len(states)) < STANDING_SHARE) & (np.asarray(low) == 0)
        speed = np.where(stands, 0.0, speed)
        turning = rng.uniform(self.least.turning, self.most.turning, len(states))
        return self.give(states, speed, turning)

    def to_json(self) -> dict[str, Any]:
        """Return the commands as JSON values."""
        described: dict[str, Any] = {
            "heading": self.heading,
            "turning": self.turning,
            "clock_rate": self.clock_rate,
            "own_rate": self.own_rate,
            "own_speed": self.own_speed,
            "speed": [self.least.speed, self.most.speed],
            "turning_rate": [self.least.turning, self.most.turning],
            "standing_pace": self.standing_pace,
        }
        if self.faster is not None:
            described["faster"] = self.faster._asdict()
        return described

    @classmethod
    def from_json(cls, values: Any, size: int) -> Commands:
        """Return the commands that `to_json` wrote, of states of `size` numbers; ValueError for invalid values."""
        slowest, fastest = values["speed"]
        right, left = values["turning_rate"]
        # Older files lack this value.
        standing_pace = values.get("standing_pace", 0.0)
        return cls(
            heading=whole(values["heading"], "commands: heading", 0, size - 1),
            turning=whole(values["turning"], "commands: turning", 0, size - 1),
            clock_rate=whole(values["clock_rate"], "commands: clock_rate", 0, size - 1),
            own_rate=number(values["own_rate"], "commands: own_rate", 1e-6, MAX_RATE),
            own_speed=number(values["own_speed"], "commands: own_speed", 1e-6, MAX_RATE),
            least=_command(slowest, right),
            most=_command(fastest, left),
            standing_pace=number(standing_pace, "commands: standing_pace", 0, MAX_STANDING_PACE),
            faster=_faster(values["faster"]) if "faster" in values else None,
        )


def with_entry(
    states: Float[AnyArray, "*B S"], entry: int, numbers: Float[AnyArray, " *B"]
) -> Float[AnyArray, "*B S"]:
    """Return the states with `numbers` in one entry. NumPy and JAX alike."""
    xp = states.__array_namespace__()
    is_entry = np.arange(states.shape[-1]) == entry
    return xp.where(is_entry, xp.asarray(numbers)[..., None], states)


def _faster(values: Any) -> FasterGait:
    return FasterGait(
        pace=number(values["pace"], "commands: faster.pace", LEAST_FASTER, MAX_PACE),
        stride=number(values["stride"], "commands: faster.stride", LEAST_FASTER, MAX_PACE),
        laps=whole(values["laps"], "commands: faster.laps", 1, MAX_FASTER_LAPS),
    )


def _command(speed: Any, turning: Any) -> Command:
    return Command(
        number(speed, "commands: speed", 0, MAX_RATE),
        number(turning, "commands: turning_rate", -MAX_RATE, MAX_RATE),
    )
