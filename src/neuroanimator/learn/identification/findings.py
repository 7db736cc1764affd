"""Identifiability: which parameters a recording determines, which it never shows, and which it cannot tell apart."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.learn.identification.unknowns import Unknowns

KNOWN_SHARE = 0.5
"""Maximum standard deviation of a known parameter, as a share of that from its range alone."""

PART = 0.1
"""Minimum share of a parameter's axis within the unknown combinations for it to be named among them, and maximum share
outside them for it to be unknown by itself."""

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
    They are judged by the projection on all of them together: if several variances are as large, rounding alone decides
    which directions an eigenvalue problem returns, but not what these span.
    """
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scaled = covariance / np.outer(unknowns.spread, unknowns.spread)
    variances, directions = np.linalg.eigh(scaled)
    is_known = deviations <= KNOWN_SHARE * unknowns.spread
    unseen = directions[:, variances > KNOWN_SHARE**2]
    projection = np.where(is_known, 0.0, unseen @ unseen.T)
    shares = np.diag(projection)
    names = np.array(unknowns.names)
    not_shown: list[str] = []
    confused: list[list[str]] = []
    for row, share, name in zip(projection, shares, unknowns.names, strict=True):
        parts = names[(np.abs(row) > PART) & (shares <= 1 - PART)].tolist()
        if share > 1 - PART or parts == [name]:
            not_shown.append(name)
        elif share > PART:
            _join(confused, parts)
    low, high = np.array([(unknown.low, unknown.high) for unknown in unknowns.each]).T
    room = AT_END * (high - low)
    is_at_end = ((values < low + room) & (low != 0)) | ((values > high - room) & (high != 0))
    at_end = [name for name, is_there in zip(unknowns.names, is_at_end, strict=True) if is_there]
    return Findings(
        deviations=deviations,
        is_known=tuple(bool(known) for known in is_known),
        not_shown=tuple(not_shown),
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
