"""Who sees and answers what in a hierarchy, from the groups a user names."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from neuroanimator.emulator.features import Features
from neuroanimator.emulator.group_modes import GroupedModes
from neuroanimator.emulator.networks.hierarchy import Part
from neuroanimator.emulator.pca import mixing
from neuroanimator.emulator.shape_modes import Modes
from neuroanimator.errors import ArgumentError
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.structure import Group, Structure

RIGID_CHANGES = 12
"""Numbers of a body's change that are its frame's: place, turn, velocity, spin."""
SPIN = 3
"""Of a body's features the first: its spin; its modes follow."""


def parts_of_body(
    grouped: GroupedModes, structure: Structure, even: tuple[int, ...], features: int
) -> tuple[Part, ...]:
    """Return who sees and answers what: the upper network all but the segments' own modes, a child its segment.

    `even` names the even ones among the `features`.
    """
    modes, count = grouped.modes, grouped.modes.count
    a, b = modes.odd_positions, modes.odd_velocities
    own_q, own_p = grouped.place_owners, grouped.speed_owners
    owners = [*own_q[:a], *own_p[:b], *own_q[a:], *own_p[b:]]
    upper = [
        i for i in range(features) if not SPIN <= i < SPIN + count or owners[i - SPIN].is_centre
    ]
    centres = (RIGID_CHANGES + i for i, owner in enumerate(owners) if owner.is_centre)
    parts = [_part("body", upper, (*range(RIGID_CHANGES), *centres), even, features)]
    for number, group in enumerate(structure.groups):
        near = [
            i
            for i, owner in enumerate(owners)
            if owner.is_centre and abs(owner.group - number) <= 1
        ]
        own = [i for i, owner in enumerate(owners) if owner.group == number and not owner.is_centre]
        sees = [SPIN + i for i in sorted({*near, *own})] + _controls_seen(
            modes, group, SPIN + count, features
        )
        answers, hears = (tuple(RIGID_CHANGES + i for i in numbers) for numbers in (own, near))
        parts.append(_part(group.name, sees, answers, even, features, hears))
    return tuple(parts)


def _controls_seen(modes: Modes, group: Group, first: int, features: int) -> list[int]:
    """Return the features that are contractions or controls of muscles at `group`, or sums and differences of them."""
    size = modes.muscles
    mix = np.eye(size) if modes.mirror is None else mixing(modes.mirror)[0]
    columns = np.flatnonzero(np.abs(mix[list(group.controls)]).sum(axis=0) > 0)
    return [start + int(c) for start in (first, features - size) for c in columns]


def _part(
    name: str,
    sees: list[int],
    answers: tuple[int, ...],
    even: tuple[int, ...],
    features: int,
    hears: tuple[int, ...] = (),
) -> Part:
    odd = [i for i in range(features) if i not in even]
    return Part(
        name=name,
        odd=tuple(odd.index(i) for i in sees if i not in even),
        even=tuple(even.index(i) for i in sees if i in even),
        answers=answers,
        hears=hears,
    )


def parts_of_joints(
    structure: Structure, frame: Frame, features: Features, controls: int
) -> tuple[Part, ...]:
    """Return who sees and answers what of a model with joints: the upper network sees all and answers for the rest.

    The rest is what is in no group: the root, and joints left out. A child sees its own joints, their motors and
    the rest as it is now, and hears what becomes of the rest.
    """
    angles, plain = np.asarray(features.angles), features.plain
    first = 2 * len(angles)
    local = range(first + len(plain), first + len(plain) + frame.local_size)
    motors = range(local.stop, local.stop + controls)
    changes = frame.change_entries(angles.shape[1])
    grouped = {entry for group in structure.groups for entry in group.entries}
    left = [entry for entry in range(angles.shape[1]) if entry not in grouped]
    rest = _changed(changes, left)
    if not rest:
        raise ArgumentError(
            "groups: every joint is in one. Leave out those that carry the others, such as a waist."
        )
    parts = [Part("body", tuple(range(motors.stop)), (), rest)]
    for group in structure.groups:
        seen = {*_seen_of(angles, plain, group.entries), *_seen_of(angles, plain, left), *local}
        seen |= {motors[motor] for motor in group.controls}
        parts.append(
            Part(group.name, tuple(sorted(seen)), (), _changed(changes, group.entries), hears=rest)
        )
    return tuple(parts)


def _changed(changes: list[tuple[int, ...]], entries: Iterable[int]) -> tuple[int, ...]:
    return tuple(sorted({number for entry in entries for number in changes[entry]}))


def _seen_of(angles: np.ndarray, plain: tuple[int, ...], entries: Sequence[int]) -> list[int]:
    """Return the features that show state `entries`: sines and cosines of angles they take part in, and themselves."""
    rows = [int(row) for row in np.flatnonzero(np.abs(angles[:, list(entries)]).sum(axis=1))]
    entries_seen = [2 * len(angles) + i for i, entry in enumerate(plain) if entry in entries]
    return [*rows, *(row + len(angles) for row in rows), *entries_seen]
