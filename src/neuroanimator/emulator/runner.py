"""Dispatch of calls of an emulator.

JAX arrays are run by JAX, and so is everything inside `jax.jit`, `jax.grad` and `jax.vmap`. All other arrays are
checked and run by the `backend`: in C if there is a program, otherwise in JAX.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.codegen.backend import backend
from neuroanimator.emulator.arrays import (
    as_float32,
    as_jax,
    as_state,
    is_plain,
    state_type,
    too_large_is_infinite,
)
from neuroanimator.emulator.c_emulator import CEmulator, c_emulator
from neuroanimator.emulator.checks import MAX_CONTROL, MAX_MAGNITUDE, check_motion, check_numbers
from neuroanimator.emulator.compiled import as_numpy, call_compiled, is_traced, of_rows
from neuroanimator.emulator.origin import on_grid
from neuroanimator.emulator.super_step import (
    RelativePath,
    SuperStep,
    joined,
    rollout,
    rollout_relative,
    step,
)
from neuroanimator.errors import ArgumentError, ResourceError
from neuroanimator.state.arrays import AnyArray, as_rows
from neuroanimator.state.layout import Layout

QUICK = partial(rollout, unroll=1)
"""`rollout` without unrolling: a tenth slower, but compiled in a third of the time."""

TRUSTED = partial(rollout_relative, is_trusted=True)
"""`rollout_relative` with scores."""


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


class StepCall:
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

        For JAX arrays it is a JAX array, and differentiable; otherwise a NumPy array, computed by the `backend`: float32 if
        `state` is, else float64.

        Raises ArgumentError for wrong shapes, and for arrays other than JAX's for what `rollout` refuses.
        """
        emulator = self._emulator
        shapes = ((emulator.state.size,), (emulator.control.size,))
        if is_plain(state) and is_plain(control) and (state.shape, control.shape) == shapes:
            program = program_of(emulator)
            if program is not None:
                following, is_sound = program.step(as_state(state), as_float32(control))
                if is_sound:
                    return following
        dtype = _dtype(emulator)
        begin = _checked_vector(state, emulator.state, "state", MAX_MAGNITUDE, state_type(state))
        held = _checked_vector(control, emulator.control, "control", MAX_CONTROL, dtype)
        if _is_any_jax(begin, held):
            return call_compiled(step, emulator, as_jax(begin, dtype), as_jax(held, dtype))
        return _checked_trajectory(emulator, begin, held[None])[1]


def _checked_vector(
    vector: ArrayLike, layout: Layout, label: str, most: float, dtype: Any
) -> Float[AnyArray, " S"]:
    shape = np.shape(vector)
    if shape != (layout.size,):
        raise ArgumentError(
            f"{label}: wanted {layout.size} numbers, got shape {shape}. "
            "For many at once use jax.vmap(emulator.step), or rollout."
        )
    if isinstance(vector, jax.Array):
        return vector  # Checking its numbers would wait for them, and a tracer has none.
    return check_numbers(vector, layout, label, most, dtype)


def run_rollout(
    emulator: SuperStep, state: ArrayLike, controls: ArrayLike, *, may_diverge: bool
) -> Float[AnyArray, "*B F S"]:
    """Return `Emulator.rollout`."""
    if (
        is_plain(state)
        and is_plain(controls)
        and state.size
        and _are_shapes(emulator, state.shape, controls.shape)
    ):
        program = program_of(emulator)
        if program is not None:
            trajectory, is_sound = program.rollout(as_state(state), as_float32(controls))
            if is_sound:
                return trajectory
    if is_traced((state, controls)):
        _check_shapes(emulator, np.shape(state), np.shape(controls))
        return _in_jax(emulator, state, controls)
    start, held = _checked(emulator, state, controls)
    if not held.shape[-2]:
        return start[..., None, :]
    if not _is_any_jax(state, controls):
        return _checked_trajectory(emulator, start, held, may_diverge=may_diverge)
    trajectory = _in_jax(emulator, start, held)
    if not may_diverge:
        check_motion(np.asarray(trajectory), emulator.state)
    return trajectory


def _in_jax(emulator: SuperStep, state: ArrayLike, controls: ArrayLike) -> Float[Array, "*B F S"]:
    """Return the trajectory as a JAX array."""
    dtype = _dtype(emulator)
    function = of_rows(QUICK) if np.ndim(state) == 2 else QUICK
    return call_compiled(function, emulator, as_jax(state, dtype), as_jax(controls, dtype))


def _checked_trajectory(
    emulator: SuperStep,
    start: Float[np.ndarray, "*B S"],
    controls: Float[np.ndarray, "*B T C"],
    *,
    may_diverge: bool = False,
) -> Float[AnyArray, "*B F S"]:
    """Return the trajectory from checked inputs by the `backend`."""
    program = program_of(emulator)
    if program is None:
        trajectory, _ = _by_jax(emulator, rollout_relative, start, controls)
        is_sound = isinstance(trajectory, jax.core.Tracer)
    else:
        trajectory, is_sound = program.rollout(start, controls)
    if not may_diverge and not is_sound:
        check_motion(trajectory, emulator.state)
    return trajectory


def _by_jax(
    emulator: SuperStep,
    function: Callable[..., RelativePath],
    start: Float[np.ndarray, "*B S"],
    controls: Float[np.ndarray, "*B T C"],
) -> tuple[Float[AnyArray, "*B F S"], Float[AnyArray, "*B T"]]:
    """Return (the trajectory of the type of `start`, the scores): JAX computes, and double precision joins them."""
    exact = start.astype(float)
    origin = emulator.origin.state.origin(exact)
    begin = emulator.origin.state.moved(exact, -origin).astype(_dtype(emulator))
    run = of_rows(function) if start.ndim == 2 else function
    path = RelativePath(*map(as_numpy, call_compiled(run, emulator, begin, controls)))
    if is_traced(path):
        return joined(emulator, start, path), path.scores
    way = on_grid(path.high.astype(float) + path.low)
    following = emulator.origin.together(origin[..., None, :] + way, path.states)
    states = np.concatenate([start[..., None, :], following.astype(start.dtype)], axis=-2)
    constant = list(emulator.parameter_entries)
    states[..., constant] = start[..., None, constant]
    return states, path.scores


def run_rollout_trusted(
    emulator: SuperStep, state: ArrayLike, controls: ArrayLike, *, may_diverge: bool
) -> tuple[Float[np.ndarray, "*B F S"], Float[np.ndarray, "*B T"]]:
    """Return `Emulator.rollout_trusted`."""
    start, held = _checked(emulator, state, controls)
    batch = start.shape[:-1]
    starts = as_rows(start)
    rows = starts, held.reshape(len(starts), *held.shape[-2:])
    trajectories, scores = _trusted(emulator, *rows)
    trajectory = trajectories.reshape(*batch, *trajectories.shape[1:])
    if not may_diverge:
        check_motion(trajectory, emulator.state)
    scores = scores.reshape(*batch, held.shape[-2])
    return trajectory, np.where(np.isfinite(scores), scores, np.inf)


def _trusted(
    emulator: SuperStep, starts: Float[np.ndarray, "B S"], controls: Float[np.ndarray, "B T C"]
) -> tuple[Float[np.ndarray, "B T+1 S"], Float[np.ndarray, "B T"]]:
    """Return (the trajectory from each of `starts`, the score of each super step) by the `backend`."""
    program = program_of(emulator)
    if program is None:
        return _by_jax(emulator, TRUSTED, starts, controls)
    return program.rollouts_trusted(starts, controls)


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
    with too_large_is_infinite():
        held = np.ascontiguousarray(as_rows(controls), _dtype(emulator))
        _, scores = _trusted(emulator, np.ascontiguousarray(as_rows(states)), held[:, None])
    scores = scores.reshape(states.shape[:-1])
    is_number = (np.abs(states) <= MAX_MAGNITUDE).all(axis=-1)
    is_number &= np.isfinite(controls).all(axis=-1) & np.isfinite(scores)
    return np.where(is_number, scores, np.inf)


def _checked(
    emulator: SuperStep, state: ArrayLike, controls: ArrayLike
) -> tuple[Float[np.ndarray, "*B S"], Float[np.ndarray, "*B T C"]]:
    """Return both, checked: the state in the type of the result, and controls in the emulator's own."""
    start = check_numbers(state, emulator.state, "state", MAX_MAGNITUDE, state_type(state))
    held = check_numbers(controls, emulator.control, "controls", MAX_CONTROL, _dtype(emulator))
    _check_shapes(emulator, start.shape, held.shape)
    return start, held


def _dtype(emulator: SuperStep) -> Any:
    """Return the dtype of an emulator's numbers."""
    return emulator.normaliser.change_scale.dtype


def _is_any_jax(*arrays: ArrayLike) -> bool:
    return any(isinstance(array, jax.Array) for array in arrays)


def _check_shapes(emulator: SuperStep, state: tuple[int, ...], controls: tuple[int, ...]) -> None:
    """Refuse shapes that are not (S,) with (T, C), or (B, S) with (B, T, C)."""
    if not _are_shapes(emulator, state, controls):
        raise ArgumentError(
            f"state and controls: wanted (S,) with (T, C) or (B, S) with (B, T, C), "
            f"got {state} with {controls}."
        )


def _are_shapes(emulator: SuperStep, state: tuple[int, ...], controls: tuple[int, ...]) -> bool:
    """Return whether the shapes are (S,) with (T, C), or (B, S) with (B, T, C)."""
    sizes = (emulator.state.size, emulator.control.size)
    are_one_or_many = len(state) in (1, 2) and len(controls) == len(state) + 1
    return are_one_or_many and (state[-1], controls[-1]) == sizes and state[:-1] == controls[:-2]
