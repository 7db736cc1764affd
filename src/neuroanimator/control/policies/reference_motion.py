"""A motion that a policy follows: the policy's observations of it, and the targets of its servos.

The state holds a clock, a hinge that turns at a constant rate: its angle is the phase of the motion, so policies stay
functions of the state alone. Learning from such motions, from any phase, follows DeepMimic (Peng and others, SIGGRAPH 2018).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from neuroanimator.control.policies.commands import Commands, with_entry
from neuroanimator.files.numbers import entries, listed, number, whole
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.rotation import (
    conjugate,
    facing,
    heading_of,
    multiply,
    rotate,
    rotation_rows,
    upward,
)

MAX_FRAMES = 20_000
"""Maximum number of states of a motion, all laps included."""

MAX_LEAD = 10.0
"""Maximum lead time of a servo [s]."""

TINY = 1e-12
"""Offset that gives the root of a vertical body a direction."""

TURN = 2 * np.pi

POSITION = slice(0, 3)
"""Entries of a free root's position."""

ORIENTATION = slice(3, 7)
"""Entries of its quaternion wxyz."""

HEIGHT = 2

ROOT_NUMBERS = 17
"""Number of observations other than the hinges': of the root, of the motion's root, and of the clock."""

COMMAND_NUMBERS = 2

ACCELERATION = 2.0
"""Maximum rate of change of the commanded speed [m/s²]: a runner cannot stop at once."""

WALKING_LEAD = 0.5
"""Maximum lead of the commanded heading over the body's [rad]: policies learn with less than a task's `lost_tilt`."""


class ReferenceMotion(eqx.Module):
    """States of a body with a free root, one super step apart, by the angle of a clock among them."""

    frames: Float[AnyArray, "K S"]
    """States of all laps, one after another.

    With commands, the strides of laps grow evenly in length up to the motion's own, and then evenly up to those of a faster
    gait; each lap is without its last state, and its root begins at the origin with heading zero.
    """
    lap: int = eqx.field(static=True)
    """Number of super steps in which the clock turns once."""
    phase: int = eqx.field(static=True)
    """Entry of the clock's angle [rad]."""
    velocity: int = eqx.field(static=True)
    """First entry of the root's velocity: three linear ones in the world, three angular ones about its own axes."""
    hinges: tuple[int, ...] = eqx.field(static=True)
    """Entries of the body's angles."""
    rates: tuple[int, ...] = eqx.field(static=True)
    """Entries of their velocities."""
    driven: tuple[int, ...] = eqx.field(static=True)
    """Entry of the angle that each control is a servo of."""
    driven_rates: tuple[int, ...] = eqx.field(static=True)
    """Entry of that angle's velocity."""
    leads: tuple[float, ...] = eqx.field(static=True)
    """Lead time of each servo [s]: its damping over its stiffness, by which it lags behind a target of constant rate."""
    reach: float = eqx.field(static=True)
    """Maximum difference of a control from the motion's angle [rad]."""
    commands: Commands | None = eqx.field(static=True, default=None)
    """Commands of speed and heading; None if the motion follows its own path."""

    @property
    def size(self) -> int:
        """Length of the result of `observe`."""
        size = ROOT_NUMBERS + len(self.hinges)
        if self.commands is not None:
            size += COMMAND_NUMBERS
        return size

    @property
    def dt(self) -> float:
        """Return the time between two frames of a motion on command, at its own speed [s]."""
        assert self.commands is not None
        return TURN / (self.commands.own_rate * self.lap)

    @property
    def shown(self) -> tuple[int, ...]:
        """State entries that are observed unchanged: height, angles, and velocities in the body's own axes."""
        turning = range(self.velocity + 3, self.velocity + 6)
        return (HEIGHT, *self.hinges, *turning, *self.rates)

    def index(self, states: Float[Array, "*B S"]) -> Int[Array, "*B"]:
        """Return the index of the frame at the clock's angle."""
        steps = jnp.round(states[..., self.phase] * (self.lap / TURN))
        if self.commands is not None:
            steps = jnp.mod(steps, self.lap)
        return jnp.clip(steps, 0, len(self.frames) - 1).astype(jnp.int32)

    def frame(self, states: Float[AnyArray, "*B S"], later: int = 0) -> Float[AnyArray, "*B S"]:
        """Return the motion's state at the clock's angle, or some super steps `later`.

        Between frames it is interpolated, by a product of weights and frames, which generated C supports, too.

        NumPy and JAX alike.
        """
        if self.commands is not None:
            return self._commanded(self.commands, states, later)
        xp = states.__array_namespace__()
        last = len(self.frames) - 1
        steps = states[..., self.phase] * (self.lap / TURN) + later
        away = xp.clip(steps, 0, last)[..., None] - xp.arange(len(self.frames), dtype=xp.float32)
        weights = xp.maximum(1 - xp.abs(away), 0)
        return weights @ xp.asarray(self.frames)

    def _commanded(
        self, commands: Commands, states: Float[AnyArray, "*B S"], later: int
    ) -> Float[AnyArray, "*B S"]:
        """Return `frame` at the commanded speed and heading, at the body's position."""
        xp = states.__array_namespace__()
        pace = commands.pace(states)[..., None]
        steps = states[..., self.phase, None] * (self.lap / TURN) + later * pace
        away = steps - xp.arange(self.lap, dtype=xp.float32)
        away = away - self.lap * xp.floor(away / self.lap + 0.5)
        weights = xp.maximum(1 - xp.abs(away), 0)
        laps = len(self.frames) // self.lap
        if laps > 1:
            longest = laps - 1
            if commands.faster is not None:
                longest -= commands.faster.laps
            number = commands.lap_number(states, longest)[..., None]
            strides = xp.maximum(1 - xp.abs(number - xp.arange(laps, dtype=xp.float32)), 0)
            mixed = strides[..., :, None] * weights[..., None, :]
            weights = mixed.reshape(*weights.shape[:-1], -1)
        own = weights @ xp.asarray(self.frames)
        tilted = own[..., ORIENTATION]
        tilted = tilted / xp.sqrt((tilted**2).sum(axis=-1, keepdims=True))
        turning = states[..., commands.turning]
        turned = facing(states[..., commands.heading] + later * self.dt * turning)
        # A rotation about the vertical, in the body's frame.
        spin = turning[..., None] * upward(tilted)
        velocity = self.velocity
        parts = [
            states[..., :HEIGHT],
            own[..., HEIGHT : HEIGHT + 1],
            multiply(turned, tilted),
            own[..., ORIENTATION.stop : velocity],
            pace * rotate(turned, own[..., velocity : velocity + 3]),
            pace * own[..., velocity + 3 : velocity + 6] + spin,
            pace * own[..., velocity + 6 :],
        ]
        beside = np.zeros(states.shape[-1], bool)
        beside[[self.phase, commands.clock_rate, commands.heading, commands.turning]] = True
        return xp.where(beside, states, xp.concat(parts, axis=-1))

    def with_command(
        self, states: Float[AnyArray, "*B S"], command: Float[AnyArray, "*B 2"]
    ) -> Float[AnyArray, "*B S"]:
        """Return the states of bodies after a command, laid out as `COMMAND_LAYOUT`.

        It is given once a super step. Clock and heading turn at the commanded rates, but the speed changes by at most
        `ACCELERATION`, and the commanded heading leads the body's by at most `WALKING_LEAD`: excess turning is not
        saved up for later. Nothing else changes. NumPy and JAX alike.
        """
        assert self.commands is not None
        xp = states.__array_namespace__()
        before = self.commands.speed(states)
        most = ACCELERATION * self.dt
        speed = before + xp.clip(command[..., 0] - before, -most, most)
        told = self.commands.give(states, speed, command[..., 1])
        heading = heading_of(states[..., ORIENTATION])
        lead = states[..., self.commands.heading] - heading
        lead = lead - TURN * xp.floor(lead / TURN + 0.5)
        led = heading + xp.clip(lead, -WALKING_LEAD, WALKING_LEAD)
        return with_entry(told, self.commands.heading, led)

    def begun(self, phase: float) -> Float[np.ndarray, " S"]:
        """Return the state at the motion's own speed, its clock at `phase` [rad]; for a motion that takes commands."""
        assert self.commands is not None
        state = np.zeros(self.frames.shape[-1])
        state[self.phase] = phase
        state[self.commands.clock_rate] = self.commands.own_rate
        return replace(self, frames=np.asarray(self.frames, float)).frame(state)

    def target(self, states: Float[Array, "*B S"]) -> Float[Array, "*B C"]:
        """Return the target of each servo that leads to the motion's next pose: the angle there, plus a lead."""
        following = self.frame(states, 1)
        leads = jnp.asarray(self.leads, jnp.float32)
        ahead = leads * following[..., np.array(self.driven_rates)]
        return following[..., np.array(self.driven)] + ahead

    def observe(self, states: Float[Array, "*B S"]) -> Float[Array, "*B O"]:
        """Return a policy's observations beside `shown`: the root, and the motion's next state in its position and heading."""
        following = self.frame(states, 1)
        orientation = states[..., ORIENTATION]
        velocity = slice(self.velocity, self.velocity + 3)
        apart = following[..., POSITION] - states[..., POSITION]
        relative = multiply(conjugate(orientation), following[..., ORIENTATION])
        # A quaternion and its negative are the same rotation.
        rotation = 2 * jnp.sign(relative[..., :1]) * relative[..., 1:]
        hinges = np.array(self.hinges)
        angle = states[..., self.phase, None]
        parts = [
            upward(orientation),
            _from_heading(orientation, states[..., velocity]),
            _from_heading(orientation, apart),
            rotation,
            _from_heading(orientation, following[..., velocity]),
            following[..., hinges] - states[..., hinges],
            jnp.sin(angle),
            jnp.cos(angle),
        ]
        if self.commands is not None:
            parts += [
                self.commands.pace(states)[..., None],
                states[..., self.commands.turning, None],
            ]
        return jnp.concatenate(parts, axis=-1)

    def to_json(self) -> dict[str, Any]:
        """Return everything but the frames, and their number."""
        described: dict[str, Any] = {
            "frames": len(self.frames),
            "lap": self.lap,
            "phase": self.phase,
            "velocity": self.velocity,
            "hinges": self.hinges,
            "rates": self.rates,
            "driven": self.driven,
            "driven_rates": self.driven_rates,
            "leads": self.leads,
            "reach": self.reach,
        }
        if self.commands is not None:
            described["commands"] = self.commands.to_json()
        return described

    @classmethod
    def blank(cls, values: Any, size: int, controls: int) -> ReferenceMotion:
        """Return the motion that `to_json` described, with zero frames; ValueError if it does not fit the state or controls."""
        count = whole(values["frames"], "reference: frames", 2, MAX_FRAMES)
        commands = None
        if "commands" in values:
            commands = Commands.from_json(values["commands"], size)
        motion = cls(
            frames=jnp.zeros((count, size)),
            lap=whole(values["lap"], "reference: lap", 1, MAX_FRAMES),
            phase=whole(values["phase"], "reference: phase", 0, size - 1),
            velocity=whole(values["velocity"], "reference: velocity", 0, size - 6),
            hinges=entries(values["hinges"], "reference: hinges", size),
            rates=entries(values["rates"], "reference: rates", size),
            driven=entries(values["driven"], "reference: driven", size),
            driven_rates=entries(values["driven_rates"], "reference: driven_rates", size),
            leads=listed(values["leads"], "reference: leads", _checked_lead),
            reach=number(values["reach"], "reference: reach", 0, TURN),
            commands=commands,
        )
        if commands is not None and (count % motion.lap or count < motion.lap):
            raise ValueError(f"reference: wanted {motion.lap} frames of each lap, got {count}")
        faster = None if commands is None else commands.faster
        if faster is not None and count // motion.lap <= faster.laps:
            raise ValueError(f"reference: wanted more than {faster.laps} laps")
        for driven in (motion.driven, motion.driven_rates, motion.leads):
            if len(driven) != controls:
                raise ValueError(f"reference: wanted {controls} angles that controls drive")
        return motion


def _from_heading(
    orientation: Float[Array, "*B 4"], vector: Float[Array, "*B 3"]
) -> Float[Array, "*B 3"]:
    """Return a vector of the world along the axes of an upright body with the same heading."""
    rows = rotation_rows(orientation)
    length = jnp.sqrt(rows[0][0] ** 2 + rows[1][0] ** 2 + TINY)
    cosine = rows[0][0] / length
    sine = rows[1][0] / length
    ahead = cosine * vector[..., 0] + sine * vector[..., 1]
    left = cosine * vector[..., 1] - sine * vector[..., 0]
    return jnp.stack([ahead, left, vector[..., 2]], axis=-1)


def _checked_lead(lead: Any, label: str) -> float:
    return number(lead, label, 0, MAX_LEAD)
