"""The body's own frame: where it is and where it heads must not change what it does next.

A root that moves freely is seen by the direction of gravity and its velocities along its own axes.
Changes are predicted along the same axes and put back into the world, so that moving the world or
turning it about the vertical changes nothing (Grzeszczuk et al., SIGGRAPH 1998).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import equinox as eqx

from neuroanimator.state.reference_shape import (
    Cloud,
    flat_of,
    points_of,
    to_body_axes,
    to_world_axes,
)
from neuroanimator.state.rotation import (
    Numbers,
    cross,
    rotate,
    rotate_back,
    rotated_by,
    rotation_between,
    rotation_rows,
    upward,
)
from neuroanimator.state.structure import Probe, Segment, Structure, orientations_of

PROBE_CEILING = 1.0
"""[m] A foot higher than about this is as good as infinitely high: no super step crosses it unseen."""

PROBE_FEATURES = 4
"""Numbers a probe is shown by: its height and its depth, each now and where it would coast to."""

SOFTNESS = 0.05
"""[m] Over which the kink of a depth is rounded: about how far soft ground gives way."""


class Frame(eqx.Module):
    """How a state is seen without place and heading, and how it changes."""

    segments: tuple[Segment, ...] = eqx.field(static=True)
    """Empty: the state is plain numbers and the frame does nothing."""
    probes: tuple[Probe, ...] = eqx.field(static=True)
    dt: float = eqx.field(static=True)
    """Super step [s], for what the state would become if its rates stayed."""
    has_gravity: bool = eqx.field(static=True, default=True)
    """Whether the direction of gravity matters."""
    is_immersed: bool = eqx.field(static=True, default=False)
    """Whether probes look for the surface of water, far from which it matters no more, instead of for the ground."""
    cloud: Cloud | None = eqx.field(static=True, default=None)
    """The mass points that define the frame, where the state is theirs."""
    external_forces: tuple[tuple[float, ...], ...] = eqx.field(static=True, default=())
    """(3, C) force [N] in the world per control; empty where controls are no such forces."""

    @classmethod
    def of(cls, structure: Structure, dt: float) -> Frame:
        """Return the frame of states with this structure; a `dt` of zero leaves out coasting."""
        return cls(
            structure.segments,
            structure.probes,
            dt,
            structure.has_gravity,
            structure.is_immersed,
            structure.cloud,
            structure.external_forces,
        )

    def change_size(self, state_size: int) -> int:
        """Return how many numbers describe a change of a state of `state_size` entries."""
        return (
            sum(segment.change_size for segment in self.segments) if self.segments else state_size
        )

    @property
    def local_size(self) -> int:
        """Length of what `local` returns."""
        sizes = {"quaternion": 6, "velocity": 3, "planar velocity": 2}
        points = ("points", "point velocities")
        total = sum(s.size if s.kind in points else sizes.get(s.kind, 0) for s in self.segments)
        return (
            total
            - (3 if self.has_gravity else 6) * self._has_root
            + PROBE_FEATURES * len(self.probes) * (self.cloud is None)
        )

    @property
    def velocity_entries(self) -> tuple[int, ...]:
        """Where the root's velocity along its own axes lies in what `local` returns; empty without a free root."""
        if not self._has_root or not any(segment.kind == "velocity" for segment in self.segments):
            return ()
        sizes, start, is_root = {"quaternion": 6, "velocity": 3, "planar velocity": 2}, 0, True
        for segment in self.segments:
            if segment.kind == "velocity":
                return tuple(range(start, start + 3))
            if segment.kind == "quaternion":
                start += (3 if self.has_gravity else 0) if is_root else sizes["quaternion"]
                is_root = False
            else:
                start += sizes.get(segment.kind, 0)
        return ()

    @property
    def orientations(self) -> tuple[tuple[int, int], ...]:
        """(i, j) where a quaternion begins at state entry i and its angular velocity, in the body's frame, at j."""
        return orientations_of(self.segments)

    @property
    def _has_root(self) -> bool:
        return any(segment.kind == "position" for segment in self.segments)

    def _parts(self, *vectors: Numbers) -> Iterator[tuple[Segment, list[Numbers]]]:
        """Yield each segment with its entries of the states (..., S)."""
        start = 0
        for segment in self.segments:
            yield segment, [vector[..., start : start + segment.size] for vector in vectors]
            start += segment.size

    def _root(self, state: Numbers) -> Numbers:
        """Return what turns with the root: its quaternion (..., 4), or heading (..., 1) in a plane."""
        for segment, (entries,) in self._parts(state):
            if segment.kind in ("quaternion", "heading"):
                return entries
            if segment.kind == "points" and self.cloud is not None:
                return self.cloud.orientation(points_of(entries))
        return state[..., :0]

    def local(self, state: Numbers) -> Numbers:
        """Return (..., L) the root's numbers that do not depend on place and heading, and balls' axes."""
        xp = state.__array_namespace__()
        if not self.segments:
            return state[..., :0]
        root, seen, is_root = self._root(state), [], self._has_root
        for segment, (entries,) in self._parts(state):
            if segment.kind == "quaternion":
                if self.has_gravity or not is_root:
                    seen.append(upward(entries) if is_root else _two_axes(entries))
                is_root = False
            elif segment.kind in ("points", "point velocities"):
                seen.append(_seen_points(self.cloud, segment, entries, root))
            elif segment.kind == "velocity":
                seen.append(rotate_back(root, entries))
            elif segment.kind == "planar velocity":
                seen.append(_turn_plane(-root, entries))
        if (
            self.probes and self.cloud is None
        ):  # mass points are seen one by one, and probes through their modes
            seen += self._probe_heights(state)
        return xp.concat(seen, axis=-1) if seen else state[..., :0]

    def _probe_heights(self, state: Numbers) -> list[Numbers]:
        """Return the probes' heights over the ground, now and where they would coast to, and how deep they are in it.

        Heights are flat above the ceiling, in water also below its like: there rest must look the same at any depth.
        Depths have a kink at the ground, as contact forces have; without
        them the network must make its own, and errors at touchdown are half as large again.
        """
        xp = state.__array_namespace__()
        position, quaternion, speed, angular_velocity = (
            next(entries[0] for segment, entries in self._parts(state) if segment.kind == kind)
            if kind
            else state[..., self._root_rate() : self._root_rate() + 3]
            for kind in ("position", "quaternion", "velocity", "")
        )
        up, probes = upward(quaternion), xp.asarray(self.probes, dtype=state.dtype)
        centres, radii = probes[:, :3].T, probes[:, 3]
        now = position[..., 2:] + up @ centres - radii
        rising = speed[..., 2:] + cross(up, angular_velocity) @ centres
        heights = (now, now + self.dt * rising)
        ranged = _near_surface if self.is_immersed else _ranged
        return [ranged(height) for height in heights] + [_depth(height) for height in heights]

    def _root_rate(self) -> int:
        return next(segment.rate for segment in self.segments if segment.kind == "quaternion")

    def control_size(self, controls: int) -> int:
        """Return how many numbers `seen_control` makes of so many controls."""
        return 3 if self.external_forces else controls

    def seen_control(self, state: Numbers, control: Numbers) -> Numbers:
        """Return the controls (..., C) as the body feels them: forces of the world along its own axes."""
        if not self.external_forces:
            return control
        force = (
            control
            @ control.__array_namespace__().asarray(self.external_forces, dtype=control.dtype).T
        )
        return rotate_back(self._root(state), force)

    def change_entries(self, state_size: int) -> list[tuple[int, ...]]:
        """Return, per state entry, the numbers of a change that change it: for a quaternion's four the same three."""
        if not self.segments:
            return [(entry,) for entry in range(state_size)]
        found: list[tuple[int, ...]] = []
        start = 0
        for segment in self.segments:
            numbers = tuple(range(start, start + segment.change_size))
            one_by_one = segment.change_size == segment.size and segment.kind == "plain"
            found += [(number,) for number in numbers] if one_by_one else [numbers] * segment.size
            start += segment.change_size
        return found

    def apply(self, state: Numbers, change: Numbers, control: Numbers | None = None) -> Numbers:
        """Return `state` (..., S) after `change` (..., V) on top of coasting at its present rates.

        Followers come closer to `control` (..., C); without one they stay.
        """
        if not self.segments:
            return state + change
        xp = state.__array_namespace__()
        root, following, start = self._root(state), [], 0
        for segment, (entries,) in self._parts(state):
            delta = change[..., start : start + segment.change_size]
            coasting = self._coasting(segment, state)
            if segment.kind == "lag":
                following.append(self._followed(segment, entries, control))
            else:
                following.append(_moved(segment, entries, delta, coasting, root))
            start += segment.change_size
        return xp.concat(following, axis=-1)

    def _followed(self, segment: Segment, entries: Numbers, control: Numbers | None) -> Numbers:
        if control is None:
            return entries
        left = math.exp(-self.dt / segment.time_constant) if segment.time_constant else 0.0
        return control + left * (entries - control)

    def remainder(self, before: Numbers, after: Numbers) -> Numbers:
        """Return the change (..., V) for which `apply(before, change)` is `after`."""
        return self._differences(before, after, coasts=True)

    def difference(self, before: Numbers, after: Numbers) -> Numbers:
        """Return how `after` differs from `before` (..., V), seen from `before`: the unit-carrying error or change."""
        return self._differences(before, after, coasts=False)

    def _differences(self, before: Numbers, after: Numbers, *, coasts: bool) -> Numbers:
        if not self.segments:
            return after - before
        xp = before.__array_namespace__()
        root, found = self._root(before), []
        for segment, (first, last) in self._parts(before, after):
            if segment.kind == "lag":
                continue
            coasting = self._coasting(segment, before) if coasts else None
            found.append(_difference(segment, first, last, coasting, root))
        return xp.concat(found, axis=-1)

    def _coasting(self, segment: Segment, state: Numbers) -> Numbers | None:
        """Return what the segment's own rate adds in a super step; None where that is left to the network."""
        if segment.rate < 0 or segment.kind == "plain":
            return None
        size = 3 if segment.kind == "quaternion" else segment.size
        return self.dt * state[..., segment.rate : segment.rate + size]


def _moved(
    segment: Segment, entries: Numbers, delta: Numbers, coasting: Numbers | None, root: Numbers
) -> Numbers:
    extra = 0.0 if coasting is None else coasting
    if segment.kind == "quaternion":
        return rotated_by(entries, extra + delta)
    if segment.kind in ("position", "velocity"):
        return entries + extra + rotate(root, delta)
    if segment.kind in ("planar position", "planar velocity"):
        return entries + extra + _turn_plane(root, delta)
    if segment.kind in ("points", "point velocities"):
        return entries + extra + flat_of(to_world_axes(root, points_of(delta)))
    return entries + extra + delta


def _difference(
    segment: Segment, before: Numbers, after: Numbers, coasting: Numbers | None, root: Numbers
) -> Numbers:
    extra = 0.0 if coasting is None else coasting
    if segment.kind == "quaternion":
        return rotation_between(before, after) - extra
    if segment.kind in ("position", "velocity"):
        return rotate_back(root, after - before - extra)
    if segment.kind in ("planar position", "planar velocity"):
        return _turn_plane(-root, after - before - extra)
    if segment.kind in ("points", "point velocities"):
        return flat_of(to_body_axes(root, points_of(after - before - extra)))
    return after - before - extra


def _seen_points(cloud: Cloud | None, segment: Segment, entries: Numbers, root: Numbers) -> Numbers:
    """Return places from the centroid, or speeds, (..., 3N) along the body's axes."""
    points = points_of(entries)
    if segment.kind == "points" and cloud is not None:
        points = points - cloud.centroid(points)[..., None, :]
    return flat_of(to_body_axes(root, points))


# Roots instead of tanh and softplus, whose compiled forms take one number at a time and half a super step together.


def _ranged(height: Numbers) -> Numbers:
    """Return `height` [m] where it is small, the ceiling where it is large."""
    xp = height.__array_namespace__()
    return height / xp.sqrt(1 + (height / PROBE_CEILING) ** 2)


def _near_surface(height: Numbers) -> Numbers:
    """Return `height` [m] over the water's surface, at most the ceiling above or below it."""
    return height.__array_namespace__().clip(height, -PROBE_CEILING, PROBE_CEILING)


def _depth(height: Numbers) -> Numbers:
    """Return how far below the ground `height` [m] is, its kink rounded, at most the ceiling."""
    xp = height.__array_namespace__()
    near = xp.clip(height, -PROBE_CEILING, PROBE_CEILING)
    return (xp.sqrt(near * near + SOFTNESS**2) - near) / 2


def _turn_plane(angle: Numbers, vector: Numbers) -> Numbers:
    """Return `vector` (..., 2) turned by `angle` (..., 1) [rad]."""
    xp = vector.__array_namespace__()
    cosine, sine = xp.cos(angle[..., 0]), xp.sin(angle[..., 0])
    x, y = vector[..., 0], vector[..., 1]
    return xp.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def _two_axes(quaternion: Numbers) -> Numbers:
    """Return two columns of the rotation (..., 6): all of it, without the quaternion's double sign."""
    rows = rotation_rows(quaternion)
    xp = quaternion.__array_namespace__()
    return xp.stack([rows[i][j] for j in range(2) for i in range(3)], axis=-1)
