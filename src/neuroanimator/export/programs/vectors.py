"""Test vectors: inputs within what training showed and at its borders, and what JAX makes of them.

A program that does not do the same with a thousand of them is not kept; some of them ship beside it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from neuroanimator.animation.motion import random_motion
from neuroanimator.control.policies.policy import Policy
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.export.programs.definition import Definition
from neuroanimator.state.layout import Bounds
from neuroanimator.storage.files import write_whole

MOTIONS = 20
"""Short random motions states are taken from."""

STEPS = 49
"""Super steps of each motion: with its start fifty states."""

COUNT = MOTIONS * (STEPS + 1)
"""Inputs a program is held against JAX in."""

KEPT = 100
"""Inputs that are written to a file."""

FURTHEST = 16.0
"""Times the way from rest that a state is moved to the border of what training showed, at most."""

HALVINGS = 12
"""Times the stretch on which the border lies is halved."""

BEYOND = 1.1
"""Times the way to the border of states that lie beyond it: there the domain's clip is at work."""

TOLERANCE = 1e-3
"""Difference allowed, in units of the output: both sides are float32, and order their sums differently."""

ROUNDING = 4 * float(np.finfo(np.float32).eps)
"""Difference allowed besides, as a share of the number itself."""

DIGITS = 9
"""Digits that tell every float32 from the next."""


@dataclass(frozen=True, eq=False)
class Vectors:
    """Inputs of a program, and its outputs as JAX computes them."""

    definition: Definition
    inputs: tuple[Float[np.ndarray, "N _"], ...]
    expected: Float[np.ndarray, "N O"]
    units: Float[np.ndarray, " O"]
    """What an error in each entry of the output is measured in: the part's largest change, or half a control's range."""

    @property
    def feeds(self) -> dict[str, np.ndarray]:
        """The inputs by their names."""
        names = [port.name for port in self.definition.inputs]
        return dict(zip(names, self.inputs, strict=True))

    @property
    def tolerance(self) -> Float[np.ndarray, " O"]:
        """The difference allowed in each entry of the output."""
        return TOLERANCE * self.units + ROUNDING * np.abs(self.expected).max(axis=0)

    def check(self, computed: Float[np.ndarray, "N O"], where: str) -> float:
        """Return the largest difference of what was `computed` elsewhere, in units of the output.

        Raises NeuroAnimatorError if one is larger than allowed.
        """
        differences = np.abs(computed.astype(float) - self.expected)
        is_wrong = ~(differences <= self.tolerance)  # NaN is wrong, too
        if is_wrong.any():
            row, entry = np.argwhere(is_wrong)[0]
            raise NeuroAnimatorError(
                f"{where} does not do what JAX does, so nothing was written: of {len(computed)} inputs "
                f"{is_wrong.any(axis=1).sum()} differ, the first in {self.definition.output.name}[{entry}], "
                f"{computed[row, entry]:g} for {self.expected[row, entry]:g}. Please report it."
            )
        return float((differences / np.maximum(self.units, ROUNDING)).max())

    def save(self, path: Path) -> None:
        """Write `KEPT` of the vectors to `path` as JSON: facts, inputs, the output, and what it may differ by."""
        kept = np.linspace(0, len(self.expected) - 1, KEPT).astype(int)
        inputs = {name: _rounded(array[kept]) for name, array in self.feeds.items()}
        content = {
            "facts": self.definition.facts,
            "inputs": inputs,
            "outputs": {self.definition.output.name: _rounded(self.expected[kept])},
            "tolerance": _rounded(self.tolerance),
        }
        write_whole(path, json.dumps(content, separators=(",", ":"), allow_nan=False).encode())


def make_vectors(definition: Definition, model: Emulator | Policy) -> Vectors:
    """Return `COUNT` inputs of `model`, the same each time, and what JAX makes of them in float32.

    Raises NeuroAnimatorError where that is not finite.
    """
    rng = np.random.default_rng(0)
    if isinstance(model, Policy):
        inputs = _policy_inputs(model, rng)
    else:
        inputs = _emulator_inputs(model, rng)
    arrays = tuple(array.astype(np.float32) for array in inputs)
    expected = np.asarray(jax.jit(jax.vmap(definition.function))(*arrays))
    if not np.isfinite(expected).all():
        raise NeuroAnimatorError(
            f"{definition.facts['system']}: numbers that are not finite follow from states like those it was trained "
            "on. Train it longer before exporting it."
        )
    if isinstance(model, Policy):
        units = model.emulator.bounds.half
    else:
        units = _largest_changes(model, expected - arrays[0])
    return Vectors(definition, arrays, expected, units)


def _emulator_inputs(emulator: Emulator, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return states (N, S) and controls (N, C)."""
    return _states(emulator), _within(emulator.bounds, rng)


def _policy_inputs(policy: Policy, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return states (N, S), phases (N, 1) and commands (N, 4)."""
    phases = rng.uniform(0, 2 * np.pi, (COUNT, 1))
    return _states(policy.emulator), phases, _within(policy.ranges, rng)


def _within(bounds: Bounds, rng: np.random.Generator) -> Float[np.ndarray, "N C"]:
    """Return random numbers between `bounds`, one in three rows at the bounds."""
    share = rng.uniform(-1, 1, (COUNT, len(bounds.low)))
    at_bounds = np.arange(COUNT) % 3 == 0
    share[at_bounds] = np.sign(share[at_bounds])
    return bounds.middle + share * bounds.half


def _states(emulator: Emulator) -> Float[np.ndarray, "N S"]:
    """Return states of random motions: half as they are, a quarter moved to the border of training, a quarter beyond."""
    seconds = STEPS * emulator.dt
    motions = [random_motion(emulator, seconds, seed) for seed in range(1, MOTIONS + 1)]
    states = np.concatenate(motions)
    to_border = _way_to_border(emulator, states)
    which = np.arange(len(states)) % 4
    stretch = np.where(which < 2, 1.0, np.where(which == 2, to_border, BEYOND * to_border))
    return _stretched(emulator, states, stretch)


def _way_to_border(emulator: Emulator, states: Float[np.ndarray, "N S"]) -> Float[np.ndarray, " N"]:
    """Return how often the way from rest to each of `states` leads to the border of what training showed."""
    near = np.zeros(len(states))
    far = np.full(len(states), FURTHEST)
    for _ in range(HALVINGS):
        middle = (near + far) / 2
        moved = _stretched(emulator, states, middle)
        is_covered = np.asarray(emulator.covers_encoded(emulator.encode(moved)))
        near = np.where(is_covered, middle, near)
        far = np.where(is_covered, far, middle)
    return near


def _stretched(
    emulator: Emulator, states: Float[np.ndarray, "N S"], stretch: Float[np.ndarray, " N"]
) -> Float[np.ndarray, "N S"]:
    """Return `states` moved away from rest, or towards it; quaternions stay of unit length."""
    moved = emulator.rest + stretch[:, None] * (states - emulator.rest)
    for entry, _ in emulator.state_structure.orientations:
        quaternion = moved[:, entry : entry + 4]
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    return moved


def _largest_changes(
    emulator: Emulator, changes: Float[np.ndarray, "N S"]
) -> Float[np.ndarray, " S"]:
    """Return for each entry of a state how much its part changes at most."""
    largest = []
    for part in emulator.state.slices:
        part_changes = emulator.state.part(changes, part.name)
        largest.append(np.full(part.size, np.abs(part_changes).max(), float))
    return np.concatenate(largest)


def _rounded(array: np.ndarray) -> list[Any]:
    """Return float32 numbers as lists, with as many digits as they have."""
    if array.ndim > 1:
        return [_rounded(row) for row in array]
    return [float(f"{number:.{DIGITS}g}") for number in array]
