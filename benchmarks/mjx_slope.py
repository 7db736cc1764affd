"""Gradients of a return by MJX's own derivatives (`pip install mujoco-mjx`), for benchmarks; the package does not use it.

MJX differentiates in reverse only through a contact solver of one iteration: `opt.iterations` is 1, and the line search has
`LINE_SEARCH` steps. Everything else is the model's own. So these are gradients of a physics with contacts less
exact than MuJoCo's.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

LINE_SEARCH = 8
"""Steps of the solver's line search."""


def is_installed() -> bool:
    """Return whether MJX is there."""
    return importlib.util.find_spec("mujoco.mjx") is not None


def slope_of(
    model: mujoco.MjModel, substeps: int, reward: Any, dt: float
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Return a function (controls (T, C), states (T+1, S), weights (T,)) → slope (T, C) of the weighed sum of rewards."""
    from mujoco import mjx

    model.opt.iterations = 1
    model.opt.ls_iterations = LINE_SEARCH
    physics = mjx.put_model(model)
    blank = mjx.make_data(physics)

    def total(
        controls: Float[Array, "T C"], start: Float[Array, " S"], weights: Float[Array, " T"]
    ) -> Float[Array, ""]:
        def step(data: Any, _: None) -> tuple[Any, None]:
            return mjx.step(physics, data), None

        def advance(data: Any, control: Float[Array, " C"]) -> tuple[Any, tuple[Array, Array]]:
            moved, _ = jax.lax.scan(step, data.replace(ctrl=control), None, length=substeps)
            return moved, (_state(data), _state(moved))

        data = blank.replace(qpos=start[: model.nq], qvel=start[model.nq :])
        _, (before, after) = jax.lax.scan(advance, data, controls)
        return (weights * reward(before, controls, after, dt)).sum()

    compiled = jax.jit(jax.grad(total))

    def slope(controls: np.ndarray, states: np.ndarray, weights: np.ndarray) -> np.ndarray:
        arguments = [jnp.asarray(part, jnp.float32) for part in (controls, states[0], weights)]
        return np.asarray(compiled(*arguments), float)

    return slope


def _state(data: Any) -> Float[Array, " S"]:
    return jnp.concatenate([data.qpos, data.qvel])
