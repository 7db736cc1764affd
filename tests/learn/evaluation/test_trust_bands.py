"""Bands of scores: errors that follow scores rise from band to band."""

from __future__ import annotations

import itertools

import numpy as np

from neuroanimator.learn.evaluation.trust_bands import SHARES, trust_bands


def test_bands_go_up():
    rng = np.random.default_rng(2)
    scores = rng.exponential(size=1000)
    errors = scores * rng.uniform(0.9, 1.1, 1000)
    bands = trust_bands(scores, errors)
    assert len(bands) == len(SHARES) - 1
    for lower, higher in itertools.pairwise(bands):
        assert lower.middle < higher.middle
        assert lower.median < higher.median
        assert lower.median <= lower.large


def test_scores_that_say_nothing_make_no_bands():
    errors = np.linspace(0, 1, 100)
    assert trust_bands(np.zeros(100), errors) == ()
    assert trust_bands(np.full(100, np.inf), errors) == ()
    assert trust_bands(np.zeros(0), np.zeros(0)) == ()
    assert trust_bands(np.arange(100.0), np.where(errors > 0.5, np.nan, errors))[-1].large < 0.5
