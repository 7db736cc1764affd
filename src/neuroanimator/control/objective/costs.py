"""Cost terms as users make them: each function checks what it is given and returns a term for `Objective.of`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.control.objective.terms import (
    AT_THE_END,
    Effort,
    FollowPath,
    KeepSpeed,
    KeepVelocity,
    Moments,
    Point,
    ReachHeight,
    ReachPoint,
    ReachPositions,
    Smoothness,
    StayUpright,
    StayWithin,
    Travel,
    TravelPoint,
    TravelTerm,
    as_weight,
)
from neuroanimator.emulator.arrays import as_parameter
from neuroanimator.errors import ArgumentError
from neuroanimator.state.layout import as_numbers
from neuroanimator.state.pose import has_pose, read_pose
from neuroanimator.state.structure import Structure
from neuroanimator.systems.system import System

PATH_SHARE = 0.1
"""Share of a path's length by which straying from it is an error of one, if nothing else is said."""


def effort(weight: float = 1.0) -> Effort:
    """Return the cost of effort: large controls."""
    return Effort(as_weight(weight))


def smoothness(weight: float = 0.01) -> Smoothness:
    """Return the cost of controls that jump."""
    return Smoothness(as_weight(weight))


def reach_position(
    system: System,
    position: ArrayLike,
    *,
    within: float,
    at: float | None = None,
    since: float | None = None,
    axes: str = "xyz",
    weight: float = 1.0,
) -> ReachPositions:
    """Return the cost of not being at `position` [m] at the end, `at` [s], or `since` [s] all along.

    `axes` says which of x, y, z it gives.
    """
    positions = as_numbers(position, "position")[None]
    term = reach_positions(system, positions, None, within=within, axes=axes, weight=weight)
    return replace(term, when=Moments.of(at, since))


def reach_point(
    system: System,
    body: str,
    position: ArrayLike,
    *,
    within: float,
    offset: ArrayLike = (0.0, 0.0, 0.0),
    at: float | None = None,
    since: float | None = None,
    axes: str = "xyz",
    weight: float = 1.0,
) -> ReachPoint:
    """Return the cost of a point of `body` not being at `position` [m] at the end, `at` [s], or `since` [s] all along.

    The point lies at `offset` (3,) [m] in the frame of the body, as MuJoCo has it: a hand, a mouth, the tip of a tool.
    """
    which = _axes(axes)
    place = _numbers("offset", offset, 3)
    return ReachPoint(
        weight=as_weight(weight),
        chain=system.skeleton.chain_to(body),
        offset=tuple(map(float, place)),
        position=_numbers("position", position, len(which)),
        within=_positive("within", within),
        axes=which,
        when=Moments.of(at, since),
    )


def reach_height(
    system: System, height: float, *, within: float, at: float | None = None, weight: float = 1.0
) -> ReachHeight:
    """Return the cost of any of the body being less than `height` [m] up at the end, or `at` [s].

    All of a deformable body are its mass points: a leap takes its tail out of the water too. Of a rigid body it is
    the root's position.
    """
    return ReachHeight(
        weight=as_weight(weight),
        structure=_posed(system),
        height=_number("height", height),
        within=_positive("within", within),
        when=Moments.of(at),
    )


def reach_positions(
    system: System,
    positions: ArrayLike,
    times: Sequence[float] | None,
    *,
    within: float,
    axes: str = "xyz",
    weight: float = 1.0,
) -> ReachPositions:
    """Return the cost of not being at `positions` (K, A) [m] at `times` (K,) [s]."""
    which = _axes(axes)
    positions = _numbers("places", positions, len(which), rows=True)
    when = AT_THE_END
    if times is not None:
        if len(times) != len(positions) or not min(times) >= 0:
            raise ArgumentError(
                f"keyframes: wanted {len(positions)} times of at least 0 s, came {list(times)}."
            )
        when = Moments.of(tuple(times))
    return ReachPositions(
        weight=as_weight(weight),
        structure=_posed(system),
        positions=positions,
        within=_positive("within", within),
        axes=which,
        when=when,
    )


def follow_path(
    system: System,
    points: ArrayLike,
    *,
    within: float | None = None,
    axes: str = "xyz",
    weight: float = 1.0,
) -> FollowPath:
    """Return the cost of straying from a path through `points` (K, A) [m], passed at a steady pace, the last one at the end.

    To be off by `within` [m] is an error of one; a tenth of the path's length if not given.
    """
    which = _axes(axes)
    points = _numbers("points", points, len(which), rows=True)
    legs = np.linalg.norm(np.diff(points, axis=0), axis=1)
    lengths = np.concatenate([[0.0], np.cumsum(legs)])
    if len(points) < 2 or not lengths[-1] > 0:
        raise ArgumentError(
            f"follow_path: wanted at least two different points, came {len(points)}."
        )
    if within is None:
        within = PATH_SHARE * float(lengths[-1])
    return FollowPath(
        weight=as_weight(weight),
        structure=_posed(system),
        points=points,
        shares=as_parameter(lengths / lengths[-1]),
        within=_positive("within", within),
        axes=which,
    )


def travel(
    system: System,
    direction: ArrayLike,
    distance: float,
    *,
    within: float,
    body: str | None = None,
    since: float | None = None,
    weight: float = 1.0,
) -> TravelTerm:
    """Return the cost of not coming `distance` [m] forward along `direction` (3,) by the end, or `since` [s] all along.

    A distance somewhat beyond what is possible means as far as possible: by the end, or in closed loop as soon as possible,
    `since` 0 s, for what is wanted by the end of every plan may be put off at every plan.
    What comes forward is the origin of `body`, as MuJoCo has it, or the root if not given, which is to be free, or a
    deformable body's centroid.
    """
    when = Moments.of(None, since)
    term_weight = as_weight(weight)
    unit = _unit("direction", direction)
    wanted = _positive("distance", distance)
    sizeable = _positive("within", within)
    names = [bone.name for bone in system.skeleton.bones if bone.joints]
    if body is None and names and not has_pose(system.structure):
        raise ArgumentError(
            f'travel: {system.name} has no free root. Say which body is to come forward: body = "{names[0]}", '
            f"or another of {', '.join(names)}."
        )
    if body is None:
        return Travel(term_weight, when, unit, wanted, sizeable, _posed(system))
    chain = system.skeleton.chain_to(body)
    return TravelPoint(term_weight, when, unit, wanted, sizeable, chain)


def keep_velocity(
    system: System,
    velocity: ArrayLike,
    *,
    within: float,
    since: float = 0.0,
    axes: str = "xyz",
    weight: float = 1.0,
) -> KeepVelocity:
    """Return the cost of not moving with `velocity` (A,) [m/s] in the world `since` a time [s]."""
    which = _axes(axes)
    wanted = _numbers("velocity", velocity, len(which))
    return KeepVelocity(
        weight=as_weight(weight),
        structure=_posed(system),
        velocity=wanted,
        within=_positive("within", within),
        axes=which,
        when=Moments.of(None, since),
    )


def keep_speed(
    system: System, speed: float, *, within: float, since: float = 0.0, weight: float = 1.0
) -> KeepSpeed:
    """Return the cost of not going forward at `speed` [m/s] `since` a time [s]."""
    return KeepSpeed(
        weight=as_weight(weight),
        structure=_posed(system),
        speed=_number("speed", speed),
        within=_positive("within", within),
        when=Moments.of(None, since),
    )


def keep_heading(
    system: System, direction: ArrayLike, *, within: float, since: float = 0.0, weight: float = 1.0
) -> Point:
    """Return the cost of not pointing along `direction` (3,) in the world, `within` [rad], `since` a time [s]."""
    return Point(
        weight=as_weight(weight),
        structure=_posed(system),
        direction=_unit("direction", direction),
        within=_positive("within", within),
        axis="forward",
        when=Moments.of(None, since),
    )


def reach_heading(
    system: System,
    direction: ArrayLike,
    *,
    within: float,
    at: float | None = None,
    weight: float = 1.0,
) -> Point:
    """Return the cost of not pointing along `direction` (3,), `within` [rad], at the end or `at` [s]."""
    return Point(
        weight=as_weight(weight),
        structure=_posed(system),
        direction=_unit("direction", direction),
        within=_positive("within", within),
        axis="forward",
        when=Moments.of(at),
    )


def stand_up(
    system: System, *, within: float, at: float | None = None, weight: float = 1.0
) -> Point:
    """Return the cost of the body's Z not pointing up, `within` [rad], at the end or `at` [s]."""
    return Point(
        weight=as_weight(weight),
        structure=_posed(system),
        direction=as_parameter([0.0, 0.0, 1.0]),
        within=_positive("within", within),
        axis="upward",
        when=Moments.of(at),
    )


def stay_upright(
    system: System,
    *,
    tolerance: float = 0.2,
    within: float = 0.15,
    may_pitch: bool = False,
    since: float = 0.0,
    weight: float = 1.0,
) -> StayUpright:
    """Return the cost of the body's Z leaning more than `tolerance` [rad] from the vertical, `since` a time [s].

    `within` [rad] beyond it, kept up for a second, count as an error of one. A body that `may_pitch`, to dive or to
    leap, is kept from rolling over only.
    """
    return StayUpright(
        weight=as_weight(weight),
        structure=_posed(system),
        tolerance=_positive("tolerance", tolerance),
        within=_positive("within", within),
        may_pitch=may_pitch,
        when=Moments.of(None, since),
    )


def stay_within(
    system: System,
    part: str,
    low: ArrayLike,
    high: ArrayLike,
    *,
    within: float,
    weight: float = 1.0,
) -> StayWithin:
    """Return the cost of the state's `part`, such as a joint, leaving what is between `low` and `high`, in its unit."""
    where = system.state.index(part)
    entries = tuple(range(where.start, where.stop))
    lows = _numbers("low", np.atleast_1d(low), None)
    highs = _numbers("high", np.atleast_1d(high), None)
    sizes = (1, len(entries))
    if len(lows) not in sizes or len(highs) not in sizes:
        raise ArgumentError(
            f"stay_within: wanted one bound or {len(entries)} for '{part}', came {low} and {high}."
        )
    lows = np.broadcast_to(lows, len(entries))
    highs = np.broadcast_to(highs, len(entries))
    if not (lows < highs).all():
        raise ArgumentError(
            f"stay_within: wanted low below high for '{part}', came {low} and {high}."
        )
    return StayWithin(
        weight=as_weight(weight),
        low=lows,
        high=highs,
        within=_positive("within", within),
        entries=entries,
    )


def _posed(system: System) -> Structure:
    """Return the structure of `system`; ArgumentError where a state says nothing of a position."""
    read_pose(system.structure, system.rest)
    return system.structure


def _axes(names: str) -> tuple[int, ...]:
    if not names or any(name not in "xyz" for name in names) or len(set(names)) != len(names):
        raise ArgumentError(f"axes: wanted some of x, y, z, such as 'xy', came '{names}'.")
    return tuple("xyz".index(name) for name in names)


def _numbers(
    label: str, values: ArrayLike, size: int | None, *, rows: bool = False
) -> Float[np.ndarray, " ..."]:
    """Return `values` (`size`,), or rows of them; ArgumentError unless all are finite and there is at least one."""
    array = as_numbers(values, label)
    axes = 2 if rows else 1
    has_size = size is None or array.shape[-1:] == (size,)
    if array.ndim != axes or not array.size or not has_size or not np.isfinite(array).all():
        numbers = "number" if size == 1 else "numbers"
        wanted = f"{size or 'some'} finite {numbers}"
        if rows:
            wanted = f"rows of {wanted}"
        raise ArgumentError(f"{label}: wanted {wanted}, came {array.tolist()}.")
    return as_parameter(array)


def _number(label: str, value: float) -> Float[np.ndarray, " ..."]:
    return _numbers(label, [value], 1).reshape(())


def _positive(label: str, value: float) -> Float[np.ndarray, " ..."]:
    if not 0 < value < math.inf:
        raise ArgumentError(f"{label}: wanted a finite number above 0, came {value:g}.")
    return as_parameter(value)


def _unit(label: str, direction: ArrayLike) -> Float[np.ndarray, " ..."]:
    vector = _numbers(label, direction, 3)
    length = float(np.linalg.norm(vector))
    if length == 0:
        raise ArgumentError(f"{label}: wanted a direction, came zeros.")
    return vector / length
