"""The few numbers a deformable body's motion is made of: a frame, and how much of each shape seen in training.

Hundreds of mass points move as one body that bends in a few ways. An emulator of those few numbers is
smaller, faster and cannot tear the body apart: whatever it predicts is a mixture of shapes seen in training.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.emulator.pca import Basis, mixing, principal, reflection
from neuroanimator.parsing.numbers import entries, listed, number, numbers, whole
from neuroanimator.state.layout import MAX_NUMBERS
from neuroanimator.state.reference_shape import (
    Cloud,
    flat_of,
    points_of,
    to_body_axes,
    to_world_axes,
)
from neuroanimator.state.rotation import Numbers, cross
from neuroanimator.state.structure import MAX_RESPONSE, Mirror, Segment, Structure

RIGID = 13
"""Numbers of the frame: place, quaternion, velocity, spin."""

HARDLY_EXCEEDED = 0.9995
"""Share of the training states within the reach of the modes."""

MAX_DISTANCE, SHARES_OFF = 1e6, 1e-6
"""Of a cloud read from a file: the largest coordinate [m], and how far the sum of shares may be off 1."""

MIN_SPREAD, TINY = 1e-9, 1e-12
"""Modes that never vary, and motions that stand still, are not divided by zero."""


class Modes(eqx.Module):
    """Places and speeds of N mass points ↔ (frame, odd modes, even modes, odd contractions, even contractions).

    Odd numbers change sign in the body's mirror, even ones do not; without a mirror all are odd. Modes of
    places and of speeds are kept apart, because what bends is not what swings.
    """

    positions: Float[Array, "3*N Q"]
    """Orthonormal; how the shape differs from the mean one, per mode of places [m]."""
    velocities: Float[Array, "3*N P"]
    """Orthonormal; how mass points move besides the frame's motion, per mode of speeds [m/s]."""
    mean_position: Float[Array, " 3*N"]
    mean_velocity: Float[Array, " 3*N"]
    spread: Float[Array, " Q+P"]
    """Standard deviation of every mode in training, in their order within the few numbers."""
    reach: Float[Array, " 4"]
    """What training hardly exceeded: rms of the modes of places and of speeds in standard deviations, speed [m/s],
    spin [rad/s]."""
    cloud: Cloud = eqx.field(static=True)
    mirror: Mirror | None = eqx.field(static=True)
    odd_positions: int = eqx.field(static=True)
    """How many modes of places are odd; they come first."""
    odd_velocities: int = eqx.field(static=True)
    muscles: int = eqx.field(static=True)
    """How many contractions belong to the state."""
    time_constant: float = eqx.field(static=True)
    """[s] Time constant of the muscles."""

    @property
    def size(self) -> int:
        """How many numbers there are in all."""
        return RIGID + self.count + self.muscles

    def to_json(self) -> dict[str, Any]:
        """Return what, with the arrays, makes up the modes."""
        return {
            "cloud": [list(self.cloud.positions), list(self.cloud.masses)],
            "mirror": None
            if self.mirror is None
            else [list(self.mirror.points), list(self.mirror.controls)],
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
    def from_json(cls, described: dict[str, Any], states: int, controls: int) -> Modes:
        """Return the modes `to_json` wrote, arrays zero; ValueError unless they fit `states` and `controls`."""
        cloud = _cloud_from_json(described["cloud"])
        counts = listed(
            described["counts"], "modes", lambda count, what: whole(count, what, 0, MAX_NUMBERS), 4
        )
        q, p, odd_q, odd_p = counts
        size = 3 * cloud.count
        muscles = whole(described["muscles"], "modes: muscles", 0, controls)
        fits = states == 2 * size + muscles and muscles in (0, controls)
        if not fits or not 0 <= odd_q <= q <= size or not 0 <= odd_p <= p <= size:
            raise ValueError("modes: other sizes than the state")
        mirror = None
        if described["mirror"] is not None:
            points, drives = described["mirror"]
            mirror = Mirror(
                entries(points, "modes: mirror", cloud.count),
                entries(drives, "modes: mirror", controls),
            )
            if not _swaps(mirror.points, cloud.count) or not _swaps(mirror.controls, controls):
                raise ValueError("modes: a mirror that does not pair left and right")
        bases = jnp.zeros((size, q)), jnp.zeros((size, p)), jnp.zeros(size), jnp.zeros(size)
        arrays = *bases, jnp.zeros(q + p), jnp.zeros(4)
        time_constant = number(described["time_constant"], "modes: response", 0, MAX_RESPONSE)
        return cls(*arrays, cloud, mirror, odd_q, odd_p, muscles, time_constant)

    def encode(self, state: Numbers) -> Numbers:
        """Return (..., I) the few numbers of `state` (..., S)."""
        xp = state.__array_namespace__()
        rigid, shape, swing = seen_in_frame(self.cloud, state)
        q = (shape - _like(self.mean_position, state)) @ _like(self.positions, state)
        p = (swing - _like(self.mean_velocity, state)) @ _like(self.velocities, state)
        pulled = self.encode_control(state[..., 2 * shape.shape[-1] :])
        return xp.concat([*rigid, *self._ordered(q, p), pulled], axis=-1)

    def decode(self, latent: Numbers) -> Numbers:
        """Return the states (..., S) closest to what `latent` (..., I) says."""
        xp = latent.__array_namespace__()
        centre, orientation, velocity, angular_velocity = (
            latent[..., :3],
            latent[..., 3:7],
            latent[..., 7:10],
            latent[..., 10:RIGID],
        )
        q, p = self._parted(latent)
        seen = points_of(_like(self.mean_position, latent) + q @ _like(self.positions, latent).mT)
        flow = points_of(_like(self.mean_velocity, latent) + p @ _like(self.velocities, latent).mT)
        flow = flow + cross(angular_velocity[..., None, :], seen)
        positions = centre[..., None, :] + to_world_axes(orientation, seen)
        velocities = velocity[..., None, :] + to_world_axes(orientation, flow)
        activations = self.decode_control(latent[..., RIGID + self.count :])
        return xp.concat([flat_of(positions), flat_of(velocities), activations], axis=-1)

    @property
    def count(self) -> int:
        """How many modes there are, of places and of speeds together."""
        return self.positions.shape[1] + self.velocities.shape[1]

    def _ordered(self, q: Numbers, p: Numbers) -> list[Numbers]:
        a, b = self.odd_positions, self.odd_velocities
        return [q[..., :a], p[..., :b], q[..., a:], p[..., b:]]

    def _parted(self, latent: Numbers) -> tuple[Numbers, Numbers]:
        xp = latent.__array_namespace__()
        a, b, q = self.odd_positions, self.odd_velocities, self.positions.shape[1]
        modes = latent[..., RIGID : RIGID + self.count]
        even_places = modes[..., a + b : b + q]
        return (
            xp.concat([modes[..., :a], even_places], axis=-1),
            xp.concat([modes[..., a : a + b], modes[..., b + q :]], axis=-1),
        )

    def bounded(self, latent: Float[Array, " I"]) -> Float[Array, " I"]:
        """Return `latent` (I,) with shape, swing, speed and spin shrunk to what training showed, if they are beyond it.

        It keeps a body in shape for ever: see `docs/decisions/0008-bodies-in-few-numbers.md`.
        """
        velocity, angular_velocity, modes = self._limited(latent)
        squares = self._squares(velocity, angular_velocity, modes / self.spread)
        kept = [
            jnp.minimum(1.0, self.reach[i] / jnp.sqrt(square + TINY))
            for i, square in enumerate(squares)
        ]
        shrunk = modes * jnp.where(self._is_place(), kept[0], kept[1])
        parts = (
            latent[:7],
            velocity * kept[2],
            angular_velocity * kept[3],
            shrunk,
            latent[RIGID + self.count :],
        )
        return jnp.concatenate(parts)

    def _limited(self, latent: Numbers) -> tuple[Numbers, Numbers, Numbers]:
        """Return velocity (..., 3), spin (..., 3) and modes (..., K) of `latent` (..., I): what has a reach."""
        return latent[..., 7:10], latent[..., 10:RIGID], latent[..., RIGID : RIGID + self.count]

    def _squares(
        self, velocity: Numbers, angular_velocity: Numbers, modes: Numbers
    ) -> tuple[Numbers, ...]:
        """Return the squares (...) of what `reach` limits, in its order; `modes` in standard deviations."""
        xp, size, shape = modes.__array_namespace__(), modes**2, self._is_place()
        return (
            xp.mean(size, axis=-1, where=shape),
            xp.mean(size, axis=-1, where=~shape),
            xp.sum(velocity**2, axis=-1),
            xp.sum(angular_velocity**2, axis=-1),
        )

    def _is_place(self) -> np.ndarray:
        """Return (K,) which modes, in their order within the few numbers, are of places."""
        q, p = self.positions.shape[1], self.velocities.shape[1]
        a, b = self.odd_positions, self.odd_velocities
        return np.repeat([True, False, True, False], [a, b, q - a, p - b])

    def with_reach(self, states: np.ndarray) -> Modes:
        """Return the modes with spread and reach of the bodies in `states` (B, S)."""
        velocity, angular_velocity, modes = self._limited(self.encode(np.asarray(states, float)))
        spread = np.maximum(modes.std(axis=0), MIN_SPREAD)
        squares = self._squares(velocity, angular_velocity, modes / spread)
        reach = np.array([np.quantile(np.sqrt(square), HARDLY_EXCEEDED) for square in squares])
        return replace(
            self, spread=jnp.asarray(spread, jnp.float32), reach=jnp.asarray(reach, jnp.float32)
        )

    def encode_control(self, control: Numbers) -> Numbers:
        """Return (..., C) what left and right do oppositely, then what they do alike."""
        if self.mirror is None or not control.shape[-1]:
            return control
        return control @ _like(mixing(self.mirror)[0], control)

    def decode_control(self, mixed: Numbers) -> Numbers:
        """Return the controls (..., C) of which `encode_control` gives `mixed`."""
        if self.mirror is None or not mixed.shape[-1]:
            return mixed
        return mixed @ _like(mixing(self.mirror)[0], mixed).mT

    def structure(self, whole: Structure) -> Structure:
        """Return what an emulator may exploit of the few numbers, given what it may of the body's state."""
        segments = [
            Segment("position", 3, rate=7),
            Segment("quaternion", 4, rate=10),
            Segment("velocity", 3),
            Segment("plain", 3 + self.count),
        ]
        if self.muscles:
            segments.append(Segment("lag", self.muscles, time_constant=self.time_constant))
        return Structure(
            angles=(),
            rates=(),
            plain=tuple(range(10, self.size)),
            segments=tuple(segments),
            probes=whole.probes,
            has_gravity=whole.has_gravity,
            is_immersed=whole.is_immersed,
            external_forces=whole.external_forces,
        )

    def odd_changes(self) -> tuple[bool, ...]:
        """Return, per number of a change, whether the mirror reverses it: along Y, and turns about X and Z."""
        along, about = (False, True, False), (True, False, True)
        return (*along, *about, *along, *about, *self._odd_modes())

    def odd_features(self, whole: Structure, probes: int) -> tuple[bool, ...]:
        """Return the same per plain feature: spin, modes, contractions, up, velocity, `probes` numbers, controls."""
        along, about = (False, True, False), (True, False, True)
        assert self.mirror is not None
        differences = mixing(self.mirror)[1]
        sides = tuple(i < differences for i in range(len(self.mirror.controls)))
        seen = (*(along if whole.has_gravity else ()), *along, *(False,) * probes)
        return (*about, *self._odd_modes(), *(sides if self.muscles else ()), *seen, *sides)

    def _odd_modes(self) -> tuple[bool, ...]:
        odd = self.odd_positions + self.odd_velocities
        return tuple(i < odd for i in range(self.count))


def _like(numbers: Numbers, state: Numbers) -> Numbers:
    return state.__array_namespace__().asarray(numbers, dtype=state.dtype)


def _cloud_from_json(row: Any) -> Cloud:
    """Return the cloud; its masses are shares of the whole, so each is above 0 and they add up to 1."""
    positions, masses = row
    shares = numbers(masses, "modes: masses", most=1)
    if not shares or min(shares) <= 0 or abs(sum(shares) - 1) > SHARES_OFF:
        raise ValueError("modes: wanted masses as shares of the whole, each above 0")
    points = listed(
        positions,
        "modes: places",
        lambda position, what: numbers(position, what, 3, MAX_DISTANCE),
        len(shares),
    )
    return Cloud(tuple((x, y, z) for x, y, z in points), shares)


def _swaps(partners: tuple[int, ...], count: int) -> bool:
    return len(partners) == count and all(
        0 <= p < count and partners[p] == i for i, p in enumerate(partners)
    )


def seen_in_frame(cloud: Cloud, state: Numbers) -> tuple[list[Numbers], Numbers, Numbers]:
    """Return the frame of `state` (..., S) as place, quaternion, velocity and spin; then shape and swing within it.

    The shape (..., 3N) [m] is where mass points are, the swing (..., 3N) [m/s] how they move besides the frame.
    """
    size = 3 * cloud.count
    positions, velocities = points_of(state[..., :size]), points_of(state[..., size : 2 * size])
    centre, orientation, seen = cloud.own_frame(positions)
    velocity = cloud.centroid(velocities)
    flow = to_body_axes(orientation, velocities - velocity[..., None, :])
    angular_velocity = cloud.angular_velocity(seen, flow)
    return (
        [centre, orientation, velocity, angular_velocity],
        flat_of(seen),
        flat_of(flow - cross(angular_velocity[..., None, :], seen)),
    )


def fit_modes(
    structure: Structure, states: np.ndarray, position_modes: int, velocity_modes: int
) -> Modes:
    """Return the modes in which the bodies in `states` (B, S) vary most."""
    assert structure.cloud is not None
    _, shapes, swings = seen_in_frame(structure.cloud, np.asarray(states, float))
    reflect = None if structure.mirror is None else reflection(structure.mirror)
    most = shapes.shape[1]
    positions = principal(shapes, min(position_modes, most), reflect)
    velocities = principal(swings, min(velocity_modes, most), reflect)
    return modes_along(structure, positions, velocities, states)


def modes_along(
    structure: Structure, positions: Basis, velocities: Basis, states: np.ndarray
) -> Modes:
    """Return the modes in these directions, with spread and reach of the bodies in `states` (B, S)."""
    assert structure.cloud is not None
    followers = [segment for segment in structure.segments if segment.kind == "lag"]
    modes = Modes(
        positions=jnp.asarray(positions.directions, jnp.float32),
        velocities=jnp.asarray(velocities.directions, jnp.float32),
        mean_position=jnp.asarray(positions.mean, jnp.float32),
        mean_velocity=jnp.asarray(velocities.mean, jnp.float32),
        spread=jnp.ones(positions.directions.shape[1] + velocities.directions.shape[1]),
        reach=jnp.ones(4),
        cloud=structure.cloud,
        mirror=structure.mirror,
        odd_positions=positions.odd,
        odd_velocities=velocities.odd,
        muscles=sum(segment.size for segment in followers),
        time_constant=followers[0].time_constant if followers else 0.0,
    )
    return modes.with_reach(states)
