"""Environments in C do what they do in JAX: where the backend is C, no step waits for JAX to be compiled."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

import neuroanimator.gym  # noqa: F401 - registers the environments
from neuroanimator import set_backend
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.emulator.c_rows import CRows, RowFunction

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

STEPS = 12
ROWS = 3


def episodes(backend: str, name: str) -> list[tuple[Any, ...]]:
    """Return what the steps of an environment returned, by the same random actions."""
    set_backend(backend)
    env_id = f"neuroanimator/{name}-v0"
    env = gymnasium.make_vec(env_id, num_envs=ROWS, vectorization_mode="vector_entry_point")
    first, _ = env.reset(seed=3)
    rng = np.random.default_rng(0)
    space = env.action_space
    assert isinstance(space, gymnasium.spaces.Box)
    returned: list[tuple[Any, ...]] = [(first,)]
    for _ in range(STEPS):
        actions = space.low + rng.uniform(0, 1, space.shape) * (space.high - space.low)
        returned.append(env.step(actions))
    env.close()
    return returned


@needs_compiler
@pytest.mark.parametrize(
    ("name", "programs"),
    [("pendulum-50", {"step_row"}), ("lander-land", {"step_row", "observe_row"})],
)
def test_an_environment_in_c_is_the_one_in_jax(
    name: str, programs: set[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("neuroanimator.codegen.backend._chosen", [])
    made = set()
    load = RowFunction.in_c

    def noted(rows: RowFunction, module: Any) -> CRows | None:
        program = load(rows, module)
        if program is not None:
            made.add(rows.function.__name__)
        return program

    monkeypatch.setattr(RowFunction, "in_c", noted)
    in_c = episodes("auto", name)
    assert made == programs
    in_jax = episodes("jax", name)
    np.testing.assert_allclose(in_c[0][0], in_jax[0][0], rtol=1e-4, atol=1e-4)
    for computed, expected in zip(in_c[1:], in_jax[1:], strict=True):
        observations, rewards, terminated, truncated, info = expected
        np.testing.assert_allclose(computed[0], observations, rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(computed[1], rewards, rtol=1e-3, atol=1e-3)
        np.testing.assert_array_equal(computed[2], terminated)
        np.testing.assert_array_equal(computed[3], truncated)
        np.testing.assert_allclose(computed[4]["trust"], info["trust"], rtol=1e-3, atol=1e-3)
