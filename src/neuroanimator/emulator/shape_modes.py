"""Shape modes: a deformable body as a rigid frame plus amounts of the shapes seen in training.

Hundreds of mass points move as one body that bends in a few ways. An emulator of those few numbers is
smaller, faster and cannot tear the body apart: every prediction is a combination of shapes seen in training.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from neuroanimator.emulator.arrays import zeros
from neuroanimator.emulator.domain import Domain
from neuroanimator.emulator.encoding import Encoding, odd_local
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.origin import NOWHERE
from neuroanimator.files.numbers import listed, number, whole
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import MAX_NUMBERS, Layout, Slice
from neuroanimator.state.reference_shape import Cloud, flat_of, points_of
from neuroanimator.state.rotation import cross, to_body_axes, to_world_axes
from neuroanimator.state.segments import (
    MAX_RESPONSE,
    Constant,
    Lag,
    Plain,
    Position,
    Quaternion,
    Segment,
    Velocity,
)
from neuroanimator.state.structure import REVERSED_ABOUT, REVERSED_ALONG, Mirror, Structure

TINY = 1e-12
"""Offset added to squares before dividing by their root, so that bodies at rest are not divided by zero."""

RECORDED_ROWS = 4096
"""Number of windows of a dataset that are encoded at a time."""

LIMITS = Layout(
    (
        Slice("position_modes", 1, "1"),
        Slice("velocity_modes", 1, "1"),
        Slice("speed", 1, "m/s"),
        Slice("angular_speed", 1, "rad/s"),
    )
)
"""Entries of `ShapeModes.limits`; modes in standard deviations, root mean square."""


class ShapeModes(Encoding):
    """Positions and velocities of N mass points ↔ (frame, odd modes, even modes, odd and even activations, parameters).

    Odd numbers change sign in the body's mirror, even ones do not; without a mirror all are odd. Positions
    and velocities have separate modes, as deformation and motion differ. The mean shape of a family grows with
    its parameters, so that modes are deformations of any of its bodies.
    """

    keeps_entries = False

    positions: Float[AnyArray, "D Q"]
    """Orthonormal position modes: deviations of the shape (D = 3 N) from the mean one [m]."""
    velocities: Float[AnyArray, "D P"]
    """Orthonormal velocity modes: motions of mass points relative to the frame [m/s]."""
    mean_position: Float[AnyArray, " D"]
    mean_velocity: Float[AnyArray, " D"]
    spread: Float[AnyArray, " K"]
    """Standard deviation of all K = Q + P modes in training, in their order within the latent state."""
    limits: Float[AnyArray, " 4"]
    """Limits that training hardly exceeded, as listed in `LIMITS`."""
    cloud: Cloud = eqx.field(static=True)
    """The mass points at rest."""
    mirror: Mirror | None = eqx.field(static=True)
    """Left and right of the body; None without a mirror symmetry."""
    odd_positions: int = eqx.field(static=True)
    """Number of odd position modes, which come first."""
    odd_velocities: int = eqx.field(static=True)
    """Number of odd velocity modes, which come first."""
    muscles: int = eqx.field(static=True)
    """Number of activations in the state."""
    time_constant: float = eqx.field(static=True)
    """Time constant of the muscles [s]."""

    @property
    def count(self) -> int:
        """Number of modes, of positions and velocities together."""
        return self.positions.shape[1] + self.velocities.shape[1]

    @property
    def layout(self) -> Layout:
        return _latent_layout(self.count, self.muscles, self.cloud.parameters)

    @property
    def change_layout(self) -> Layout:
        """Named parts of a change of the latent state (V,), for `Frame.apply`."""
        position, _, *velocities, modes = self.layout.slices[:5]
        return Layout((position, Slice("frame.orientation", 3, "rad"), *velocities, modes))

    @property
    def feature_layout(self) -> Layout:
        """Named parts of the raw features that are unchanged latent entries; others follow."""
        return Layout(self.layout.slices[3:])

    @property
    def is_mirrored(self) -> bool:
        return self.mirror is not None

    @property
    def control_partners(self) -> tuple[int, ...]:
        return () if self.mirror is None else self.mirror.controls

    @property
    def max_speed(self) -> float:
        return float(self.limits[LIMITS.index("speed").start])

    @property
    def max_angular_speed(self) -> float:
        return float(self.limits[LIMITS.index("angular_speed").start])

    def encode(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B I"]:
        xp = state.__array_namespace__()
        body = view_in_frame(self.cloud, state)
        parameters = state[..., state.shape[-1] - self.cloud.parameters :]
        q = (body.shape - self._mean_shape(parameters)) @ _like(self.positions, state)
        p = (body.flow - _like(self.mean_velocity, state)) @ _like(self.velocities, state)
        modes = [
            q[..., : self.odd_positions],
            p[..., : self.odd_velocities],
            q[..., self.odd_positions :],
            p[..., self.odd_velocities :],
        ]
        first = 2 * body.shape.shape[-1]
        activations = self.encode_control(state[..., first : first + self.muscles])
        frame = [body.centre, body.orientation, body.velocity, body.angular_velocity]
        return xp.concat([*frame, *modes, activations, parameters], axis=-1)

    def decode(self, latent: Float[AnyArray, "*B I"]) -> Float[AnyArray, "*B S"]:
        """Return the states (..., S) closest to `latent` (..., I)."""
        xp = latent.__array_namespace__()
        layout = self.layout
        centre = layout.part(latent, "frame.position")
        orientation = layout.part(latent, "frame.orientation")
        velocity = layout.part(latent, "frame.velocity")
        angular_velocity = layout.part(latent, "frame.angular_velocity")
        q, p = self._amounts(layout.part(latent, "modes"))
        parameters = layout.part(latent, "parameters")
        mean = self._mean_shape(parameters)
        shape = points_of(mean + q @ _like(self.positions, latent).mT)
        flow = points_of(_like(self.mean_velocity, latent) + p @ _like(self.velocities, latent).mT)
        flow = flow + cross(angular_velocity[..., None, :], shape)
        positions = centre[..., None, :] + to_world_axes(orientation, shape)
        velocities = velocity[..., None, :] + to_world_axes(orientation, flow)
        activations = self.decode_control(layout.part(latent, "activations"))
        moving = [flat_of(positions), flat_of(velocities)]
        return xp.concat([*moving, activations, parameters], axis=-1)

    def state_axes(self, latent_axes: tuple[int, ...]) -> tuple[int, ...]:
        # Mass points move with the frame, whose position comes first.
        points = latent_axes[:3] * self.cloud.count
        others = 3 * self.cloud.count + self.muscles + self.cloud.parameters
        return (*points, *[NOWHERE] * others)

    def _mean_shape(self, parameters: Float[AnyArray, "*B Q"]) -> Float[AnyArray, "*#B D"]:
        """Return the mean shape of the bodies with these parameters."""
        mean = _like(self.mean_position, parameters)
        if not self.cloud.parameters:
            return mean
        return mean + self.cloud.growth(parameters)

    def _amounts(
        self, modes: Float[AnyArray, "*B K"]
    ) -> tuple[Float[AnyArray, "*B Q"], Float[AnyArray, "*B P"]]:
        """Return (amounts of the position modes, amounts of the velocity modes), odd ones first."""
        is_position = self.is_position_mode()
        return modes[..., np.flatnonzero(is_position)], modes[..., np.flatnonzero(~is_position)]

    def encode_recorded(self, states: Float[np.ndarray, "*B S"]) -> Float[np.ndarray, "*B I"]:
        # Block by block: in double precision a dataset would take many times its memory.
        latent = np.empty((*states.shape[:-1], self.layout.size), np.float32)
        for first in range(0, len(states), RECORDED_ROWS):
            rows = slice(first, first + RECORDED_ROWS)
            latent[rows] = self.encode(np.asarray(states[rows], float))
        return latent

    def bounded(
        self, latent: Float[Array, " I"], features: Features, domain: Domain
    ) -> Float[Array, " I"]:
        """Return `latent` (I,) with shape, flow, speed and spin scaled down to the limits of training, if beyond them.

        This keeps a body in shape for ever: see `docs/decisions/0008-bodies-in-few-numbers.md`. The range of
        single features does not matter here.
        """
        layout = self.layout
        velocity = layout.part(latent, "frame.velocity")
        angular_velocity = layout.part(latent, "frame.angular_velocity")
        modes = layout.part(latent, "modes")
        squares = self.squares_of_limited(velocity, angular_velocity, modes / self.spread)
        shrink_positions, shrink_velocities, shrink_speed, shrink_angular_speed = (
            jnp.minimum(1.0, self.limits[i] / jnp.sqrt(square + TINY))
            for i, square in enumerate(squares)
        )
        shrink_modes = jnp.where(self.is_position_mode(), shrink_positions, shrink_velocities)
        parts = [
            layout.part(latent, "frame.position"),
            layout.part(latent, "frame.orientation"),
            velocity * shrink_speed,
            angular_velocity * shrink_angular_speed,
            modes * shrink_modes,
            layout.part(latent, "activations"),
            layout.part(latent, "parameters"),
        ]
        return jnp.concatenate(parts)

    def squares_of_limited(
        self,
        velocity: Float[AnyArray, "*B 3"],
        angular_velocity: Float[AnyArray, "*B 3"],
        modes: Float[AnyArray, "*B K"],
    ) -> tuple[Float[AnyArray, "*B"], ...]:
        """Return the squares (...) of the entries of `LIMITS`, in order; `modes` in standard deviations."""
        xp = modes.__array_namespace__()
        positions, velocities = self._amounts(modes)
        return (
            xp.mean(positions**2, axis=-1),
            xp.mean(velocities**2, axis=-1),
            xp.sum(velocity**2, axis=-1),
            xp.sum(angular_velocity**2, axis=-1),
        )

    def is_position_mode(self) -> Bool[np.ndarray, " K"]:
        """Return a mask of the position modes, in the order of the latent state."""
        odd = (self.odd_positions, self.odd_velocities)
        every = (self.positions.shape[1], self.velocities.shape[1])
        return np.repeat([True, False, True, False], [*odd, *np.subtract(every, odd)])

    def structure(self, body: Structure) -> Structure:
        """Return the structure of the latent state that an emulator may exploit, given that of the body's state."""
        layout = self.layout
        velocity = layout.index("frame.velocity").start
        angular_velocity = layout.index("frame.angular_velocity").start
        segments: list[Segment] = [
            Position(rate=velocity),
            Quaternion(rate=angular_velocity),
            Velocity(),
            Plain(size=3 + self.count),
        ]
        if self.muscles:
            segments.append(Lag(size=self.muscles, time_constant=self.time_constant))
        if self.cloud.parameters:
            segments.append(Constant(size=self.cloud.parameters))
        return Structure(
            angles=(),
            rates=(),
            plain=tuple(range(angular_velocity, layout.size)),
            segments=tuple(segments),
            probes=body.probes,
            has_gravity=body.has_gravity,
            is_immersed=body.is_immersed,
            external_forces=body.external_forces,
        )

    def state_structure(self, latent_segments: tuple[Segment, ...]) -> Structure:
        return Structure((), (), (), cloud=self.cloud)

    def odd_changes(self, body: Structure) -> tuple[bool, ...]:
        """Return (V,) whether the mirror reverses each number of a change, as in `change_layout`."""
        frame = (*REVERSED_ALONG, *REVERSED_ABOUT, *REVERSED_ALONG, *REVERSED_ABOUT)
        return (*frame, *self._odd_modes())

    def odd_features(self, body: Structure) -> tuple[bool, ...]:
        """Return (K,) whether the mirror reverses each raw feature.

        Features are those of `feature_layout`, then the direction of gravity, the velocity, the probes'
        features, and the controls.
        """
        controls = self.odd_muscles()
        activations = controls if self.muscles else ()
        parameters = (False,) * self.cloud.parameters
        own = (*REVERSED_ABOUT, *self._odd_modes(), *activations, *parameters)
        return (*own, *odd_local(body), *controls)

    def _odd_modes(self) -> tuple[bool, ...]:
        odd = self.odd_positions + self.odd_velocities
        return tuple(i < odd for i in range(self.count))

    def check(self) -> None:
        if (np.asarray(self.spread) <= 0).any():
            raise ValueError("normaliser or modes: wanted scales above 0")

    def to_json(self) -> dict[str, Any]:
        mirror = None
        if self.mirror is not None:
            mirror = self.mirror.to_json()
        return {
            "cloud": self.cloud.to_json(),
            "mirror": mirror,
            "counts": [
                self.positions.shape[1],
                self.velocities.shape[1],
                self.odd_positions,
                self.odd_velocities,
            ],
            "muscles": self.muscles,
            "time_constant": self.time_constant,
        }

    @classmethod
    def from_json(cls, described: dict[str, Any], states: int, controls: int) -> ShapeModes:
        """Return the modes that `to_json` wrote, with zero arrays; ValueError unless they fit `states` and `controls`."""
        cloud = Cloud.from_json(described["cloud"], "modes")
        q, p, odd_q, odd_p = listed(described["counts"], "modes", _count, 4)
        size = 3 * cloud.count
        muscles = whole(described["muscles"], "modes: muscles", 0, controls)
        fits = states == 2 * size + muscles + cloud.parameters and muscles in (0, controls)
        if not fits or not 0 <= odd_q <= q <= size or not 0 <= odd_p <= p <= size:
            raise ValueError("modes: other sizes than the state")
        mirror = None
        if described["mirror"] is not None:
            mirror = Mirror.from_json(described["mirror"], cloud.count, controls, "modes")
        return cls(
            positions=zeros(size, q),
            velocities=zeros(size, p),
            mean_position=zeros(size),
            mean_velocity=zeros(size),
            spread=zeros(q + p),
            limits=zeros(LIMITS.size),
            cloud=cloud,
            mirror=mirror,
            odd_positions=odd_q,
            odd_velocities=odd_p,
            muscles=muscles,
            time_constant=number(described["time_constant"], "modes: response", 0, MAX_RESPONSE),
        )


def _count(value: Any, what: str) -> int:
    return whole(value, what, 0, MAX_NUMBERS)


@cache
def _latent_layout(modes: int, muscles: int, parameters: int) -> Layout:
    return Layout(
        (
            Slice("frame.position", 3, "m"),
            Slice("frame.orientation", 4, "quaternion"),
            Slice("frame.velocity", 3, "m/s"),
            Slice("frame.angular_velocity", 3, "rad/s"),
            Slice("modes", modes, "1"),
            Slice("activations", muscles, "1"),
            Slice("parameters", parameters, "1"),
        )
    )


def _like(numbers: Any, state: AnyArray) -> AnyArray:
    """Return `numbers` as an array of the library and the type of `state`."""
    return state.__array_namespace__().asarray(numbers, dtype=state.dtype)


class BodyInFrame(NamedTuple):
    """A body's rigid frame, and its mass points relative to it."""

    centre: Float[AnyArray, "*B 3"]
    """Position of the centroid [m]."""
    orientation: Float[AnyArray, "*B 4"]
    velocity: Float[AnyArray, "*B 3"]
    """Velocity of the centroid in the world [m/s]."""
    angular_velocity: Float[AnyArray, "*B 3"]
    """Angular velocity, along the body's axes [rad/s]."""
    shape: Float[AnyArray, "*B D"]
    """Positions of mass points from the centroid, along the body's axes [m]; D = 3 N."""
    flow: Float[AnyArray, "*B D"]
    """Velocities of mass points relative to the frame, along the body's axes [m/s]."""


def view_in_frame(cloud: Cloud, state: Float[AnyArray, "*B S"]) -> BodyInFrame:
    """Return the frame of `state` (..., S), and shape and flow within it."""
    size = 3 * cloud.count
    positions = points_of(state[..., :size])
    velocities = points_of(state[..., size : 2 * size])
    centre, orientation, shape = cloud.own_frame(positions)
    velocity = cloud.centroid(velocities)
    flow = to_body_axes(orientation, velocities - velocity[..., None, :])
    angular_velocity = cloud.angular_velocity(shape, flow)
    besides = flow - cross(angular_velocity[..., None, :], shape)
    return BodyInFrame(
        centre, orientation, velocity, angular_velocity, flat_of(shape), flat_of(besides)
    )
