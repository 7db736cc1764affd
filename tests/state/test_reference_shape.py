"""The orientation of a cloud of mass points and its derivative, also where the cloud has no longest axis."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from neuroanimator import load_system


@pytest.mark.parametrize("bend", [0.0, 0.05], ids=["at rest", "bent"])
@pytest.mark.parametrize("name", ["cube", "fish"])
def test_the_derivative_of_the_orientation_is_that_of_finite_differences(name: str, bend: float):
    cloud = load_system(name).structure.cloud
    assert cloud is not None
    rng = np.random.default_rng(0)
    rest = np.array(cloud.positions)
    size = np.ptp(rest)
    positions = rest + bend * size * rng.normal(size=rest.shape)
    way = rng.normal(size=rest.shape)
    step = 1e-6 * size
    ahead = cloud.orientation(positions + step * way)
    behind = cloud.orientation(positions - step * way)
    expected = (ahead - behind) / (2 * step)
    single = positions.astype(np.float32)
    _, found = jax.jvp(jax.jit(cloud.orientation), (single,), (way.astype(np.float32),))
    np.testing.assert_allclose(found, expected, atol=2e-4 * np.abs(expected).max())
