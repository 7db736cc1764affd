"""Motions of a pilot's body, super step by super step: by a policy's emulator, or by the physics."""

from __future__ import annotations

import abc
import math
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.reference_motion import ReferenceMotion
from neuroanimator.control.policies.state_policy import StatePolicy, controls_of
from neuroanimator.control.policies.steering import SteeringTarget
from neuroanimator.control.policies.super_step import make_super_step
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.super_step import locate
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.plants import EmulatorPlant, PhysicsPlant, Plant
from neuroanimator.systems.system import System

MAX_CLIMB = 1.2
"""Maximum angle of climb or dive [rad]: a vertical body has no heading to hold."""


class PilotCommand(NamedTuple):
    """What a body is to do in a super step."""

    speed: float
    """Forward speed [m/s]."""
    turn: float
    """Turning rate to the left [rad/s]."""
    climb: float
    """Angle of climb [rad]."""
    heading: float
    """Heading at its beginning, by all turns so far [rad]."""
    phase: float
    """Phase of the body's clock at its beginning [rad]."""


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
    clock_rate: float
    """Rate at which the phase of the body's clock advances [rad/s]."""

    @abc.abstractmethod
    def first(self, phase: float) -> Float[np.ndarray, " S"]:
        """Return the default initial state, the clock at `phase` [rad]."""

    @abc.abstractmethod
    def place(self, state: Float[np.ndarray, " S"]) -> None:
        """Put the body in `state`, from which the next super step begins."""

    @abc.abstractmethod
    def leap(self, state: Float[np.ndarray, " S"], command: PilotCommand) -> PilotLeap:
        """Return the super step from `state`, in which the body was placed or the last super step ended."""


@final
class EmulatorPilotMotion(PilotMotion):
    """The motion of a policy's emulator."""

    def __init__(self, policy: Policy):
        self.policy = policy
        self.top_speed = policy.ranges.high[0]
        self.clock_rate = policy.tick / policy.dt
        # Reading attributes of an equinox module takes longer than a super step.
        self._axes = policy.emulator.origin

    def first(self, phase: float) -> Float[np.ndarray, " S"]:
        return np.array(self.policy.emulator.rest, float)

    def place(self, state: Float[np.ndarray, " S"]) -> None:
        self._body = locate(self.policy.emulator, state[None])

    def leap(self, state: Float[np.ndarray, " S"], command: PilotCommand) -> PilotLeap:
        steepness = float(np.clip(command.climb, -MAX_CLIMB, MAX_CLIMB))
        level = math.cos(steepness)
        direction = [
            level * math.cos(command.heading),
            level * math.sin(command.heading),
            math.sin(steepness),
        ]
        target = SteeringTarget(np.array([direction]), np.array([max(command.speed, 0.0)]))
        phase = np.array([command.phase])
        made = make_super_step(self.policy, self._body.latent, phase, target)
        self._body, states = self._body.moved_on(self._axes, made.latent, made.states)
        # Single precision may round beyond a bound.
        controls = self.policy.emulator.bounds.clip(np.asarray(made.controls[0], float))
        return PilotLeap(states[0], controls)


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
        self._plant: Plant = EmulatorPlant(emulator)
        if system is not None:
            self._plant = PhysicsPlant(system, policy.dt, system.scheme)
        self.reference: ReferenceMotion = reference
        self.top_speed = reference.commands.most.speed
        self.clock_rate = 0.0  # the clock is in its state

    def first(self, phase: float) -> Float[np.ndarray, " S"]:
        return self.reference.begun(phase)

    def place(self, state: Float[np.ndarray, " S"]) -> None:
        pass

    def leap(self, state: Float[np.ndarray, " S"], command: PilotCommand) -> PilotLeap:
        if command.climb != 0:
            raise ArgumentError(
                f"climb: this body walks on the ground, got {command.climb:g}. Use 0."
            )
        told = self.reference.with_command(state, np.array([command.speed, command.turn]))
        controls = np.asarray(controls_of(self.policy, as_jax(told)), float)
        controls = self.policy.emulator.bounds.clip(controls)
        return PilotLeap(self._plant(told, controls), controls)
