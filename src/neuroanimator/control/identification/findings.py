"""What a recording tells of parameters and what it does not: those it never shows, and those it cannot tell apart."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.control.identification.unknowns import Unknowns

KNOWN_SHARE = 0.5
"""A parameter is known if its standard deviation is at most this share of what its range alone says."""

PART = 0.3
"""Least weight of a parameter in a combination that is not known for it to be named."""

AT_END = 1e-3
"""Share of its range from its end within which a value lies at it."""


class Findings(NamedTuple):
    """What is known of the unknowns."""

    deviations: Float[np.ndarray, " G"]
    """Standard deviation of each."""
    is_known: tuple[bool, ...]
    """Whether the recording says more of it than its range does."""
    not_shown: tuple[str, ...]
    """Names of those that no motion in the recording depends on enough."""
    confused: tuple[tuple[str, ...], ...]
    """Names of those of which only a combination is known."""
    at_end: tuple[str, ...]
    """Names of those whose best value lies at an end of its range that is not zero, beyond which there may be nothing."""


def findings_of(
    covariance: Float[np.ndarray, "G G"], values: Float[np.ndarray, " G"], unknowns: Unknowns
) -> Findings:
    """Return what `covariance` says of the unknowns, whose values were found to be `values`.

    In units of what ranges alone say, directions of a large variance are combinations that the recording does not show.
    """
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scaled = covariance / np.outer(unknowns.spread, unknowns.spread)
    variances, directions = np.linalg.eigh(scaled)
    is_known = deviations <= KNOWN_SHARE * unknowns.spread
    not_shown: list[str] = []
    confused: list[list[str]] = []
    for variance, direction in zip(variances, directions.T, strict=True):
        if variance <= KNOWN_SHARE**2:
            continue
        parts = [
            unknowns.names[i] for i in np.flatnonzero(np.abs(direction) > PART) if not is_known[i]
        ]
        if len(parts) == 1:
            not_shown += parts
        elif parts:
            _join(confused, parts)
    low, high = np.array(unknowns.ends).T
    room = AT_END * (high - low)
    is_at_end = ((values < low + room) & (low != 0)) | ((values > high - room) & (high != 0))
    at_end = [name for name, is_there in zip(unknowns.names, is_at_end, strict=True) if is_there]
    return Findings(
        deviations=deviations,
        is_known=tuple(bool(known) for known in is_known),
        not_shown=tuple(dict.fromkeys(not_shown)),
        confused=tuple(tuple(sorted(group)) for group in confused),
        at_end=tuple(name for name in at_end if name not in not_shown),
    )


def _join(groups: list[list[str]], names: list[str]) -> None:
    """Add `names` to `groups`, together with every group that has one of them."""
    joined = set(names)
    for group in [*groups]:
        if joined & set(group):
            joined |= set(group)
            groups.remove(group)
    groups.append(sorted(joined))
