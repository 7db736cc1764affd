"""The body's own frame: its position and heading must not change its motion.

A freely moving root is represented by the direction of gravity and its velocities along its own axes. Changes are
predicted along the same axes and put back into the world, so that moving the world or turning it about the vertical
changes nothing (Grzeszczuk et al., SIGGRAPH 1998).
"""

from __future__ import annotations

from functools import reduce
from typing import Any

import equinox as eqx
from jaxtyping import Float

from neuroanimator.files.numbers import flag, listed, numbers
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.contacts import (
    CEILING,
    GROUND_SOFTNESS,
    Contacts,
    below_ceiling,
    depth,
    height_below_ceiling,
)
from neuroanimator.state.layout import Pairs
from neuroanimator.state.reference_shape import Cloud
from neuroanimator.state.rotation import cross, rotate_back, rotated_by, upward
from neuroanimator.state.segments import (
    Driven,
    Lag,
    PlanarPosition,
    PlanarVelocity,
    Points,
    PointVelocities,
    Position,
    Quaternion,
    Segment,
    Surroundings,
    Velocity,
    first_of_each,
    moves_freely,
    orientations_of,
    place_segments,
    segments_from_json,
    segments_to_json,
)
from neuroanimator.state.shape_contacts import ShapeContacts
from neuroanimator.state.structure import Probe, ProbeModes, Structure

GRAVITY_FEATURES = 3
"""Number of features of a root's orientation: the direction of gravity."""

PROBE_FEATURES = 4
"""Number of features of a probe: its height and its depth, each now and after coasting."""

REMAINING = 0.9
"""Share that remains after a super step of how far a root lies beyond the range of training: it comes back in a second or
two. Above 1 - 1e-3 rounding and the turn's second order would add up to a slow drift away."""

TINY = 1e-12
"""Square of a speed [m²/s²] added under a square root, whose slope at zero is infinite."""

MAX_PROBES = 256
"""Maximum number of probes in a file."""

MAX_DISTANCE = 1e6
"""Maximum coordinate of a probe in a file [m]."""


def _probe(row: Any, what: str) -> Probe:
    x, y, z, radius = numbers(row, what, 4, MAX_DISTANCE)
    return x, y, z, radius


def _probe_modes(described: Any, segments: tuple[Segment, ...], probes: int) -> ProbeModes:
    """Return the shapes' displacements of so many `probes` in a file; ValueError unless the state has their amplitudes."""
    if not probes:
        raise ValueError("frame: probe modes of no probes")
    modes = listed(
        described,
        "frame: probe modes",
        lambda axis, what: listed(axis, what, lambda row, what: numbers(row, what, probes)),
    )
    rate = first_of_each(segments)[Quaternion].segment.rate
    room = sum(segment.size for segment in segments) - rate - 3
    counts = {len(axis) for axis in modes}
    if rate < 0 or len(modes) != 3 or len(counts) != 1 or not 1 <= counts.pop() <= room // 2:
        raise ValueError("frame: wanted the displacement of probes along three axes by each shape")
    return modes


class Frame(eqx.Module):
    """The body frame: a state, and its change, without position and heading."""

    segments: tuple[Segment, ...] = eqx.field(static=True)
    """Segments of the state, in order; if empty, the state is plain numbers and the frame does nothing."""
    probes: tuple[Probe, ...] = eqx.field(static=True)
    """Round parts of the root's body whose height matters."""
    dt: float = eqx.field(static=True)
    """Super step [s], over which the state would coast at its rates."""
    has_gravity: bool = eqx.field(static=True, default=True)
    """Whether the direction of gravity matters."""
    is_immersed: bool = eqx.field(static=True, default=False)
    """Whether probes measure the distance to the surface of water, which matters only nearby, instead of to the ground."""
    probe_modes: ProbeModes = eqx.field(static=True, default=())
    """How shapes displace the probes of a soft body; empty for a rigid one."""
    cloud: Cloud | None = eqx.field(static=True, default=None)
    """The mass points that define the frame, if the state is theirs."""
    external_forces: tuple[tuple[float, ...], ...] = eqx.field(static=True, default=())
    """Force in the world per control (3, C) [N]; empty if controls are not such forces."""
    contacts: Contacts | None = eqx.field(static=True, default=None)
    """Points that may touch the ground and joints that may reach a stop; None if networks have no features of them."""
    shape_contacts: ShapeContacts | None = eqx.field(static=True, default=None)
    """Nodes of a soft body that may touch movers; None for other bodies."""

    @classmethod
    def of(cls, structure: Structure, dt: float) -> Frame:
        """Return the frame of states with this structure; a `dt` of zero leaves out coasting."""
        return cls(
            segments=structure.segments,
            probes=structure.probes,
            dt=dt,
            has_gravity=structure.has_gravity,
            is_immersed=structure.is_immersed,
            probe_modes=structure.probe_modes,
            cloud=structure.cloud,
            external_forces=structure.external_forces,
            contacts=structure.contacts,
            shape_contacts=structure.shape_contacts,
        )

    def to_json(self) -> dict[str, Any]:
        """Return the parts that do not follow from the encoding, the time step and the contacts."""
        described = {
            "segments": segments_to_json(self.segments),
            "probes": self.probes,
            "has_gravity": self.has_gravity,
            "is_immersed": self.is_immersed,
            "external_forces": self.external_forces,
        }
        if self.probe_modes:
            described["probe_modes"] = self.probe_modes
        return described

    @classmethod
    def from_json(
        cls, described: dict[str, Any], state_size: int, controls: int, dt: float
    ) -> Frame:
        """Return the frame that `to_json` wrote, of latent states with `state_size` entries; ValueError names the fault."""
        segments = segments_from_json(described["segments"])
        if segments and sum(segment.size for segment in segments) != state_size:
            raise ValueError("frame: its segments do not fill the state")
        for segment in segments:
            if isinstance(segment, Points | PointVelocities):
                raise ValueError("frame: mass points are decoded by modes")
            if isinstance(segment, Driven | Lag) and segment.followed != controls:
                raise ValueError(
                    "frame: wanted as many numbers that follow controls as there are controls"
                )
            if segment.rate >= state_size - 1:
                raise ValueError("frame: a rate lies outside the state")
        probes = listed(described["probes"], "frame: probes", _probe, most=MAX_PROBES)
        if probes and not moves_freely(segments):
            raise ValueError("frame: probes need a root that moves freely")
        probe_modes = ()
        if "probe_modes" in described:
            probe_modes = _probe_modes(described["probe_modes"], segments, len(probes))
        external_forces = listed(
            described["external_forces"],
            "frame: pushes",
            lambda row, what: numbers(row, what, controls),
        )
        if len(external_forces) not in (0, 3):
            raise ValueError("frame: wanted pushes along three axes, or none")
        return cls(
            segments=segments,
            probes=probes,
            dt=dt,
            has_gravity=flag(described["has_gravity"], "frame: weighs"),
            is_immersed=flag(described["is_immersed"], "frame: is_immersed"),
            probe_modes=probe_modes,
            external_forces=external_forces,
        )

    def change_size(self, state_size: int) -> int:
        """Return the number of entries of a change of a state of `state_size` entries."""
        if not self.segments:
            return state_size
        return sum(segment.change_size for segment in self.segments)

    @property
    def local_size(self) -> int:
        """Length of the result of `local`."""
        sizes = [self._shown_size(segment) for segment in self.segments]
        if self._shows_probes:
            sizes.append(PROBE_FEATURES * len(self.probes))
        if self.contacts is not None:
            sizes.append(self.contacts.size)
        return sum(sizes)

    @property
    def local_names(self) -> list[str]:
        """Names of the numbers of `local`'s result, in words."""
        names: list[str] = []
        for segment in self.segments:
            is_root = segment is self._root_orientation
            names += ["tilt" if is_root else segment.kind] * self._shown_size(segment)
        return names + ["distance to the ground"] * (self.local_size - len(names))

    def max_speed(
        self, local_low: Float[AnyArray, " L"], local_high: Float[AnyArray, " L"]
    ) -> Float[AnyArray, ""] | None:
        """Return the root's maximum speed [m/s] where `local` (L,) is within these ends; None without a moving root."""
        start = 0
        for segment in self.segments:
            size = self._shown_size(segment)
            if isinstance(segment, (Velocity, PlanarVelocity)):
                xp = local_low.__array_namespace__()
                entries = slice(start, start + size)
                largest = xp.maximum(-local_low[entries], local_high[entries])
                return xp.sqrt((largest**2).sum())
            start += size
        return None

    @property
    def orientations(self) -> Pairs:
        """(i, j) where a quaternion begins at state entry i and its angular velocity, in the body's frame, at j."""
        return orientations_of(self.segments)

    def free_axes(self, plain: tuple[int, ...]) -> list[tuple[int, ...]]:
        """Return the entries along each axis along which a state may be moved: nothing depends on where it is.

        `plain` are the entries that are features themselves.
        """
        if self.contacts is not None:
            axes = [(entry,) for entry in self.contacts.placeless]
        elif self.shape_contacts is not None:
            axes = self.shape_contacts.free_axes()
        else:
            axes = self._axes_of_segments()
        return [axis for axis in axes if not set(axis) & set(plain)]

    def _axes_of_segments(self) -> list[tuple[int, ...]]:
        axes: list[tuple[int, ...]] = []
        for placed in place_segments(self.segments):
            entries = placed.indices
            if isinstance(placed.segment, Points):
                axes += [tuple(entries[axis::3]) for axis in range(3)]
            elif isinstance(placed.segment, Position | PlanarPosition):
                count = 2 if self._shows_probes else placed.segment.size  # probes show the height
                axes += [(entry,) for entry in entries[:count]]
        return axes

    @property
    def _root_orientation(self) -> Segment | None:
        """The quaternion of a freely moving root: the first one; None without such a root."""
        firsts = first_of_each(self.segments)
        if Position not in firsts or Quaternion not in firsts:
            return None
        return firsts[Quaternion].segment

    @property
    def _shows_probes(self) -> bool:
        """Whether probes have features of their own: mass points are features themselves, and imply their probes."""
        return bool(self.probes) and self.cloud is None

    def _shown_size(self, segment: Segment) -> int:
        """Return the number of features of `segment` in `local`."""
        if segment is not self._root_orientation:
            return segment.local_size
        return GRAVITY_FEATURES if self.has_gravity else 0

    def _root(self, state: Float[AnyArray, "... S"]) -> Float[AnyArray, "... R"]:
        """Return the root's rotation: its quaternion (..., 4), or heading (..., 1) in a plane."""
        for placed in place_segments(self.segments):
            axes = placed.segment.axes(state[..., placed.entries], self.cloud)
            if axes is not None:
                return axes
        return state[..., :0]

    def local(self, state: Float[AnyArray, "... S"]) -> Float[AnyArray, "... L"]:
        """Return (..., L) the root's numbers that do not depend on position and heading, and balls' axes."""
        root = self._root(state)
        root_orientation = self._root_orientation
        shown = []
        for placed in place_segments(self.segments):
            segment = placed.segment
            entries = state[..., placed.entries]
            if not self._shown_size(segment):
                continue
            if segment is root_orientation:
                shown.append(upward(entries))
            else:
                shown.append(segment.local(entries, root, self.cloud))
        if self._shows_probes:
            shown += self._probe_heights(state)
        if self.contacts is not None:
            shown += self.contacts.shown(state, root, self.dt)
        if not shown:
            return state[..., :0]
        return state.__array_namespace__().concat(shown, axis=-1)

    def _probe_heights(
        self, state: Float[AnyArray, "... S"]
    ) -> list[Float[AnyArray, "... probes"]]:
        """Return the probes' heights over the ground, and their depths in it, now and after coasting.

        Heights are flat above the ceiling, in water also as far below the surface: there rest must look the same at any
        depth. Depths have a kink at the ground, as contact forces have; without them the network must learn its own, and
        errors at touchdown are half as large again.
        """
        root = first_of_each(self.segments)
        velocity = state[..., root[Velocity].entries]
        rate = root[Quaternion].segment.rate
        angular_velocity = state[..., rate : rate + 3]
        up = upward(state[..., root[Quaternion].entries])
        height = self._heights(state)
        rising = velocity[..., 2:] + self._centres_along(cross(up, angular_velocity), state)
        if self.probe_modes:
            shapes = len(self.probe_modes[0])
            shape_rates = state[..., rate + 3 + shapes : rate + 3 + 2 * shapes]
            rising = rising + self._displaced_along(up, shape_rates)
        later = height + self.dt * rising
        in_range = _near_surface if self.is_immersed else below_ceiling
        depths = [depth(height, GROUND_SOFTNESS), depth(later, GROUND_SOFTNESS)]
        return [in_range(height), in_range(later), *depths]

    def _heights(self, state: Float[AnyArray, "... S"]) -> Float[AnyArray, "... P"]:
        """Return the height of each probe over the ground, or over the surface of water [m]."""
        root = first_of_each(self.segments)
        position = state[..., root[Position].entries]
        up = upward(state[..., root[Quaternion].entries])
        radii = state.__array_namespace__().asarray(self.probes, dtype=state.dtype)[:, 3]
        return position[..., 2:] + self._centres_along(up, state) - radii

    def _centres_along(
        self, direction: Float[AnyArray, "... 3"], state: Float[AnyArray, "... S"]
    ) -> Float[AnyArray, "... P"]:
        """Return how far the probes lie along a `direction` in the body's frame [m], displaced by its shapes."""
        centres = state.__array_namespace__().asarray(self.probes, dtype=state.dtype)[:, :3].T
        along = direction @ centres
        if not self.probe_modes:
            return along
        first = first_of_each(self.segments)[Quaternion].segment.rate + 3
        amplitudes = state[..., first : first + len(self.probe_modes[0])]
        return along + self._displaced_along(direction, amplitudes)

    def _displaced_along(
        self, direction: Float[AnyArray, "... 3"], amplitudes: Float[AnyArray, "... K"]
    ) -> Float[AnyArray, "... P"]:
        """Return the displacement of the probes along a `direction` by shapes of these `amplitudes`, or its rate."""
        xp = amplitudes.__array_namespace__()
        dtype = amplitudes.dtype
        x, y, z = (amplitudes @ xp.asarray(modes, dtype=dtype) for modes in self.probe_modes)
        return direction[..., :1] * x + direction[..., 1:2] * y + direction[..., 2:] * z

    def kept_above_ground(
        self, state: Float[AnyArray, " S"], local_low: Float[AnyArray, " L"]
    ) -> Float[AnyArray, " S"]:
        """Return `state` (S,), lifted so that no probe is deeper in the ground than in training; if lifted, it stops sinking.

        `local_low` (L,) are the lowest values of `local` in training.
        """
        if not self._shows_probes or self.is_immersed:
            return state
        xp = state.__array_namespace__()
        shown = self.local_size - (0 if self.contacts is None else self.contacts.size)
        first = shown - PROBE_FEATURES * len(self.probes)
        lowest = height_below_ceiling(local_low[first : first + len(self.probes)])
        missing = lowest - self._heights(state)
        # One by one: the gradient of `xp.max` asks which entry equals it; if XLA rounds the two differently, none does: 0 / 0.
        lift = reduce(xp.maximum, list(missing), xp.zeros_like(missing[0]))
        root = first_of_each(self.segments)
        height = root[Position].entries.start + 2
        rising = root[Velocity].entries.start + 2
        speed = state[rising]
        kept = [
            state[:height],
            (state[height] + lift)[None],
            state[height + 1 : rising],
            xp.where(lift > 0, xp.maximum(speed, 0), speed)[None],
            state[rising + 1 :],
        ]
        return xp.concat(kept)

    def kept_in_range(
        self,
        state: Float[AnyArray, " S"],
        before: Float[AnyArray, " S"],
        local_low: Float[AnyArray, " L"],
        local_high: Float[AnyArray, " L"],
    ) -> Float[AnyArray, " S"]:
        """Return `state` (S,), its root no faster and no more tilted than where `local` (L,) is within these ends.

        Velocities along single axes may leave them by once their range: a fall is no error, but a truck does not rise. A
        root that was beyond in the state `before` comes back gradually instead of with a jump.
        """
        if not self.segments:
            return state
        xp = state.__array_namespace__()
        root = self._root(state)
        root_before = self._root(before)
        max_speed = self.max_speed(local_low, local_high)
        kept = []
        start = 0
        for placed in place_segments(self.segments):
            segment = placed.segment
            entries = state[placed.entries]
            entries_before = before[placed.entries]
            size = self._shown_size(segment)
            low = local_low[start : start + size]
            high = local_high[start : start + size]
            if isinstance(segment, (Velocity, PlanarVelocity)):
                room = high - low
                velocity = segment.to_body(root, entries)
                velocity_before = segment.to_body(root_before, entries_before)
                back = _way_back(velocity, velocity_before, low - room, high + room)
                entries = _slowed(entries + segment.to_world(root, back), entries_before, max_speed)
            elif size and segment is self._root_orientation:
                up = upward(entries)
                back = _way_back(up, upward(entries_before), low, high)
                # A small turn moves the direction up by as much as it turns; only one about a level axis moves it.
                righted = rotated_by(entries, cross(back, up))
                root = entries = xp.where(xp.abs(back).sum() > 0, righted, entries)
            kept.append(entries)
            start += size
        return xp.concat(kept)

    def control_size(self, controls: int) -> int:
        """Return the length of `felt_control`'s result for a given number of `controls`."""
        if self.shape_contacts is not None:
            return self.shape_contacts.size
        return 3 if self.external_forces else controls

    def felt_control(
        self, state: Float[AnyArray, "... S"], control: Float[AnyArray, "... C"]
    ) -> Float[AnyArray, "... F"]:
        """Return the controls (..., C) as the body feels them: forces of the world along its own axes.

        For a soft body these are features of the movers, in its own frame, and of possible contacts.
        """
        if self.shape_contacts is not None:
            shown = self.shape_contacts.shown(state, control, self.dt)
            return control.__array_namespace__().concat(shown, axis=-1)
        if not self.external_forces:
            return control
        xp = control.__array_namespace__()
        force = control @ xp.asarray(self.external_forces, dtype=control.dtype).T
        return rotate_back(self._root(state), force)

    def change_entries(self, state_size: int) -> list[tuple[int, ...]]:
        """Return, for each state entry, the entries of a change that affect it: for a quaternion's four the same three."""
        if not self.segments:
            return [(entry,) for entry in range(state_size)]
        entries: list[tuple[int, ...]] = []
        for placed in place_segments(self.segments):
            entries += placed.segment.change_entries(placed.changes.start)
        return entries

    def apply(
        self,
        state: Float[AnyArray, "... S"],
        change: Float[AnyArray, "... V"],
        control: Float[AnyArray, "... C"] | None = None,
    ) -> Float[AnyArray, "... S"]:
        """Return `state` (..., S) after `change` (..., V) on top of coasting at its current rates.

        Lags approach `control` (..., C); without one they stay.
        """
        if not self.segments:
            return state + change
        around = Surroundings(self._root(state), control, self.dt)
        following = []
        for placed in place_segments(self.segments):
            segment = placed.segment
            entries = state[..., placed.entries]
            own_change = change[..., placed.changes]
            coasting = segment.coasting(state, self.dt)
            following.append(segment.apply(entries, own_change, coasting, around))
        return state.__array_namespace__().concat(following, axis=-1)

    def remainder(
        self, before: Float[AnyArray, "... S"], after: Float[AnyArray, "... S"]
    ) -> Float[AnyArray, "... V"]:
        """Return the change (..., V) for which `apply(before, change)` is `after`."""
        return self._difference(before, after, coasts=True)

    def difference(
        self, before: Float[AnyArray, "... S"], after: Float[AnyArray, "... S"]
    ) -> Float[AnyArray, "... V"]:
        """Return the difference of `after` from `before` (..., V), in the frame of `before`: the error or change with units."""
        return self._difference(before, after, coasts=False)

    def _difference(
        self, before: Float[AnyArray, "... S"], after: Float[AnyArray, "... S"], *, coasts: bool
    ) -> Float[AnyArray, "... V"]:
        if not self.segments:
            return after - before
        root = self._root(before)
        differences = []
        for placed in place_segments(self.segments):
            segment = placed.segment
            if not segment.change_size:
                continue
            coasting = segment.coasting(before, self.dt) if coasts else 0.0
            first = before[..., placed.entries]
            last = after[..., placed.entries]
            differences.append(segment.difference(first, last, coasting, root))
        return before.__array_namespace__().concat(differences, axis=-1)


def _way_back(
    values: Float[AnyArray, " D"],
    before: Float[AnyArray, " D"],
    low: Float[AnyArray, " D"],
    high: Float[AnyArray, " D"],
) -> Float[AnyArray, " D"]:
    """Return what brings `values` (D,) into the range, or nearer to it than `before` was; exactly zero inside."""
    xp = values.__array_namespace__()
    left = REMAINING * (before - xp.clip(before, low, high))
    return xp.clip(values, low + xp.minimum(left, 0), high + xp.maximum(left, 0)) - values


def _slowed(
    velocity: Float[AnyArray, " D"],
    before: Float[AnyArray, " D"],
    max_speed: Float[AnyArray, ""],
) -> Float[AnyArray, " D"]:
    """Return `velocity` (D,) scaled down to `max_speed`, or to little below the speed of `before` if that was higher."""
    xp = velocity.__array_namespace__()
    speed = xp.sqrt((velocity**2).sum() + TINY)
    speed_before = xp.sqrt((before**2).sum() + TINY)
    allowed = max_speed + REMAINING * xp.maximum(speed_before - max_speed, 0)
    return velocity * xp.minimum(1.0, allowed / speed)


def _near_surface(height: Float[AnyArray, " ..."]) -> Float[AnyArray, " ..."]:
    """Return `height` [m] over the water's surface, at most the ceiling above or below it."""
    return height.__array_namespace__().clip(height, -CEILING, CEILING)
