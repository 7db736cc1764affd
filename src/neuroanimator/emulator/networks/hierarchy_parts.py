"""Inputs and answers of the parts of a hierarchy of networks, from the groups that a user defines."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.features import Features
from neuroanimator.emulator.group_modes import GroupedModes, Owner
from neuroanimator.emulator.networks.network import Part
from neuroanimator.emulator.shape_modes import ShapeModes
from neuroanimator.errors import ArgumentError
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.structure import BodyGroup, Structure, mixing


def parts_of_body(
    grouped: GroupedModes, structure: Structure, even: tuple[int, ...], features: int
) -> tuple[Part, ...]:
    """Return the parts: the upper network sees and answers all but the segments' own modes, a child its segment.

    `features` is the number of raw features, and `even` lists the even ones.
    """
    modes = grouped.modes
    owners = _owners_in_latent_order(grouped)
    first_change = modes.change_layout.index("modes").start
    first_feature = modes.feature_layout.index("modes").start
    centres = [i for i, owner in enumerate(owners) if owner.is_centre]
    own_features = {first_feature + i for i, owner in enumerate(owners) if not owner.is_centre}
    upper_sees = [i for i in range(features) if i not in own_features]
    upper_answers = (*range(first_change), *(first_change + i for i in centres))
    parts = [_part("body", upper_sees, upper_answers, even, features)]
    for number, group in enumerate(structure.groups):
        near = [i for i in centres if abs(owners[i].group - number) <= 1]
        own = [i for i, owner in enumerate(owners) if owner.group == number and not owner.is_centre]
        sees = [first_feature + i for i in sorted({*near, *own})]
        sees += _features_of_controls(modes, group, features)
        parameters = modes.feature_layout.index("parameters")
        sees += range(parameters.start, parameters.stop)
        answers = tuple(first_change + i for i in own)
        hears = tuple(first_change + i for i in near)
        parts.append(_part(group.name, sees, answers, even, features, hears))
    return tuple(parts)


def _owners_in_latent_order(grouped: GroupedModes) -> list[Owner]:
    """Return the owners of all modes in the order of the latent part "modes"."""
    odd_positions = grouped.modes.odd_positions
    odd_velocities = grouped.modes.odd_velocities
    return [
        *grouped.position_owners[:odd_positions],
        *grouped.velocity_owners[:odd_velocities],
        *grouped.position_owners[odd_positions:],
        *grouped.velocity_owners[odd_velocities:],
    ]


def _features_of_controls(modes: ShapeModes, group: BodyGroup, features: int) -> list[int]:
    """Return the features that are activations or controls of muscles of `group`, or sums and differences of them."""
    size = modes.muscles
    mix = np.eye(size)
    if modes.mirror is not None:
        mix = mixing(modes.mirror.controls)[0]
    columns = np.flatnonzero(np.abs(mix[list(group.controls)]).sum(axis=0) > 0)
    first_activation = modes.feature_layout.index("activations").start
    first_control = features - size
    return [*(first_activation + columns).tolist(), *(first_control + columns).tolist()]


def _part(
    name: str,
    sees: list[int],
    answers: tuple[int, ...],
    even: tuple[int, ...],
    features: int,
    hears: tuple[int, ...] = (),
) -> Part:
    """Return a part with the raw features that it sees, numbered within their streams."""
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
    """Return the parts of a model with joints: the upper network sees everything and answers for the rest.

    The rest is everything in no group: the root, and joints left out. A child sees its own joints, their motors, the
    rest, and the upper network's answers about the rest. Contact features depend on all joints, so the upper network sees them.
    """
    angles = np.asarray(features.angles)
    state_size = angles.shape[1]
    first_local = 2 * len(angles) + len(features.plain)
    contacts = 0 if frame.contacts is None else frame.contacts.size  # the last local features
    local = range(first_local, first_local + frame.local_size - contacts)
    first_motor = first_local + frame.local_size
    motors = range(first_motor, first_motor + controls)
    changes = frame.change_entries(state_size)
    in_groups = {entry for group in structure.groups for entry in group.entries}
    ungrouped = [entry for entry in range(state_size) if entry not in in_groups]
    rest = _changes_of(changes, ungrouped)
    if not rest:
        raise ArgumentError(
            "groups: every joint is in one. Leave out those that carry the others, such as a waist."
        )
    rest_features = _features_of(angles, features.plain, ungrouped)
    parts = [Part("body", tuple(range(motors.stop)), (), rest)]
    for group in structure.groups:
        own_features = _features_of(angles, features.plain, group.entries)
        own_motors = [motors[motor] for motor in group.controls]
        sees = tuple(sorted({*own_features, *rest_features, *local, *own_motors}))
        answers = _changes_of(changes, group.entries)
        parts.append(Part(group.name, sees, (), answers, hears=rest))
    return tuple(parts)


def _changes_of(changes: list[tuple[int, ...]], entries: Iterable[int]) -> tuple[int, ...]:
    """Return the numbers of a change that change any of the state `entries`, in increasing order."""
    return tuple(sorted({number for entry in entries for number in changes[entry]}))


def _features_of(
    angles: Float[np.ndarray, "P S"], plain: tuple[int, ...], entries: Sequence[int]
) -> list[int]:
    """Return the features of state `entries`: sines and cosines of angles that they enter, and the entries themselves."""
    takes_part = np.abs(angles[:, list(entries)]).sum(axis=1)
    sines = np.flatnonzero(takes_part)
    cosines = sines + len(angles)
    themselves = [2 * len(angles) + i for i, entry in enumerate(plain) if entry in entries]
    return [*sines.tolist(), *cosines.tolist(), *themselves]
