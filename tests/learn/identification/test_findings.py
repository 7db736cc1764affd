"""What is known of parameters does not hang on rounding: one verdict, however often the last bits differ."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float

from neuroanimator.learn.identification.findings import Findings, findings_of
from neuroanimator.learn.identification.least_squares import (
    LEAST,
    PRIOR,
    SLOPE_ERROR,
    Normal,
    covariance,
)
from neuroanimator.learn.identification.unknowns import Unknowns
from neuroanimator.state.parameters import Parameter

NAMES = ("damping", "gain", "gear", "mass")

ROUNDING = 1e-12
"""Relative errors of slopes that only another order of additions makes."""


def unknowns() -> Unknowns:
    each = [Parameter(name, "1", 0.0, 1.0, 0.5) for name in NAMES]
    return Unknowns(tuple(each), len(each), has_delay=False, offsets=())


def verdict(slopes: Float[np.ndarray, "N G"]) -> Findings:
    """Return the findings from derivatives of readings by the unknowns, in units of the noise."""
    matrix = slopes.T @ slopes + PRIOR * np.eye(len(NAMES))
    none = np.zeros((1, 0))
    normal = Normal(matrix, np.zeros(len(NAMES)), none[..., None], none, none[..., None], 0.0)
    return findings_of(covariance(normal, unknowns()), np.full(len(NAMES), 0.4), unknowns())


def test_neither_of_two_that_nothing_depends_on_is_known_whatever_rounding_does() -> None:
    rng = np.random.default_rng(0)
    slopes = 1e3 * rng.normal(size=(200, 4))
    for _ in range(200):
        # What a motor that does nothing makes of gain and gear: errors alone.
        errors = ROUNDING * 1e3 * rng.normal(size=(200, 2))
        errors[:, 1] += rng.choice([-1.0, 0.0, 1.0]) * errors[:, 0]
        slopes[:, 1:3] = errors
        found = verdict(slopes)
        assert found.not_shown == ("gain", "gear")
        assert found.confused == ()
        assert found.is_known == (True, False, False, True)


@pytest.mark.parametrize("share", [0.5, 1.0, 2.0])
def test_two_of_which_only_the_product_is_known_stay_confused_whatever_rounding_does(
    share: float,
) -> None:
    rng = np.random.default_rng(0)
    slopes = 1e3 * rng.normal(size=(200, 4))
    slopes[:, 2] = share * slopes[:, 1]
    for _ in range(200):
        found = verdict(slopes * (1 + ROUNDING * rng.normal(size=slopes.shape)))
        assert found.confused == (("gain", "gear"),)
        assert found.not_shown == ()


def test_what_errors_of_slopes_feign_is_no_knowledge_and_there_is_no_cliff_above_it() -> None:
    rng = np.random.default_rng(0)
    slopes = 1e5 * np.linalg.qr(rng.normal(size=(200, 4)))[0]
    others = slopes[:, 3].copy()
    deviations = []
    for size in np.geomspace(0.3, 300, 60):
        slopes[:, 3] = size * SLOPE_ERROR * others
        deviations.append(verdict(slopes).deviations[3])
    assert deviations[0] == pytest.approx(PRIOR**-0.5, rel=1e-3)
    assert (np.diff(deviations) <= LEAST).all()
    # Twice the errors and more: as independent readings of that size tell.
    assert deviations[-1] == pytest.approx(1 / (300 * SLOPE_ERROR * 1e5), rel=0.01)
    assert max(np.array(deviations[1:]) / np.array(deviations[:-1])) <= 1 + LEAST
