"""An error after a while is that of the super step nearest to it, whoever asks."""

from __future__ import annotations

import numpy as np
import pytest

from neuroanimator.learn.evaluation.accuracy import error_after


@pytest.mark.parametrize(("seconds", "error"), [(0.0, 1), (0.2, 2), (0.34, 3), (9.0, 4)])
def test_an_error_is_that_of_the_nearest_super_step_but_the_start(seconds: float, error: float):
    assert error_after(np.arange(5.0), 0.1, seconds) == error
