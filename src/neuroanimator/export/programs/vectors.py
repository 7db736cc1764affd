"""Test vectors: inputs within the training data and at its borders, and their outputs by JAX.

A program that differs on one of a thousand of them is not kept; some of them ship beside it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from neuroanimator.animation.motion import random_drive
from neuroanimator.codegen.jax_settings import compiled_quickly
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.probes import rounded
from neuroanimator.emulator.trust import EDGE
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.export.programs.definition import (
    PHASE,
    Model,
    ProgramDefinition,
    emulator_of,
)
from neuroanimator.state.layout import Bounds, Layout

MOTIONS = 24
"""Number of short random motions that states are taken from."""

STEPS = 49
"""Number of super steps of each motion: with its start, fifty states."""

COUNT = 1000
"""Maximum number of inputs on which a program is checked against JAX."""

KEPT = 50
"""Number of inputs written to a file."""

FURTHEST = 16.0
"""Maximum factor by which a state is moved away from rest to the border of training."""

HALVINGS = 12
"""Number of bisections in the search for the border."""

BEYOND = 1.1
"""Distance from rest of states beyond the border, over that of the border: there the domain's clip is at work."""

OFF_BOUNDS = 0.97
"""Largest control in tests of gradients, over the bounds, measured from their middle."""

DRAWS = 8
"""Number of perturbations of an input's last digits to see whether an output depends on them: at a kink, half of them
lead to the other side."""

MAX_DOUBT = 2e-4
"""Largest change of an output under these perturbations, in its unit, for an input to be a test."""

MIN_SHARE = 0.5
"""Minimum share of `COUNT` that must remain."""

TOLERANCE = 1e-3
"""Tolerance in units of the output: both sides are float32, and order their sums differently."""

ROUNDING = 4 * float(np.finfo(np.float32).eps)
"""Additional relative tolerance."""

DIGITS = 9
"""Number of digits that distinguish every float32 from the next."""

Arrays = dict[str, np.ndarray]
"""Inputs or outputs (N, _) by name."""


@dataclass(frozen=True, eq=False)
class Vectors:
    """Inputs of a function, by name, and its outputs as JAX computes them."""

    inputs: dict[str, Float[np.ndarray, "N _"]]
    expected: dict[str, Float[np.ndarray, "N _"]]
    units: dict[str, Float[np.ndarray, "N _"]]
    """Unit of the error in each entry: a part's largest change, half a control's range, or a score above 1 itself."""

    @property
    def count(self) -> int:
        """Number of inputs."""
        return len(next(iter(self.expected.values())))

    def tolerance(self, output: str) -> Float[np.ndarray, "N _"]:
        """Return the tolerance of each entry of an output."""
        rounding = ROUNDING * np.abs(self.expected[output]).max(axis=0)
        return TOLERANCE * self.units[output] + rounding

    def check(self, computed: dict[str, Float[np.ndarray, "N _"]], where: str) -> float:
        """Return the largest difference of the outputs `computed` elsewhere, in units of the outputs.

        Raises NeuroAnimatorError if one is above its tolerance.
        """
        largest = 0.0
        for output, expected in self.expected.items():
            found = computed[output]
            differences = np.abs(found.astype(float) - expected)
            is_wrong = ~(differences <= self.tolerance(output))  # NaN is wrong, too
            if is_wrong.any():
                row, entry = np.argwhere(is_wrong)[0]
                raise NeuroAnimatorError(
                    f"{where} disagrees with JAX, so nothing was written: of {self.count} inputs "
                    f"{is_wrong.any(axis=1).sum()} differ, the first in {output}[{entry}], "
                    f"{found[row, entry]:g} for {expected[row, entry]:g}. Please report it."
                )
            share = differences / np.maximum(self.units[output], ROUNDING)
            largest = max(largest, float(share.max(initial=0)))
        return largest

    def to_json(self) -> dict[str, Any]:
        """Return `KEPT` of the inputs and outputs, and the largest tolerance of each entry of an output."""
        kept = np.linspace(0, self.count - 1, KEPT).astype(int)
        return {
            "inputs": {name: _rounded(array[kept]) for name, array in self.inputs.items()},
            "outputs": {name: _rounded(array[kept]) for name, array in self.expected.items()},
            "tolerance": {
                name: _rounded(self.tolerance(name).max(axis=0)) for name in self.expected
            },
        }


def vectors_text(definition: ProgramDefinition, functions: Mapping[str, Vectors]) -> str:
    """Return the facts and the vectors of each function, by name, as JSON."""
    content: dict[str, Any] = {"facts": definition.facts}
    for name, vectors in functions.items():
        content[name] = vectors.to_json()
    return json.dumps(content, separators=(",", ":"), allow_nan=False)


def make_vectors(definition: ProgramDefinition, model: Model) -> Vectors:
    """Return `COUNT` inputs of `model`, the same each time, and JAX' outputs in float32.

    Raises NeuroAnimatorError if these are too often not finite, or depend on the last digits of the inputs.
    """
    emulator = emulator_of(model)
    inputs = _inputs_of(definition, emulator)

    def units(inputs: Arrays, outputs: Arrays) -> Arrays:
        scales: Arrays = {}
        for name, array in outputs.items():
            if name == "control":
                scales[name] = np.array(emulator.bounds.half)
            elif name == "trust":
                scales[name] = np.maximum(EDGE, array)
            else:
                scales[name] = _largest_in_part(emulator.state, array - inputs["state"])
        return scales

    def function(*arrays: Array) -> dict[str, Array]:
        outputs = definition.function(*arrays)
        return dict(zip(definition.output_names, outputs, strict=True))

    return _steady_vectors(function, inputs, units, definition.facts["system"])


def make_gradient_vectors(
    definition: ProgramDefinition, emulator: Emulator, vectors: Vectors
) -> Vectors:
    """Return the inputs of `vectors` with random cotangents, and JAX' vector-Jacobian products.

    Controls stay off their bounds: at a kink there are two gradients, and rounding chooses. Raises as `make_vectors`.
    """
    rng = np.random.default_rng(1)
    states = vectors.inputs["state"]
    bounds = emulator.bounds
    controls = bounds.middle + OFF_BOUNDS * (vectors.inputs["control"] - bounds.middle)
    inputs = {
        "state": states,
        "control": controls.astype(np.float32),
        "cotangent": rng.normal(size=states.shape).astype(np.float32),
    }

    def units(inputs: Arrays, outputs: Arrays) -> Arrays:
        return {
            "by_state": _largest_in_part(emulator.state, outputs["by_state"]),
            "by_control": _largest_in_part(emulator.control, outputs["by_control"]),
        }

    def gradient(
        state: Float[Array, " S"], control: Float[Array, " C"], cotangent: Float[Array, " S"]
    ) -> dict[str, Array]:
        _, pull_back = jax.vjp(definition.function, state, control)
        by_state, by_control = pull_back((cotangent,))
        return {"by_state": by_state, "by_control": by_control}

    return _steady_vectors(gradient, inputs, units, emulator.system)


def _steady_vectors(
    function: Callable[..., dict[str, Array]],
    inputs: Arrays,
    units: Callable[[Arrays, Arrays], Arrays],
    system: str,
) -> Vectors:
    """Return the vectors of `function`, at most `COUNT`, for the `inputs` that are a fair test.

    Left out are inputs where JAX itself gives NaN, or another output when their last digits change: at a kink (an end
    of a clip, the larger of two) JAX' slope is that of one side or the other, and at the kink itself their mean.
    Programs have the same conditions from JAX, but round the compared numbers in another order.
    """
    run = compiled_quickly(jax.vmap(function))
    outputs = _as_numpy(run(*inputs.values()))
    others = []
    for draw in range(DRAWS):
        others.append(_as_numpy(run(*(rounded(array, draw) for array in inputs.values()))))
    is_finite = _all_rows(outputs)
    for arrays in (outputs, *others):
        for array in arrays.values():
            is_finite &= np.isfinite(array).all(axis=1)
    inputs = _rows(inputs, is_finite)
    outputs = _rows(outputs, is_finite)
    if is_finite.any():
        scales = {
            name: np.broadcast_to(unit, outputs[name].shape)
            for name, unit in units(inputs, outputs).items()
        }
        is_steady = _all_rows(outputs)
        for changed in others:
            is_steady &= _are_near(outputs, _rows(changed, is_finite), scales)
        chosen = np.flatnonzero(is_steady)[:COUNT]
        if len(chosen) >= MIN_SHARE * COUNT:
            return Vectors(*(_rows(arrays, chosen) for arrays in (inputs, outputs, scales)))
    raise NeuroAnimatorError(
        f"{system}: from most states like those it was trained on, its results are not finite, or depend on rounding. "
        "Train it longer before exporting it."
    )


def _are_near(outputs: Arrays, others: Arrays, scales: Arrays) -> Bool[np.ndarray, " N"]:
    """Return the rows in which all outputs are near the others, up to rounding."""
    are_near = _all_rows(outputs)
    for name, output in outputs.items():
        rounding = ROUNDING * np.abs(output).max(axis=0)
        off = np.abs(output - others[name])
        are_near &= (off <= MAX_DOUBT * scales[name] + rounding).all(axis=1)
    return are_near


def _all_rows(arrays: Arrays) -> Bool[np.ndarray, " N"]:
    return np.ones(len(next(iter(arrays.values()))), bool)


def _as_numpy(arrays: dict[str, Array]) -> Arrays:
    return {name: np.asarray(array) for name, array in arrays.items()}


def _rows(arrays: Arrays, chosen: np.ndarray) -> Arrays:
    """Return some rows of every array, contiguous, by a mask or by numbers."""
    return {name: np.ascontiguousarray(array[chosen]) for name, array in arrays.items()}


def _inputs_of(definition: ProgramDefinition, emulator: Emulator) -> Arrays:
    """Return rows of each input, by name: states, phases, and controls or commands within their bounds."""
    rng = np.random.default_rng(0)
    inputs: Arrays = {}
    for port in definition.inputs:
        if port.name == "state":
            rows = _states(emulator)
        elif port.layout is PHASE:
            rows = rng.uniform(0, 2 * np.pi, (MOTIONS * (STEPS + 1), 1))
        else:
            low = tuple(definition.facts[f"{port.name}_low"])
            high = tuple(definition.facts[f"{port.name}_high"])
            rows = _within(Bounds(low, high), rng)
        inputs[port.name] = rows.astype(np.float32)
    return inputs


def _within(bounds: Bounds, rng: np.random.Generator) -> Float[np.ndarray, "N C"]:
    """Return random numbers between `bounds`, one in three rows at the bounds."""
    share = rng.uniform(-1, 1, (MOTIONS * (STEPS + 1), len(bounds.low)))
    at_bounds = np.arange(len(share)) % 3 == 0
    share[at_bounds] = np.sign(share[at_bounds])
    return bounds.middle + share * bounds.half


def _states(emulator: Emulator) -> Float[np.ndarray, "N S"]:
    """Return states of random motions: half unchanged, a quarter moved to the border of training, a quarter beyond."""
    seconds = STEPS * emulator.dt
    motions = [
        random_drive(emulator, seconds, seed).motion(emulator) for seed in range(1, MOTIONS + 1)
    ]
    states = np.concatenate(motions)
    to_border = _way_to_border(emulator, states)
    which = np.arange(len(states)) % 4
    stretch = np.where(which < 2, 1.0, np.where(which == 2, to_border, BEYOND * to_border))
    return _stretched(emulator, states, stretch)


def _way_to_border(emulator: Emulator, states: Float[np.ndarray, "N S"]) -> Float[np.ndarray, " N"]:
    """Return the factor that stretches each of `states`, from rest, to the border of training."""
    near = np.zeros(len(states))
    far = np.full(len(states), FURTHEST)
    idle = np.broadcast_to(emulator.bounds.idle, (len(states), emulator.control.size))
    for _ in range(HALVINGS):
        middle = (near + far) / 2
        moved = _stretched(emulator, states, middle)
        is_covered = emulator.trust(moved, idle) <= EDGE
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


def _largest_in_part(layout: Layout, numbers: Float[np.ndarray, "N S"]) -> Float[np.ndarray, " S"]:
    """Return for each entry the largest magnitude in its part."""
    largest = np.zeros(layout.size)
    for part in layout.slices:
        largest[layout.index(part.name)] = np.abs(layout.part(numbers, part.name)).max()
    return largest


def _rounded(array: np.ndarray) -> list[Any]:
    """Return float32 numbers as lists, with all their digits."""
    if array.ndim > 1:
        return [_rounded(row) for row in array]
    return [float(f"{number:.{DIGITS}g}") for number in array]
