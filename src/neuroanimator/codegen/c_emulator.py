"""An emulator as a C program, generated from its definition in JAX and held against it."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from neuroanimator.codegen.c_function import HEAD, c_function
from neuroanimator.codegen.program import UnsupportedError
from neuroanimator.compiler.compiler import compiled_library, find_compiler
from neuroanimator.emulator.emulator import Emulator, rollout_latent
from neuroanimator.errors import NeuroAnimatorError

CHECKED_STEPS = 30
"""Super steps of a random motion that the program is held against JAX in."""

TOLERANCE = 1e-4
"""Relative to the largest number of the motion: both are float32, and order their sums differently."""


def c_program(emulator: Emulator) -> str:
    """Return C text of `play`: steps of `Emulator.step_latent` in float32, in the numbers of `Emulator.encode`.

    Only numbers and names of our own are written: none of the text an emulator carries reaches a compiler.
    """
    start, controls = emulator.encode_motion(emulator.rest, emulator.bounds.middle)
    (latent,) = start.shape
    (control,) = controls.shape
    super_step = c_function("super_step", emulator.step_latent, (latent,), (control,))
    return f"""/* A super step of {float(emulator.dt):g} s: {latent} numbers, {control} controls. */
{HEAD}{super_step}
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

    def play(
        self, start: Float[np.ndarray, " L"], controls: Float[np.ndarray, "T C"]
    ) -> Float[np.ndarray, " L"]:
        """Return the last latent state of the motion from `start` under `controls`."""
        play = self.player(start, controls)
        return play().copy()

    def player(
        self, start: Float[np.ndarray, " L"], controls: Float[np.ndarray, "T C"]
    ) -> Callable[[], Float[np.ndarray, " L"]]:
        """Return a function that does what `play` does in one call of C."""
        start = np.ascontiguousarray(start, np.float32)
        controls = np.ascontiguousarray(controls, np.float32)
        last = np.empty_like(start)
        steps = ctypes.c_long(len(controls))
        before, held, after = (
            array.ctypes.data_as(ctypes.c_void_p) for array in (start, controls, last)
        )

        def play() -> np.ndarray:
            self.library.play(before, held, steps, after)
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
    if library is None:
        return None
    program = CEmulator(library)
    _check(program, emulator)
    return program


def _check(program: CEmulator, emulator: Emulator) -> None:
    """Compare one super step from each state of a random motion, as long as it stays finite."""
    spec = emulator.spec
    share = np.random.default_rng(0).uniform(-1, 1, (CHECKED_STEPS, spec.control.size))
    random_controls = spec.bounds.middle + share * spec.bounds.half
    start, controls = emulator.encode_motion(spec.rest, random_controls)
    following = eqx.filter_jit(rollout_latent)(emulator, start, controls)
    states = np.asarray(jnp.concatenate([start[None], following]))
    is_finite_so_far = np.isfinite(states).all(axis=1).cumprod()
    expected = states[: int(is_finite_so_far.sum())]
    computed = [expected[0]]
    for state, held in zip(expected[:-1], np.asarray(controls), strict=False):
        computed.append(program.play(state, held[None]))
    tolerance = TOLERANCE * np.abs(expected).max()
    if not np.allclose(np.stack(computed), expected, rtol=TOLERANCE, atol=tolerance):
        raise NeuroAnimatorError(
            f"{spec.system}: the generated C does not do what the emulator does in JAX."
        )
