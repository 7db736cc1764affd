"""Checks of the groups of a body's parts, for any physics: unknown members, and members of two groups."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_known


def check_groups(groups: Mapping[str, Sequence[str]], names: Sequence[str], noun: str) -> None:
    """Refuse groups with a member that is not among `names`, or that is in another group already.

    `noun` names the kind of members, such as "node", for the message.
    """
    group_of: dict[str, str] = {}
    for group, members in groups.items():
        check_known(members, names, noun, f"groups.{group}")
        for member in members:
            if member in group_of:
                raise ArgumentError(
                    f"groups.{group}: {noun} '{member}' is in '{group_of[member]}' already. Leave it in one."
                )
            group_of[member] = group
