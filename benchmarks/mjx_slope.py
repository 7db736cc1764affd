"""Gradients of a return by MJX's own derivatives (`pip install mujoco-mjx`), for benchmarks; the package does not use it.

MJX differentiates its contact solver in reverse only if that has one iteration, which is different physics. Here the solver is
the model's own, with all its iterations: the Jacobians of a super step are taken forwards, one tangent for each entry of
state and control, and the slopes of rewards are propagated back through them.

Compiling takes longest, so it is of one super step, without optimisation, and the four stages of a Runge-Kutta step, which
MJX writes out one after another, are a loop.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.codegen.jax_settings import UNOPTIMISED

STAGES = (0.0, 0.5, 0.5, 1.0)
"""Time of each stage within a Runge-Kutta step of fourth order, in steps."""

SHARES = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
"""Weights of the stages."""


def is_installed() -> bool:
    """Return whether MJX is there."""
    return importlib.util.find_spec("mujoco.mjx") is not None


class Leap(NamedTuple):
    """A super step of MJX and its Jacobians."""

    after: Float[np.ndarray, " S"]
    by_state: Float[np.ndarray, "S S"]
    by_control: Float[np.ndarray, "S C"]


class Linearised:
    """MJX's super steps with their Jacobians, compiled for one model."""

    compile_seconds: float
    """Time of one core for tracing and compiling [s]."""

    def __init__(self, model: mujoco.MjModel, substeps: int):
        advance = _super_step(model, substeps)

        def twice(state: Array, control: Array) -> tuple[Array, Array]:
            after = advance(state, control)
            return after, after

        began = time.process_time()
        jacobians = jax.jit(jax.jacfwd(twice, argnums=(0, 1), has_aux=True))
        blanks = [jax.ShapeDtypeStruct((size,), jnp.float32) for size in _sizes(model)]
        self._compiled = jacobians.lower(*blanks).compile(compiler_options=UNOPTIMISED)
        self.compile_seconds = time.process_time() - began
        self._spent = 0.0
        self._count = 0

    @property
    def seconds(self) -> float:
        """Mean time of one core for a super step and its Jacobians [s]."""
        return self._spent / max(self._count, 1)

    def __call__(self, state: Float[np.ndarray, " S"], control: Float[np.ndarray, " C"]) -> Leap:
        """Return the super step from `state`."""
        began = time.process_time()
        inputs = [jnp.asarray(part, jnp.float32) for part in (state, control)]
        (by_state, by_control), after = self._compiled(*inputs)
        leap = Leap(*(np.asarray(part, float) for part in (after, by_state, by_control)))
        self._spent += time.process_time() - began
        self._count += 1
        return leap


def _sizes(model: mujoco.MjModel) -> tuple[int, int]:
    return model.nq + model.nv, model.nu


def _super_step(model: mujoco.MjModel, substeps: int) -> Callable[[Array, Array], Array]:
    """Return a function (state (S,), control (C,)) → the state after `substeps` Runge-Kutta steps."""
    from mujoco import mjx
    from mujoco.mjx._src.forward import _advance

    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    physics = mjx.put_model(model)
    blank = mjx.make_data(physics)
    tableau = (jnp.array(STAGES), jnp.array(SHARES))

    def moved(place: tuple, speed: Array, acceleration: Array) -> tuple[Array, Array]:
        """Return (positions, velocities) a step after `place`, at these rates."""
        data = blank.replace(qpos=place[0], qvel=place[1])
        data = _advance(physics, data, blank.act_dot, acceleration, speed)
        return data.qpos, data.qvel

    def step(control: Array, place: tuple, guess: Array) -> tuple[tuple, Array]:
        def stage(rates: tuple, row: tuple) -> tuple[tuple, None]:
            speed, acceleration, mean_speed, mean_acceleration = rates
            part, share = row
            qpos, qvel = moved(place, part * speed, part * acceleration)
            data = blank.replace(qpos=qpos, qvel=qvel, ctrl=control, qacc_warmstart=acceleration)
            data = mjx.forward(physics, data)
            mean_speed += share * qvel
            mean_acceleration += share * data.qacc
            return (qvel, data.qacc, mean_speed, mean_acceleration), None

        still = 0 * guess
        rates, _ = jax.lax.scan(stage, (still, guess, still, still), tableau)
        _, acceleration, mean_speed, mean_acceleration = rates
        return moved(place, mean_speed, mean_acceleration), acceleration

    def advance(state: Array, control: Array) -> Array:
        place = (state[: model.nq], state[model.nq :])
        # Zeros that depend on the state: JAX traces a loop anew when more of it turns out to have tangents.
        begun = (place, 0 * place[1])
        (place, _), _ = jax.lax.scan(
            lambda begun, _: (step(control, *begun), None), begun, None, length=substeps
        )
        return jnp.concatenate(place)

    return advance
