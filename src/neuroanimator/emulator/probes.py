"""Probes that check a program: JAX's results for a thousand states, to the rounding of float32."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Shaped

from neuroanimator.codegen.jax_settings import compiled_quickly
from neuroanimator.codegen.kept import WrongProgramError
from neuroanimator.emulator.super_step import SuperStep, rollout, step_trusted
from neuroanimator.files.remembered import Remembered
from neuroanimator.state.arrays import as_rows

MOTIONS = 40
"""Number of random motions whose states are probes."""

STEPS = 25
"""Number of super steps of each motion: a thousand states in all."""

STRETCHES = (1.0, 1.0, 1.5, 3.0)
"""Factors by which states are moved away from rest: also beyond the training domain, where features are clipped."""

LARGEST = 1e4
"""Maximum magnitude of numbers in probes: larger ones test nothing but rounding."""

TOLERANCE = 1e-4
"""Tolerance relative to the largest number of each entry: C and JAX sum float32 in different orders."""

ROUNDING = 2.0**-22
"""Maximum relative change of an input that shows the effect of rounding in JAX alone."""

DOUBTS = 10
"""Multiple of the effect of rounding in JAX alone that counts as no error: near a kink, rounding has a large effect."""

BORDERLINE = 0.01
"""Share of boolean answers that may differ: a number at its threshold may be rounded to either side."""


def rounded(numbers: Float[np.ndarray, "N ..."], draw: int = 0) -> Float[np.ndarray, "N ..."]:
    """Return `numbers` changed at random in their last places, to show the effect of rounding in JAX alone.

    Small numbers and zeros are changed by as much as the median of their column: results computed from them can be large,
    and at a joint's stop or at rest a zero decides on which side of a kink a row lies. Each `draw` gives other
    changes.
    """
    rng = np.random.default_rng(draw)
    sizes = np.abs(numbers)
    usual = np.median(np.where(np.isfinite(sizes), sizes, 0), axis=0)
    changes = ROUNDING * rng.uniform(-1, 1, numbers.shape) * np.maximum(sizes, usual)
    return (numbers + changes).astype(np.float32)


@dataclass(frozen=True)
class Expected:
    """Rows of numbers as JAX computes them, and the tolerance for a program."""

    rows: Float[np.ndarray, "N M"]
    size: Float[np.ndarray, "N M"]
    """Scale of errors."""
    doubt: Float[np.ndarray, "N 1"]
    """Effect of rounding on a row in JAX itself, over each entry's size."""
    are_truths: bool
    """Whether they are truth values, as 0 and 1."""

    @classmethod
    def of(
        cls, values: Shaped[np.ndarray, "N ..."], otherwise: Shaped[np.ndarray, "N ..."]
    ) -> Expected:
        """Return it from JAX's results for inputs, and for the same inputs `rounded`."""
        rows = flat_rows(values).astype(float)
        size = np.abs(rows) + np.abs(rows).max(axis=0, initial=1e-3)
        doubt = np.abs(flat_rows(otherwise) - rows) / size
        return cls(rows, size, doubt.max(axis=1, keepdims=True), values.dtype == bool)

    def agrees(self, computed: Float[np.ndarray, "N M"]) -> bool:
        """Return whether the rows `computed` by a program agree with these."""
        if self.are_truths:
            return bool(np.mean((computed > 0) != self.rows) <= BORDERLINE)
        off = np.abs(computed - self.rows) / self.size
        return bool((off <= TOLERANCE + DOUBTS * self.doubt).all())


def flat_rows(values: Shaped[np.ndarray, "N ..."]) -> Shaped[np.ndarray, "N M"]:
    """Return an array as rows of numbers."""
    return values.reshape(len(values), -1)


@dataclass(frozen=True)
class Probes:
    """Rows of inputs of a function, and JAX's results for them."""

    name: str
    """Name of the function."""
    inputs: list[Float[np.ndarray, "N _"]]
    expected: list[Expected]
    """Of each output."""

    @classmethod
    def of(
        cls,
        name: str,
        function: Callable[..., tuple[Array, ...]],
        module: Any,
        inputs: Sequence[Float[np.ndarray, "N _"]],
    ) -> Probes:
        """Return the probes of `function` (module, vectors), those of `inputs` for which it gives finite numbers."""
        in_jax = compiled_quickly(jax.vmap(function, (None, *[0] * len(inputs))))
        exact = list(map(np.asarray, in_jax(module, *inputs)))
        rerun = list(map(np.asarray, in_jax(module, *map(rounded, inputs))))
        are_sound = np.ones(len(inputs[0]), bool)
        for values in (*exact, *rerun):
            are_sound &= np.isfinite(flat_rows(values)).all(axis=1)
        pairs = zip(exact, rerun, strict=True)
        expected = [Expected.of(*(values[are_sound] for values in pair)) for pair in pairs]
        return cls(name, [array[are_sound] for array in inputs], expected)

    def compare(self, *computed: Float[np.ndarray, "N _"]) -> None:
        """Raise WrongProgramError unless the outputs `computed` by a program, the first ones, agree."""
        for values, expected in zip(computed, self.expected, strict=False):
            if not expected.agrees(values):
                raise WrongProgramError(f"Generated C disagrees with {self.name} in JAX.")


@Remembered
def _probes(emulator: SuperStep) -> Probes:
    """Return the probes of a super step and its trust score: states of random motions, some far outside of training."""
    rng = np.random.default_rng(0)
    shape = (MOTIONS, STEPS, emulator.control.size)
    shares = np.clip(rng.uniform(-1.5, 1.5, shape), -1, 1)
    bounds = emulator.bounds
    held = np.asarray(bounds.middle + shares * bounds.half, np.float32)
    rest = np.asarray(emulator.rest, np.float32)
    rollouts = compiled_quickly(jax.vmap(partial(rollout, unroll=1), (None, None, 0)))
    motions = rollouts(emulator, rest, held)
    stretch = np.resize(STRETCHES, MOTIONS).astype(np.float32)[:, None, None]
    states = (rest + stretch * (np.array(motions)[:, :-1] - rest)).reshape(-1, len(rest))
    is_usual = (np.abs(states) < LARGEST).all(axis=1)
    inputs = [states[is_usual], as_rows(held)[is_usual]]
    return Probes.of("the emulator", step_trusted, emulator, inputs)


_one_at_a_time = threading.Lock()
"""Lock for computing probes: JAX on a CPU was seen to deadlock when two threads did, and one result serves both."""


def probes_of(emulator: SuperStep) -> Probes:
    """Return the probes of a super step of `emulator` and its trust score, remembered as long as it lives.

    Their inputs are states and controls.
    """
    with _one_at_a_time:
        return _probes(emulator)
