"""An emulator as a C program, generated from its definition in JAX and held against it."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from neuroanimator.codegen.c_function import HEAD, c_function
from neuroanimator.codegen.program import UnsupportedError
from neuroanimator.compiler.compiler import compiled_library, find_compiler
from neuroanimator.emulator.emulator import Emulator, rollout_latent
from neuroanimator.errors import NeuroAnimatorError

CHECKED_STEPS = 30
TOLERANCE = 1e-4
"""Relative: both are float32, and order their sums differently."""


def c_program(emulator: Emulator) -> str:
    """Return C text of `play`: steps of `Emulator.step_latent` in float32, in the numbers of `Emulator.encode`.

    Only numbers and names of our own are written: none of the text an emulator carries reaches a compiler.
    """
    start, controls = emulator.encode_motion(emulator.rest, emulator.bounds.middle)
    (latent,), (control,) = start.shape, controls.shape
    return f"""/* A super step of {float(emulator.dt):g} s: {latent} numbers, {control} controls. */
{HEAD}{c_function("super_step", emulator.step_latent, (latent,), (control,))}
/* `steps` super steps under (steps, {control}) controls; `after` has the last. */
void play(const float *before, const float *controls, long steps, float *after) {{
float now[{latent}];
memcpy(now, before, sizeof now);
for (long t = 0; t < steps; t++) super_step(now, controls + t * {control}, now);
memcpy(after, now, sizeof now);
}}
"""


@dataclass(frozen=True, eq=False)
class CEmulator:
    """A compiled emulator. All numbers are those of `Emulator.encode` and `encode_control`, in float32."""

    library: ctypes.CDLL

    def play(self, start: np.ndarray, controls: np.ndarray) -> np.ndarray:
        """Return the last state (I,) of the motion from `start` (I,) under `controls` (T, C)."""
        return self.player(start, controls)().copy()

    def player(self, start: np.ndarray, controls: np.ndarray) -> Callable[[], np.ndarray]:
        """Return a function that does what `play` does in one call of C."""
        start, controls = (np.ascontiguousarray(each, np.float32) for each in (start, controls))
        last = np.empty_like(start)
        arrays = [each.ctypes.data_as(ctypes.c_void_p) for each in (start, controls, last)]

        def play() -> np.ndarray:
            self.library.play(arrays[0], arrays[1], ctypes.c_long(len(controls)), arrays[2])
            return last

        return play


def c_emulator(emulator: Emulator) -> CEmulator | None:
    """Return the emulator as compiled C; None where there is no C compiler, or no C for what the emulator does.

    Raises NeuroAnimatorError if the program does not do what JAX does.
    """
    if find_compiler() is None:
        return None
    try:
        library = compiled_library(c_program(emulator))
    except UnsupportedError:
        return None
    found = library and CEmulator(library)
    if found:
        _check(found, emulator)
    return found


def _check(program: CEmulator, emulator: Emulator) -> None:
    """Compare one super step from each state of a random motion, as long as it stays finite."""
    spec = emulator.spec
    share = np.random.default_rng(0).uniform(-1, 1, (CHECKED_STEPS, spec.control.size))
    start, controls = emulator.encode_motion(
        spec.rest, spec.bounds.middle + share * spec.bounds.half
    )
    states = np.asarray(
        jnp.concatenate([start[None], eqx.filter_jit(rollout_latent)(emulator, start, controls)])
    )
    finite = states[: int(np.isfinite(states).all(axis=1).cumprod().sum())]
    pairs = zip(finite[:-1], np.asarray(controls)[: len(finite) - 1, None], strict=True)
    found = np.stack([finite[0], *(program.play(*each) for each in pairs)])
    if not np.allclose(found, finite, rtol=TOLERANCE, atol=TOLERANCE * np.abs(finite).max()):
        raise NeuroAnimatorError(
            f"{spec.system}: the generated C does not do what the emulator does in JAX."
        )
