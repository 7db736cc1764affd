"""Test vectors: inputs within what training showed and at its borders, and what JAX makes of them.

A program that does not do the same with a thousand of them is not kept; some of them ship beside it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from neuroanimator.animation.motion import random_motion
from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.state_policy import StatePolicy
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.probes import rounded
from neuroanimator.emulator.trust import EDGE
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.export.programs.definition import (
    Definition,
    Model,
    commands_of,
    emulator_of,
)
from neuroanimator.state.layout import Bounds, Layout

MOTIONS = 24
"""Short random motions states are taken from."""

STEPS = 49
"""Super steps of each motion: with its start fifty states."""

COUNT = 1000
"""Inputs a program is held against JAX in: of those of the motions that are a test."""

KEPT = 50
"""Inputs that are written to a file."""

FURTHEST = 16.0
"""Times the way from rest that a state is moved to the border of what training showed, at most."""

HALVINGS = 12
"""Times the stretch on which the border lies is halved."""

BEYOND = 1.1
"""Times the way to the border of states that lie beyond it: there the domain's clip is at work."""

OFF_BOUNDS = 0.97
"""Times the way from the middle to a bound that controls of gradients go."""

DRAWS = 8
"""Number of times the last digits of inputs are changed to see whether an output hangs on them: at a kink, half of the
changes lead to the other side."""

MAX_DOUBT = 2e-4
"""Largest change of an output then, in its unit, of an input that is a test of a program."""

MIN_SHARE = 0.5
"""Share of `COUNT` that must be left."""

TOLERANCE = 1e-3
"""Difference allowed, in units of the output: both sides are float32, and order their sums differently."""

ROUNDING = 4 * float(np.finfo(np.float32).eps)
"""Difference allowed besides, as a share of the number itself."""

DIGITS = 9
"""Digits that tell every float32 from the next."""

Arrays = dict[str, np.ndarray]
"""Inputs or outputs (N, _) by name."""


@dataclass(frozen=True, eq=False)
class Vectors:
    """Inputs of a function, by name, and its outputs as JAX computes them."""

    inputs: dict[str, Float[np.ndarray, "N _"]]
    expected: dict[str, Float[np.ndarray, "N _"]]
    units: dict[str, Float[np.ndarray, "N _"]]
    """What an error in each entry is measured in: a part's largest change, half a control's range, a score beyond 1 itself."""

    @property
    def count(self) -> int:
        """How many inputs there are."""
        return len(next(iter(self.expected.values())))

    def tolerance(self, output: str) -> Float[np.ndarray, "N _"]:
        """Return the difference allowed in each entry of an output."""
        rounding = ROUNDING * np.abs(self.expected[output]).max(axis=0)
        return TOLERANCE * self.units[output] + rounding

    def check(self, computed: dict[str, Float[np.ndarray, "N _"]], where: str) -> float:
        """Return the largest difference of what was `computed` elsewhere, in units of the outputs.

        Raises NeuroAnimatorError if one is larger than allowed.
        """
        largest = 0.0
        for output, expected in self.expected.items():
            found = computed[output]
            differences = np.abs(found.astype(float) - expected)
            is_wrong = ~(differences <= self.tolerance(output))  # NaN is wrong, too
            if is_wrong.any():
                row, entry = np.argwhere(is_wrong)[0]
                raise NeuroAnimatorError(
                    f"{where} does not do what JAX does, so nothing was written: of {self.count} inputs "
                    f"{is_wrong.any(axis=1).sum()} differ, the first in {output}[{entry}], "
                    f"{found[row, entry]:g} for {expected[row, entry]:g}. Please report it."
                )
            share = differences / np.maximum(self.units[output], ROUNDING)
            largest = max(largest, float(share.max(initial=0)))
        return largest

    def to_json(self) -> dict[str, Any]:
        """Return `KEPT` of the inputs and outputs, and what each entry of an output may differ by."""
        kept = np.linspace(0, self.count - 1, KEPT).astype(int)
        return {
            "inputs": {name: _rounded(array[kept]) for name, array in self.inputs.items()},
            "outputs": {name: _rounded(array[kept]) for name, array in self.expected.items()},
            "tolerance": {name: self._largest_tolerance(name) for name in self.expected},
        }

    def _largest_tolerance(self, output: str) -> list[float]:
        """Return what each entry may differ by at most, whatever the input."""
        return _rounded(self.tolerance(output).max(axis=0))


def vectors_text(definition: Definition, functions: Mapping[str, Vectors]) -> str:
    """Return the facts and the vectors of each function, by name, as JSON."""
    content: dict[str, Any] = {"facts": definition.facts}
    for name, vectors in functions.items():
        content[name] = vectors.to_json()
    return json.dumps(content, separators=(",", ":"), allow_nan=False)


def make_vectors(definition: Definition, model: Model) -> Vectors:
    """Return `COUNT` inputs of `model`, the same each time, and what JAX makes of them in float32.

    Raises NeuroAnimatorError where that is not finite, or hangs on the last digits of the inputs, too often.
    """
    rng = np.random.default_rng(0)
    if isinstance(model, Emulator):
        arrays = _emulator_inputs(model, rng)
    elif isinstance(model, Policy):
        arrays = _policy_inputs(model, rng)
    else:
        arrays = _state_policy_inputs(model, rng)
    names = [port.name for port in definition.inputs]
    inputs = {name: array.astype(np.float32) for name, array in zip(names, arrays, strict=True)}

    emulator = emulator_of(model)

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


def make_gradient_vectors(definition: Definition, emulator: Emulator, vectors: Vectors) -> Vectors:
    """Return the inputs of `vectors` with random cotangents, and the vector-Jacobian products JAX makes of them.

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
    """Return the vectors of `function`, at most `COUNT`, for those `inputs` that are a test of it.

    They are none where JAX itself gives no number, or another one when the last digits of the inputs change: at a kink
    (an end of a clip, the larger of two) JAX's slope is that of the one side or the other, and at the kink itself their
    mean. Programs have the same conditions from JAX, but round what they compare in orders of their own.
    """
    run = jax.jit(jax.vmap(function))
    outputs = _as_numpy(run(*inputs.values()))
    others = []
    for draw in range(DRAWS):
        others.append(_as_numpy(run(*(rounded(array, draw) for array in inputs.values()))))
    is_finite = np.ones(len(next(iter(outputs.values()))), bool)
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
        is_steady = np.ones(len(next(iter(outputs.values()))), bool)
        for changed in others:
            is_steady &= _are_near(outputs, _rows(changed, is_finite), scales)
        chosen = np.flatnonzero(is_steady)[:COUNT]
        if len(chosen) >= MIN_SHARE * COUNT:
            return Vectors(*(_rows(arrays, chosen) for arrays in (inputs, outputs, scales)))
    raise NeuroAnimatorError(
        f"{system}: from most states like those it was trained on follows no number, or one that hangs on rounding. "
        "Train it longer before exporting it."
    )


def _are_near(outputs: Arrays, others: Arrays, scales: Arrays) -> Bool[np.ndarray, " N"]:
    """Return for which rows all outputs are near the others, what rounding alone does to a number left aside."""
    are_near = np.ones(len(next(iter(outputs.values()))), bool)
    for name, output in outputs.items():
        rounding = ROUNDING * np.abs(output).max(axis=0)
        off = np.abs(output - others[name])
        are_near &= (off <= MAX_DOUBT * scales[name] + rounding).all(axis=1)
    return are_near


def _as_numpy(arrays: dict[str, Array]) -> Arrays:
    return {name: np.asarray(array) for name, array in arrays.items()}


def _rows(arrays: Arrays, chosen: np.ndarray) -> Arrays:
    """Return some rows of every array, by a mask or by numbers, each row in one piece."""
    return {name: np.ascontiguousarray(array[chosen]) for name, array in arrays.items()}


def _emulator_inputs(emulator: Emulator, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return states (N, S) and controls (N, C)."""
    return _states(emulator), _within(emulator.bounds, rng)


def _policy_inputs(policy: Policy, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return states (N, S), phases (N, 1) and commands (N, 4)."""
    phases = rng.uniform(0, 2 * np.pi, (MOTIONS * (STEPS + 1), 1))
    return _states(policy.emulator), phases, _within(policy.ranges, rng)


def _state_policy_inputs(policy: StatePolicy, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return states (N, S) and, for a policy that takes commands, these (N, 2)."""
    commands = commands_of(policy)
    states = _states(policy.emulator)
    if commands is None:
        return (states,)
    return states, _within(commands.bounds, rng)


def _within(bounds: Bounds, rng: np.random.Generator) -> Float[np.ndarray, "N C"]:
    """Return random numbers between `bounds`, one in three rows at the bounds."""
    share = rng.uniform(-1, 1, (MOTIONS * (STEPS + 1), len(bounds.low)))
    at_bounds = np.arange(len(share)) % 3 == 0
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
    """Return for each entry how large the numbers of its part are at most."""
    largest = np.zeros(layout.size)
    for part in layout.slices:
        largest[layout.index(part.name)] = np.abs(layout.part(numbers, part.name)).max()
    return largest


def _rounded(array: np.ndarray) -> list[Any]:
    """Return float32 numbers as lists, with as many digits as they have."""
    if array.ndim > 1:
        return [_rounded(row) for row in array]
    return [float(f"{number:.{DIGITS}g}") for number in array]
