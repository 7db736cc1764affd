"""Motions of a pilot's body, super step by super step: by a policy's emulator, or by the physics."""

from __future__ import annotations

import abc
import math
from typing import NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.reference_motion import ReferenceMotion
from neuroanimator.control.policies.state_policy import StatePolicy
from neuroanimator.control.policies.steering import SteeringTarget
from neuroanimator.control.policies.super_step import make_super_step
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.super_step import locate
from neuroanimator.errors import ArgumentError, DivergedError
from neuroanimator.state.pose import read_pose
from neuroanimator.systems.system import System

MAX_LEAD = 1.2
"""Maximum lead of the commanded heading over the body's [rad]: excess turning is not saved up for later."""

MAX_CLIMB = 1.2
"""Maximum angle of climb or dive [rad]: a vertical body has no heading to hold."""


class PilotLeap(NamedTuple):
    """A super step."""

    state: Float[np.ndarray, " S"]
    """State it ends in."""
    controls: Float[np.ndarray, " C"]
    """Controls held on the way."""


class PilotMotion(abc.ABC):
    """A motion of a body."""

    top_speed: float
    """Maximum speed that can be commanded [m/s]."""

    @abc.abstractmethod
    def first(self, phase: float) -> Float[np.ndarray, " S"]:
        """Return the default initial state, the clock at `phase` [rad]."""

    @abc.abstractmethod
    def begin(self, state: Float[np.ndarray, " S"], phase: float) -> None:
        """Begin in `state` at `phase` [rad]; the heading is held until commanded otherwise."""

    @abc.abstractmethod
    def go_on_from(self, state: Float[np.ndarray, " S"], passed: float) -> None:
        """Put the body in `state`, `passed` [s] after its super step began."""

    @abc.abstractmethod
    def turn(self, angle: float) -> None:
        """Turn the commanded heading to the left by `angle` [rad]."""

    @abc.abstractmethod
    def leap(
        self, state: Float[np.ndarray, " S"], speed: float, turn: float, climb: float
    ) -> PilotLeap:
        """Return the super step from `state` at the commanded speed [m/s], turning rate [rad/s] and climb [rad]."""

    @abc.abstractmethod
    def finish(self) -> None:
        """End the super step that `leap` made."""


@final
class EmulatorPilotMotion(PilotMotion):
    """The motion of a policy's emulator."""

    def __init__(self, policy: Policy):
        self.policy = policy
        self.top_speed = policy.ranges.high[0]
        # Reading attributes of an equinox module takes longer than a super step.
        self._structure = policy.emulator.state_structure
        self._axes = policy.emulator.origin
        self._super_step = policy.emulator.dt
        self._tick = policy.tick

    def first(self, phase: float) -> Float[np.ndarray, " S"]:
        return np.array(self.policy.emulator.rest, float)

    def begin(self, state: Float[np.ndarray, " S"], phase: float) -> None:
        self._body = locate(self.policy.emulator, state[None])
        self._phase = phase
        self._heading = self._heading_of(state)

    def go_on_from(self, state: Float[np.ndarray, " S"], passed: float) -> None:
        self._phase = (self._phase + self._tick * passed / self._super_step) % (2 * math.pi)
        self._body = locate(self.policy.emulator, state[None])

    def turn(self, angle: float) -> None:
        self._heading += angle

    def leap(
        self, state: Float[np.ndarray, " S"], speed: float, turn: float, climb: float
    ) -> PilotLeap:
        heading = self._heading_of(state)
        self._heading = heading + _pressed(self._heading - heading, MAX_LEAD)
        steepness = float(np.clip(climb, -MAX_CLIMB, MAX_CLIMB))
        level = math.cos(steepness)
        direction = [
            level * math.cos(self._heading),
            level * math.sin(self._heading),
            math.sin(steepness),
        ]
        target = SteeringTarget(np.array([direction]), np.array([max(speed, 0.0)]))
        phase = np.array([self._phase])
        made = make_super_step(self.policy, self._body.latent, phase, target)
        self._next_body, states = self._body.moved_on(self._axes, made.latent, made.states)
        # Single precision may round beyond a bound.
        controls = self.policy.emulator.bounds.clip(np.asarray(made.controls[0], float))
        return PilotLeap(states[0], controls)

    def finish(self) -> None:
        self._body = self._next_body
        self._phase = (self._phase + self._tick) % (2 * math.pi)

    def _heading_of(self, state: Float[np.ndarray, " S"]) -> float:
        return float(read_pose(self._structure, state).heading)


@final
class CommandedMotion(PilotMotion):
    """The motion of a policy that follows a motion on command: clock and heading are in its state."""

    def __init__(self, policy: StatePolicy, system: System | None):
        """Make the motion by the physics of `system`, or by the policy's emulator without one.

        Raises ArgumentError for a policy that takes no commands, and for the physics of another body.
        """
        reference = policy.view.reference
        if reference is None or reference.commands is None:
            raise ArgumentError(
                "policy: it takes no commands. Learn one whose TOML file has [follow.commands]."
            )
        emulator = policy.emulator
        if system and not system.fits(emulator.spec):
            raise ArgumentError(
                f"system: wanted the body of the policy, {emulator.system}, got {system.name}."
            )
        self.policy = policy
        self.system = system
        self.reference: ReferenceMotion = reference
        self.top_speed = reference.commands.most.speed
        self._super_step = policy.dt

    def first(self, phase: float) -> Float[np.ndarray, " S"]:
        return self.reference.begun(phase)

    def begin(self, state: Float[np.ndarray, " S"], phase: float) -> None:
        pass

    def go_on_from(self, state: Float[np.ndarray, " S"], passed: float) -> None:
        pass

    def turn(self, angle: float) -> None:
        pass

    def leap(
        self, state: Float[np.ndarray, " S"], speed: float, turn: float, climb: float
    ) -> PilotLeap:
        if climb != 0:
            raise ArgumentError(f"climb: this body walks on the ground, got {climb:g}. Use 0.")
        told = self.reference.with_command(state, np.array([speed, turn]))
        controls = np.asarray(_control(self.policy, as_jax(told)), float)
        controls = self.policy.emulator.bounds.clip(controls)
        if self.system is None:
            return PilotLeap(np.asarray(self.policy.emulator.step(told, controls), float), controls)
        return PilotLeap(self._simulated(self.system, told, controls), controls)

    def _simulated(
        self, system: System, state: Float[np.ndarray, " S"], controls: Float[np.ndarray, " C"]
    ) -> Float[np.ndarray, " S"]:
        """Return the state a super step later; DivergedError if the physics diverged."""
        runs = system.simulate_fastest(
            state[None], controls[None, None], self._super_step, system.scheme
        )
        if runs.has_diverged[0]:
            raise DivergedError("The physics diverged. Reset the pilot.")
        return runs.states[0, 1]

    def finish(self) -> None:
        pass


@eqx.filter_jit
def _control(policy: StatePolicy, state: Float[Array, " S"]) -> Float[Array, " C"]:
    return policy.control_of(state)


def _pressed(angle: float, largest: float) -> float:
    """Return an angle wrapped to −π..π and clipped to ± `largest`."""
    angle = (angle + math.pi) % (2 * math.pi) - math.pi
    return float(np.clip(angle, -largest, largest))
