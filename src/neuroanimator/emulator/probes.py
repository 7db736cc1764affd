"""What a program must do to be an emulator: what JAX does of a thousand states, to the rounding of float32."""

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
from neuroanimator.files.remembered import UNKNOWN, Remembered
from neuroanimator.state.arrays import as_rows

MOTIONS = 40
"""Random motions whose states are tried."""

STEPS = 25
"""Super steps of each: a thousand states in all."""

STRETCHES = (1.0, 1.0, 1.5, 3.0)
"""How far states are taken from rest: beyond the domain's borders, where features are cut off, too."""

LARGEST = 1e4
"""States with larger numbers are no test of anything but rounding."""

TOLERANCE = 1e-4
"""Relative to the largest number of each entry: both sum float32 in orders of their own."""

ROUNDING = 2.0**-22
"""Share of its size by which an input is changed, at most, to see what rounding does in JAX alone."""

DOUBTS = 10
"""Multiple of what rounding does in JAX alone that is no error: where a state hangs by a hair, it does much."""

BORDERLINE = 0.01
"""Share of answers yes or no that may differ: a number at its border is rounded to either side."""


def rounded(numbers: Float[np.ndarray, "N ..."], draw: int = 0) -> Float[np.ndarray, "N ..."]:
    """Return `numbers` changed at random in their last places, to see what rounding does in JAX alone.

    Small ones and zeros are changed as the usual number of their column is: what is computed of them has a size of its
    own, and at a joint's stop or at rest a zero decides on which side of a kink a row lies. Another `draw` changes
    them otherwise.
    """
    rng = np.random.default_rng(draw)
    sizes = np.abs(numbers)
    usual = np.median(np.where(np.isfinite(sizes), sizes, 0), axis=0)
    changes = ROUNDING * rng.uniform(-1, 1, numbers.shape) * np.maximum(sizes, usual)
    return (numbers + changes).astype(np.float32)


@dataclass(frozen=True)
class Expected:
    """Rows of numbers as JAX computes them, and how nearly a program must."""

    rows: Float[np.ndarray, "N M"]
    size: Float[np.ndarray, "N M"]
    """What an error is compared with."""
    doubt: Float[np.ndarray, "N 1"]
    """How much rounding changes a row in JAX itself, over each entry's size."""

    @classmethod
    def of(cls, rows: Float[np.ndarray, "N M"], otherwise: Float[np.ndarray, "N M"]) -> Expected:
        """Return it from what JAX makes of inputs, and of the same `rounded`."""
        size = np.abs(rows) + np.abs(rows).max(axis=0, initial=1e-3)
        doubt = np.abs(otherwise - rows) / size
        return cls(rows, size, doubt.max(axis=1, keepdims=True))

    def agrees(self, computed: Float[np.ndarray, "N M"]) -> bool:
        """Return whether the rows `computed` by a program are these."""
        off = np.abs(computed - self.rows) / self.size
        return bool((off <= TOLERANCE + DOUBTS * self.doubt).all())


@dataclass(frozen=True)
class Probes:
    """States of random motions, some far beyond what training showed, with what JAX makes of them."""

    states: Float[np.ndarray, "N S"]
    controls: Float[np.ndarray, "N C"]
    """Within the bounds and at them."""
    expected: Expected
    """One super step later."""
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
            raise WrongProgramError("Generated C does not do what the emulator does in JAX.")

    def compare_trust(self, computed: Float[np.ndarray, " N"]) -> None:
        """Raise WrongProgramError unless the scores are the expected ones."""
        if not self.trust.agrees(computed[:, None]):
            raise WrongProgramError("Generated C trusts other states than the emulator in JAX.")


_known: Remembered[Probes] = Remembered()
"""The probes of each emulator: several programs are held against them."""


_one_at_a_time = threading.Lock()
"""JAX on a CPU was seen to wait for ever where two threads computed probes: besides, one computes them for both."""


def probes_of(emulator: SuperStep) -> Probes:
    """Return the probes of `emulator`, remembered as long as it lives."""
    with _one_at_a_time:
        known = _known.of(emulator)
        if known is not UNKNOWN:
            return known
        return _known.keep(Probes.of(emulator), emulator)
