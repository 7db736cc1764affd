"""Dispatch of calls of an emulator.

JAX arrays are run by JAX, and so is everything inside `jax.jit`, `jax.grad` and `jax.vmap`. All other arrays are
checked and run by the `backend`: in C if there is a program, otherwise in JAX.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.codegen.backend import backend
from neuroanimator.emulator.arrays import as_float32, as_jax, is_plain
from neuroanimator.emulator.c_emulator import CEmulator, c_emulator
from neuroanimator.emulator.checks import MAX_CONTROL, MAX_MAGNITUDE, check_motion, check_numbers
from neuroanimator.emulator.compiled import as_numpy, call_compiled, is_traced, of_rows
from neuroanimator.emulator.super_step import SuperStep, rollout, rollout_trusted, step, trust
from neuroanimator.errors import ArgumentError, ResourceError
from neuroanimator.state.arrays import AnyArray, as_rows
from neuroanimator.state.layout import Layout


def program_of(emulator: SuperStep) -> CEmulator | None:
    """Return the program that runs `emulator` in C, if the `backend` is C and there is one.

    Raises ResourceError if C is required, and there is none.
    """
    asked = backend()
    if asked == "jax":
        return None
    program = c_emulator(emulator)
    if program is None and asked == "c":
        raise ResourceError(
            "backend: wanted C, but this emulator has no program in C here. Install a C compiler (pip install "
            "'neuroanimator[compiler]' brings one), or use the backend auto."
        )
    return program


class Step:
    """A super step that can be called from Python, and inside `jax.jit`, `jax.grad` and `jax.vmap`."""

    def __init__(self, emulator: SuperStep):
        self._emulator = emulator
        self.__name__ = "step"
        self.__doc__ = type(self).__call__.__doc__

    def __repr__(self) -> str:
        emulator = self._emulator
        shapes = f"state ({emulator.state.size},), control ({emulator.control.size},)"
        return f"step({shapes}) of {emulator!r}"

    def __call__(self, state: ArrayLike, control: ArrayLike) -> Float[AnyArray, " S"]:
        """Return the state (S,) one super step after `state` (S,) under `control` (C,).

        For JAX arrays it is a JAX array, and differentiable; otherwise a NumPy array, computed by the `backend`.

        Raises ArgumentError for wrong shapes, and for arrays other than JAX's for what `rollout` refuses.
        """
        emulator = self._emulator
        if is_plain(state) and is_plain(control):
            program = program_of(emulator)
            if program is not None and program.takes_step(state, control):
                following, is_sound = program.step(as_float32(state), as_float32(control))
                if is_sound:
                    return following
        is_for_jax = _is_any_jax(state, control)
        begin = self._checked(state, emulator.state, "state", MAX_MAGNITUDE)
        held = self._checked(control, emulator.control, "control", MAX_CONTROL)
        if is_for_jax:
            return call_compiled(step, emulator, begin, held)
        program = program_of(emulator)
        if program is None:
            following = as_numpy(call_compiled(step, emulator, begin, held))
        else:
            following, _ = program.step(begin, held)
        if not isinstance(following, jax.core.Tracer):
            check_motion(np.stack([begin, following]), emulator.state)
        return following

    def _checked(self, vector: ArrayLike, layout: Layout, label: str, most: float) -> Any:
        shape = (layout.size,)
        if isinstance(vector, jax.Array) and np.shape(vector) == shape:
            return vector  # Checking its numbers would wait for them, and a tracer has none.
        if isinstance(vector, jax.core.Tracer) or np.shape(vector) != shape:
            raise ArgumentError(
                f"{label}: wanted {shape[0]} numbers, got shape {np.shape(vector)}. "
                "For many at once use jax.vmap(emulator.step), or rollout."
            )
        return check_numbers(vector, layout, label, most, _dtype(self._emulator))


def run_rollout(
    emulator: SuperStep, state: ArrayLike, controls: ArrayLike, *, may_diverge: bool
) -> Float[AnyArray, "*B F S"]:
    """Return `Emulator.rollout`."""
    if is_plain(state) and is_plain(controls):
        program = program_of(emulator)
        if program is not None and program.takes_rollout(state, controls):
            trajectory, is_sound = program.rollout(as_float32(state), as_float32(controls))
            if is_sound:
                return trajectory
    if is_traced((state, controls)):
        _check_shapes(emulator, np.shape(state), np.shape(controls))
        return _rollout(emulator, as_jax(state), as_jax(controls))
    start, held = _checked(emulator, state, controls)
    if _is_any_jax(state, controls):
        start, held = as_jax(start, start.dtype), as_jax(held, held.dtype)
    if not held.shape[-2]:
        return start[..., None, :]
    trajectory = _rollout(emulator, start, held)
    if not may_diverge:
        check_motion(np.asarray(trajectory), emulator.state)
    return trajectory


def _rollout(
    emulator: SuperStep, start: Float[AnyArray, "*B S"], controls: Float[AnyArray, "*B T C"]
) -> Float[AnyArray, "*B F S"]:
    """Return the trajectory from checked inputs, in arrays of the same library."""
    function = of_rows(quick_rollout) if start.ndim == 2 else quick_rollout
    if isinstance(start, jax.Array):
        return call_compiled(function, emulator, start, controls)
    program = program_of(emulator)
    if program is None:
        return as_numpy(call_compiled(function, emulator, start, controls))
    return program.rollout(start, controls)[0]


def quick_rollout(
    emulator: SuperStep, state: Float[Array, " S"], controls: Float[Array, "T C"]
) -> Float[Array, "T+1 S"]:
    """Return `rollout` without unrolling: a tenth slower, but compiled in a third of the time."""
    return rollout(emulator, state, controls, unroll=1)


def run_rollout_trusted(
    emulator: SuperStep, state: ArrayLike, controls: ArrayLike, *, may_diverge: bool
) -> tuple[Float[np.ndarray, "*B F S"], Float[np.ndarray, "*B T"]]:
    """Return `Emulator.rollout_trusted`."""
    start, held = _checked(emulator, state, controls)
    batch = start.shape[:-1]
    starts = as_rows(start)
    rows = starts, held.reshape(len(starts), *held.shape[-2:])
    trajectories, scores = _run_rows(emulator, CEmulator.rollouts_trusted, rollout_trusted, rows)
    trajectory = trajectories.reshape(*batch, *trajectories.shape[1:])
    if not may_diverge:
        check_motion(trajectory, emulator.state)
    scores = scores.reshape(*batch, held.shape[-2])
    return trajectory, np.where(np.isfinite(scores), scores, np.inf)


def run_trust(
    emulator: SuperStep, state: ArrayLike, control: ArrayLike
) -> Float[np.ndarray, " *B"]:
    """Return `Emulator.trust`."""
    states = emulator.state.check_shape(state, "state")
    controls = emulator.control.check_shape(control, "control")
    if states.shape[:-1] != controls.shape[:-1]:
        raise ArgumentError(
            f"state and control: wanted as many of one as of the other, got {states.shape} with {controls.shape}."
        )
    rows = as_rows(as_float32(states)), as_rows(as_float32(controls))
    scores = _run_rows(emulator, CEmulator.trust, trust, rows)
    scores = np.asarray(scores).reshape(states.shape[:-1])
    is_number = (np.abs(states) <= MAX_MAGNITUDE).all(axis=-1)
    is_number &= np.isfinite(controls).all(axis=-1) & np.isfinite(scores)
    return np.where(is_number, scores, np.inf)


def _run_rows(
    emulator: SuperStep,
    in_c: Callable[..., Any],
    in_jax: Callable[..., Any],
    rows: tuple[Float[np.ndarray, "N ..."], ...],
) -> Any:
    """Return a function of each row, by the `backend`: a method of `CEmulator`, or a JAX function of one row."""
    program = program_of(emulator)
    if program is not None:
        return in_c(program, *rows)
    return jax.tree.map(as_numpy, call_compiled(of_rows(in_jax), emulator, *rows))


def _checked(
    emulator: SuperStep, state: ArrayLike, controls: ArrayLike
) -> tuple[Float[np.ndarray, "*B S"], Float[np.ndarray, "*B T C"]]:
    """Return both, checked, in the emulator's own number type."""
    dtype = _dtype(emulator)
    start = check_numbers(state, emulator.state, "state", MAX_MAGNITUDE, dtype)
    held = check_numbers(controls, emulator.control, "controls", MAX_CONTROL, dtype)
    _check_shapes(emulator, start.shape, held.shape)
    return start, held


def _dtype(emulator: SuperStep) -> Any:
    """Return the dtype of an emulator's numbers."""
    return emulator.normaliser.change_scale.dtype


def _is_any_jax(*arrays: ArrayLike) -> bool:
    return any(isinstance(array, jax.Array) for array in arrays)


def _check_shapes(emulator: SuperStep, state: tuple[int, ...], controls: tuple[int, ...]) -> None:
    """Refuse shapes that are not (S,) with (T, C), or (B, S) with (B, T, C)."""
    sizes = (*state[-1:], *controls[-1:])
    if (
        len(state) not in (1, 2)
        or len(controls) != len(state) + 1
        or state[:-1] != controls[:-2]
        or sizes != (emulator.state.size, emulator.control.size)
    ):
        raise ArgumentError(
            f"state and controls: wanted (S,) with (T, C) or (B, S) with (B, T, C), "
            f"got {state} with {controls}."
        )
