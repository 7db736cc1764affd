"""Probes that check a program: JAX's results for a thousand states, to the rounding of float32."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import partial

import jax
import numpy as np
from jaxtyping import Float

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

    @classmethod
    def of(cls, rows: Float[np.ndarray, "N M"], otherwise: Float[np.ndarray, "N M"]) -> Expected:
        """Return it from JAX's results for inputs, and for the same inputs `rounded`."""
        size = np.abs(rows) + np.abs(rows).max(axis=0, initial=1e-3)
        doubt = np.abs(otherwise - rows) / size
        return cls(rows, size, doubt.max(axis=1, keepdims=True))

    def agrees(self, computed: Float[np.ndarray, "N M"]) -> bool:
        """Return whether the rows `computed` by a program agree with these."""
        off = np.abs(computed - self.rows) / self.size
        return bool((off <= TOLERANCE + DOUBTS * self.doubt).all())


@dataclass(frozen=True)
class Probes:
    """States of random motions, some far outside the training domain, with JAX's results for them."""

    states: Float[np.ndarray, "N S"]
    controls: Float[np.ndarray, "N C"]
    """Controls within the bounds and at them."""
    expected: Expected
    """States one super step later."""
    trust: Expected

    @classmethod
    def of(cls, emulator: SuperStep) -> Probes:
        """Return the probes of `emulator`."""
        rng = np.random.default_rng(0)
        shape = (MOTIONS, STEPS, emulator.control.size)
        shares = np.clip(rng.uniform(-1.5, 1.5, shape), -1, 1)
        bounds = emulator.bounds
        held = np.asarray(bounds.middle + shares * bounds.half, np.float32)
        rest = np.asarray(emulator.rest, np.float32)
        rollouts = compiled_quickly(jax.vmap(partial(rollout, unroll=1), (None, None, 0)))
        motions = rollouts(emulator, rest, held)
        stretch = np.resize(STRETCHES, MOTIONS).astype(np.float32)[:, None, None]
        stretched = rest + stretch * (np.array(motions)[:, :-1] - rest)
        states = stretched.reshape(-1, len(rest))
        controls = as_rows(held)
        steps = compiled_quickly(jax.vmap(step_trusted, (None, 0, 0)))
        expected, scores = map(np.asarray, steps(emulator, states, controls))
        otherwise, other_scores = map(np.asarray, steps(emulator, rounded(states), controls))
        is_sound = np.isfinite(expected).all(axis=1) & np.isfinite(otherwise).all(axis=1)
        is_sound &= (np.abs(states) < LARGEST).all(axis=1)
        return cls(
            states=states[is_sound],
            controls=controls[is_sound],
            expected=Expected.of(expected[is_sound], otherwise[is_sound]),
            trust=Expected.of(scores[is_sound, None], other_scores[is_sound, None]),
        )

    def compare(self, computed: Float[np.ndarray, "N S"]) -> None:
        """Raise WrongProgramError unless `computed` states are the expected ones."""
        if not self.expected.agrees(computed):
            raise WrongProgramError("Generated C disagrees with the emulator in JAX.")

    def compare_trust(self, computed: Float[np.ndarray, " N"]) -> None:
        """Raise WrongProgramError unless the scores are the expected ones."""
        if not self.trust.agrees(computed[:, None]):
            raise WrongProgramError("Trust scores in generated C disagree with those in JAX.")


_probes = Remembered(Probes.of)
"""Probes of each emulator, which several programs are checked with."""

_one_at_a_time = threading.Lock()
"""Lock for computing probes: JAX on a CPU was seen to deadlock when two threads did, and one result serves both."""


def probes_of(emulator: SuperStep) -> Probes:
    """Return the probes of `emulator`, remembered as long as it lives."""
    with _one_at_a_time:
        return _probes(emulator)
