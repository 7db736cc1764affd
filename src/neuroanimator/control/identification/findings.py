"""Identifiability: which parameters a recording determines, which it never shows, and which it cannot tell apart."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.control.identification.unknowns import Unknowns

KNOWN_SHARE = 0.5
"""Maximum standard deviation of a known parameter, as a share of that from its range alone."""

PART = 0.3
"""Minimum weight of a parameter in an unknown combination for it to be named."""

AT_END = 1e-3
"""Distance from the end of its range, as a share of it, within which a value counts as at the end."""


class Findings(NamedTuple):
    """Knowledge about the unknowns."""

    deviations: Float[np.ndarray, " G"]
    """Standard deviation of each unknown."""
    is_known: tuple[bool, ...]
    """Whether the recording determines each better than its range."""
    not_shown: tuple[str, ...]
    """Names of unknowns on which no motion in the recording depends enough."""
    confused: tuple[tuple[str, ...], ...]
    """Names of unknowns of which only a combination is known."""
    at_end: tuple[str, ...]
    """Names of unknowns whose best value is at an end of its range; zero does not count, as nothing may be beyond it."""


def findings_of(
    covariance: Float[np.ndarray, "G G"], values: Float[np.ndarray, " G"], unknowns: Unknowns
) -> Findings:
    """Return the findings from the `covariance` of the unknowns at the fitted `values`.

    In units of the ranges' deviations, directions of a large variance are combinations that the recording does not show.
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
