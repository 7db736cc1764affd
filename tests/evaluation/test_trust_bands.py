"""Bands of scores: every super step is in one, and errors that follow scores rise from band to band."""

from __future__ import annotations

import itertools

import numpy as np

from neuroanimator.evaluation.trust_bands import trust_bands


def test_every_super_step_is_in_one_band_and_bands_go_up():
    rng = np.random.default_rng(2)
    scores = rng.exponential(size=1000)
    errors = scores * rng.uniform(0.9, 1.1, 1000)
    bands = trust_bands(scores, errors)
    assert sum(band.samples for band in bands) == 1000
    assert bands[0].low == scores.min()
    assert bands[-1].high == scores.max()
    for lower, higher in itertools.pairwise(bands):
        assert lower.high <= higher.low
        assert lower.median < higher.median
        assert lower.median <= lower.large


def test_scores_that_say_nothing_make_no_bands():
    errors = np.linspace(0, 1, 100)
    assert trust_bands(np.zeros(100), errors) == ()
    assert trust_bands(np.full(100, np.inf), errors) == ()
    assert trust_bands(np.zeros(0), np.zeros(0)) == ()
    assert trust_bands(np.arange(100.0), np.where(errors > 0.5, np.nan, errors))[-1].large < 0.5
