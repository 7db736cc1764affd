"""Gradients of a return by MJX's own derivatives (`pip install mujoco-mjx`), for benchmarks; the package does not use it.

MJX differentiates its contact solver in reverse only if that has one iteration, which is different physics. Here the solver is
the model's own, with all its iterations: the Jacobians of a super step are taken forwards, one tangent for each entry of
state and control, and the return is propagated back through them.

MJX writes out the four stages of a Runge-Kutta step one after another. Here they are a loop, so that `mjx.forward` is compiled
once. Compilation is the longest part, so XLA is told not to optimise.
"""

from __future__ import annotations

import importlib.util
import time
from typing import Any

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


class PhysicsSlope:
    """Slopes of weighted sums of rewards, along MJX's own rollouts of `steps` super steps."""

    compile_seconds: float
    """Time of one core for tracing and compiling [s]."""
    gradient_seconds: float = 0.0
    """Time of one core for the last slope [s]."""

    def __init__(self, model: mujoco.MjModel, substeps: int, reward: Any, dt: float, steps: int):
        leap = _super_step(model, substeps)

        def total(
            controls: Float[Array, "T C"], start: Float[Array, " S"], weights: Float[Array, " T"]
        ) -> Float[Array, ""]:
            def advance(state: Array, control: Array) -> tuple[Array, tuple[Array, Array]]:
                after = leap(state, control)
                return after, (state, after)

            _, (before, after) = jax.lax.scan(advance, start, controls)
            return (weights * reward(before, controls, after, dt)).sum()

        began = time.process_time()
        shapes = [(steps, model.nu), (model.nq + model.nv,), (steps,)]
        blanks = [jax.ShapeDtypeStruct(shape, jnp.float32) for shape in shapes]
        lowered = jax.jit(jax.grad(total)).lower(*blanks)
        self._compiled = lowered.compile(compiler_options=UNOPTIMISED)
        self.compile_seconds = time.process_time() - began

    def __call__(
        self,
        controls: Float[np.ndarray, "T C"],
        states: Float[np.ndarray, "T+1 S"],
        weights: Float[np.ndarray, " T"],
    ) -> Float[np.ndarray, "T C"]:
        """Return the slope by the controls, from the first of the `states`."""
        began = time.process_time()
        arguments = [jnp.asarray(part, jnp.float32) for part in (controls, states[0], weights)]
        slope = np.asarray(self._compiled(*arguments), float)
        self.gradient_seconds = time.process_time() - began
        return slope


def _super_step(model: mujoco.MjModel, substeps: int) -> Any:
    """Return a function (state (S,), control (C,)) → the state after `substeps` steps, differentiable in reverse."""
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

    def step(control: Array, begun: tuple) -> tuple:
        place, guess = begun

        def stage(rates: tuple, row: tuple) -> tuple[tuple, None]:
            speed, acceleration, mean_speed, mean_acceleration = rates
            part, share = row
            qpos, qvel = moved(place, part * speed, part * acceleration)
            data = blank.replace(qpos=qpos, qvel=qvel, ctrl=control, qacc_warmstart=acceleration)
            data = mjx.forward(physics, data)
            mean_speed += share * qvel
            mean_acceleration += share * data.qacc
            return (qvel, data.qacc, mean_speed, mean_acceleration), None

        # Zeros that depend on the state: JAX traces a loop anew for every part of it that turns out to have a tangent.
        still = 0 * place[1]
        rates, _ = jax.lax.scan(stage, (still, guess, still, still), tableau)
        _, acceleration, mean_speed, mean_acceleration = rates
        return moved(place, mean_speed, mean_acceleration), acceleration

    def advanced(state: Array, control: Array) -> Array:
        place = (state[: model.nq], state[model.nq :])
        begun = (place, 0 * place[1])
        (place, _), _ = jax.lax.scan(
            lambda begun, _: (step(control, begun), None), begun, None, length=substeps
        )
        return jnp.concatenate(place)

    def forwards(state: Array, control: Array) -> tuple[Array, tuple[Array, Array]]:
        def twice(state: Array, control: Array) -> tuple[Array, Array]:
            after = advanced(state, control)
            return after, after

        jacobians, after = jax.jacfwd(twice, argnums=(0, 1), has_aux=True)(state, control)
        return after, jacobians

    def backwards(jacobians: tuple[Array, Array], later: Array) -> tuple[Array, Array]:
        by_state, by_control = jacobians
        return later @ by_state, later @ by_control

    leap = jax.custom_vjp(advanced)
    leap.defvjp(forwards, backwards)
    return leap
