"""Movers in a state: the entries of their poses and rates, and how rates change poses.

A pose is a position, with a heading about Z if the mover turns, or with a quaternion if it turns freely. Rates have three
numbers for a quaternion's four: the angular velocity along the mover's own axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

from jaxtyping import Float

from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.placement import Placement
from neuroanimator.state.rotation import (
    heading_of,
    multiply,
    rotate,
    rotated_by,
    rotation_between,
)

FREELY: Literal["freely"] = "freely"
"""Turns of a mover that has an orientation, as a bone has."""

Turns = Literal[False, True, "freely"]
"""Whether a mover turns: about Z, or freely."""

POSE_SIZES: dict[Turns, int] = {False: 3, True: 4, FREELY: 7}
"""Number of entries of a mover's pose, by how it turns."""

Piece = tuple[slice, slice, bool]
"""Entries of a pose, those of its rates, and whether they are a quaternion."""


class Mover(NamedTuple):
    """State entries of a mover."""

    entry: int
    """First of its entries among those of all movers' poses: its position."""
    rate: int
    """First of its entries among those of all movers' rates, or controls: its velocity."""
    turns: Turns
    """Whether its heading, or its quaternion, follows its position."""

    @property
    def size(self) -> int:
        """Number of entries of its pose."""
        return POSE_SIZES[self.turns]

    @property
    def rate_size(self) -> int:
        """Number of entries of its rates."""
        return self.size - self.turns_freely

    @property
    def turns_freely(self) -> bool:
        """Whether it has a quaternion."""
        return self.turns == FREELY

    @property
    def entries(self) -> slice:
        """Its entries among those of all movers' poses."""
        return slice(self.entry, self.entry + self.size)

    @property
    def rates(self) -> slice:
        """Its entries among those of all movers' rates, or controls."""
        return slice(self.rate, self.rate + self.rate_size)

    @property
    def own_quaternions(self) -> tuple[int, ...]:
        """Where the quaternion begins in its own pose, if it has one; see `moved`."""
        return (3,) if self.turns_freely else ()

    @property
    def placement(self) -> Placement:
        """Entries of its own frame among those of all movers' poses."""
        if self.turns_freely:
            return Placement(self.entry, orientation=self.entry + 3)
        return Placement(self.entry, self.entry + 3 if self.turns else -1)


def place_movers(turning: tuple[Turns, ...]) -> tuple[Mover, ...]:
    """Return the entries of each mover; `turning` is how each turns."""
    movers = []
    entry = rate = 0
    for turns in turning:
        movers.append(Mover(entry, rate, turns))
        entry += movers[-1].size
        rate += movers[-1].rate_size
    return tuple(movers)


def quaternion_entries(movers: tuple[Mover, ...]) -> tuple[int, ...]:
    """Return where the quaternions begin in the poses of `movers`."""
    return tuple(mover.entry + 3 for mover in movers if mover.turns_freely)


def _pieces(size: int, quaternions: tuple[int, ...]) -> Iterator[Piece]:
    """Yield the pieces of `size` pose entries in order: those of vectors, and each quaternion."""
    entry = rate = 0
    for first in (*quaternions, size):
        if first > entry:
            yield slice(entry, first), slice(rate, rate + first - entry), False
            rate += first - entry
        if first < size:
            yield slice(first, first + 4), slice(rate, rate + 3), True
            rate += 3
        entry = first + 4


def moved_as_one(
    poses: Float[AnyArray, "... D"],
    movers: tuple[Mover, ...],
    turn: Float[AnyArray, "... 4"],
    about: Float[AnyArray, "... 3"],
    to: Float[AnyArray, "... 3"],
) -> Float[AnyArray, "... D"]:
    """Return the `poses` of `movers` as one rigid piece, turned `about` a point that comes `to` another [m].

    Movers that turn about Z alone turn as far as seen from above, those that do not turn not at all.
    """
    parts = []
    for mover in movers:
        place = mover.placement
        parts.append(to + rotate(turn, place.origin(poses) - about))
        if mover.turns_freely:
            parts.append(multiply(turn, poses[..., place.orientation : mover.entries.stop]))
        elif mover.turns:
            parts.append(poses[..., place.heading, None] + heading_of(turn)[..., None])
    return poses.__array_namespace__().concat(parts, axis=-1)


def _are_all_free(size: int, quaternions: tuple[int, ...]) -> bool:
    """Return whether `size` pose entries are those of movers that all turn freely."""
    return quaternions == tuple(range(3, size, POSE_SIZES[FREELY]))


def moved(
    poses: Float[AnyArray, "... D"],
    changes: Float[AnyArray, "... R"],
    quaternions: tuple[int, ...],
) -> Float[AnyArray, "... D"]:
    """Return `poses` after `changes`, which are the rates times a duration; quaternions are `rotated_by` them.

    `quaternions` is where these begin in a pose.
    """
    if not quaternions:
        return poses + changes
    if _are_all_free(poses.shape[-1], quaternions):
        # All at once: a dozen bones one after another make a program that takes minutes to compile.
        xp = poses.__array_namespace__()
        every = xp.reshape(poses, (*poses.shape[:-1], -1, 7))
        rates = xp.reshape(changes, (*changes.shape[:-1], -1, 6))
        pieces = [every[..., :3] + rates[..., :3], rotated_by(every[..., 3:], rates[..., 3:])]
        return xp.reshape(xp.concat(pieces, axis=-1), poses.shape)
    parts = []
    for entries, rates, is_quaternion in _pieces(poses.shape[-1], quaternions):
        pose, change = poses[..., entries], changes[..., rates]
        parts.append(rotated_by(pose, change) if is_quaternion else pose + change)
    return poses.__array_namespace__().concat(parts, axis=-1)


def change_between(
    before: Float[AnyArray, "... D"],
    after: Float[AnyArray, "... D"],
    quaternions: tuple[int, ...],
) -> Float[AnyArray, "... R"]:
    """Return the changes by which `moved` turns the poses `before` into `after`."""
    if not quaternions:
        return after - before
    parts = []
    for entries, _, is_quaternion in _pieces(before.shape[-1], quaternions):
        first, last = before[..., entries], after[..., entries]
        parts.append(rotation_between(first, last) if is_quaternion else last - first)
    return before.__array_namespace__().concat(parts, axis=-1)
