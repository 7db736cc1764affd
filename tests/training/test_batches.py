"""Batches: what updates are made of."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator.training.batches import parts_of

WINDOWS = 5
STEPS = 7


def test_parts_of_windows_are_some_of_their_super_steps_in_order_and_all_are_drawn():
    states = jnp.arange(WINDOWS * (STEPS + 1), dtype=jnp.float32).reshape(WINDOWS, STEPS + 1, 1)
    rows = jnp.arange(400) % WINDOWS
    for unroll in (1, 3, STEPS):
        parts, controls = parts_of(jax.random.key(unroll), states, states[:, :-1], rows, unroll)
        assert np.all(np.diff(parts[..., 0], axis=1) == 1)
        assert np.all(parts[:, :-1] == controls)
        window, first = np.divmod(np.asarray(parts[:, 0, 0]), STEPS + 1)
        assert np.all(window == rows)
        assert set(first) == set(range(STEPS - unroll + 1))
