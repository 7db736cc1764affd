"""An emulator or a policy in NumPy alone, as Blender has it.

    fish = load("fish.npz")
    states = fish.rollout(fish.rest, controls)      # controls (T, C) -> states (T+1, S)
    score = fish.trust(states[-1], controls[-1])    # how far from what training showed: 1 is the edge

SI units, radians, Z up, quaternions wxyz; `fish.facts` says what the numbers are. Nothing in an .npz file is run but the
operators below.
"""

import json
import math
import struct
import zipfile
import zlib

import numpy as np

FORMAT = "neuroanimator numpy 1"
"""What a file says it is."""

MAX_NODES = 20_000
"""Operators a program may have: a file may come from a stranger."""

MAX_SIZE = 256 << 20
"""Bytes that all arrays of a file may have."""

DAMAGED = (
    ArithmeticError, AttributeError, EOFError, LookupError, RuntimeError, TypeError, struct.error, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What NumPy and Python's own readers raise for bytes that are no archive, or were damaged."""

BOOL = 9
"""The number by which a program asks for truth values."""


def _expand(row, shape):
    return np.broadcast_to(row, (int(shape[0]), row.shape[-1]))


def _reshape(array, shape):
    sizes = [array.shape[axis] if size == 0 else size for axis, size in enumerate(shape.tolist())]
    return array.reshape(sizes)


def _sum(array, axes, keepdims):
    return array.sum(axis=tuple(axes.tolist()), keepdims=bool(keepdims))


def _cast(array, to):
    return array.astype(bool if to == BOOL else np.float32)


def _logistic(x):
    return 0.5 + 0.5 * np.tanh(0.5 * x)


def _reduced_by(function):
    return lambda array, axes, keepdims: function(array, axis=tuple(axes), keepdims=bool(keepdims))


OPERATORS = {
    "Abs": np.abs,
    "Acos": np.arccos,
    "Add": np.add,
    "And": np.logical_and,
    "Asin": np.arcsin,
    "Atan": np.arctan,
    "Cast": _cast,
    "Ceil": np.ceil,
    "Concat": lambda *arrays, axis: np.concatenate(arrays, axis=axis),
    "Cos": np.cos,
    "Cosh": np.cosh,
    "Div": np.divide,
    "Equal": np.equal,
    "Erf": lambda x: np.vectorize(math.erf, otypes=[np.float32])(x),
    "Exp": np.exp,
    "Expand": _expand,
    "Floor": np.floor,
    "Gather": lambda array, indices, axis: np.take(array, indices, axis=axis),
    "Greater": np.greater,
    "GreaterOrEqual": np.greater_equal,
    "Identity": lambda x: x,
    "Less": np.less,
    "LessOrEqual": np.less_equal,
    "Log": np.log,
    "MatMul": np.matmul,
    "Max": np.maximum,
    "Min": np.minimum,
    "Mul": np.multiply,
    "Neg": np.negative,
    "Not": np.logical_not,
    "Or": np.logical_or,
    "Pow": np.power,
    "Reciprocal": np.reciprocal,
    "ReduceMax": _reduced_by(np.max),
    "ReduceMin": _reduced_by(np.min),
    "ReduceProd": _reduced_by(np.prod),
    "ReduceSum": _sum,
    "Reshape": _reshape,
    "Round": np.round,
    "Shape": lambda array: np.array(array.shape),
    "Sigmoid": _logistic,
    "Sign": np.sign,
    "Sin": np.sin,
    "Sinh": np.sinh,
    "Sqrt": np.sqrt,
    "Sub": np.subtract,
    "Tan": np.tan,
    "Tanh": np.tanh,
    "Where": np.where,
}
"""What each operator of a program is in NumPy."""


class Program:
    """A function of arrays (B, N) that returns others (B, O): operators in order, and their constants."""

    def __init__(self, nodes, inputs, outputs, constants):
        if len(nodes) > MAX_NODES:
            raise ValueError(f"wanted at most {MAX_NODES} operators, got {len(nodes)}")
        self._inputs = inputs
        self._constants = constants
        known = {*inputs, *constants}
        self._steps = []
        for operator, sources, target, attributes in nodes:
            if operator not in OPERATORS or not known.issuperset(sources):
                raise ValueError(f"no operator {operator!r} of {sources!r} is known")
            known.add(target)
            self._steps.append((OPERATORS[operator], sources, target, dict(attributes)))
        for output in outputs:
            if output not in known:
                raise ValueError(f"nothing computes {output!r}")
        self._steps_to = {}

    def __call__(self, outputs, *arrays):
        """Return the arrays called `outputs`; of the operators those are run that these depend on."""
        values = dict(self._constants)
        for name, array in zip(self._inputs, arrays, strict=True):
            values[name] = np.asarray(array, np.float32)
        with np.errstate(all="ignore"):
            for function, sources, target, attributes in self._needed(tuple(outputs)):
                values[target] = function(*(values[name] for name in sources), **attributes)
        return [values[name] for name in outputs]

    def _needed(self, outputs):
        if outputs not in self._steps_to:
            needed = set(outputs)
            steps = []
            for step in reversed(self._steps):
                _, sources, target, _ = step
                if target in needed:
                    needed.update(sources)
                    steps.append(step)
            self._steps_to[outputs] = steps[::-1]
        return self._steps_to[outputs]


class Model:
    """What an .npz file holds."""

    def __init__(self, facts, program, outputs, body, arrays):
        self.facts = facts
        """The system, the super step `dt` [s], names, sizes, units and bounds."""
        self.body = body
        """Bones, and what else draws it; empty if there is nothing to draw."""
        self.arrays = arrays
        """Arrays that `body` refers to."""
        self.outputs = outputs
        """What it computes: an emulator `next_state`, and `trust` if it has scores; a policy `control`."""
        self._program = program

    @property
    def rest(self):
        """A state (S,) to start from, as a new array."""
        return np.array(self.facts["rest"], np.float32)

    def step(self, state, control):
        """Return the state (S,) one super step after `state` under `control` (C,); or those of many (B, S), (B, C)."""
        return self.run(state, control)

    def step_trusted(self, state, control):
        """Return (`step`, `trust`), for little more than the cost of `step`."""
        self._check_has_scores()
        following, scores = self._computed(["next_state", "trust"], state, control)
        return following, scores[..., 0]

    def trust(self, state, control):
        """Return how far `state` (S,) and `control` (C,) lie from what training showed, or those of many (B, S), (B, C).

        1 is the edge; the more above it, the less the emulator knows. Infinite for what is not finite.
        """
        self._check_has_scores()
        (scores,) = self._computed(["trust"], state, control)
        return scores[..., 0]

    def _check_has_scores(self):
        if "trust" not in self.outputs:
            raise ValueError("this file has no trust scores; export it again")

    def rollout(self, state, controls):
        """Return the states (T+1, S) from `state` (S,) on under `controls` (T, C)."""
        states = [np.asarray(state, np.float32)]
        for control in np.asarray(controls, np.float32):
            states.append(self.step(states[-1], control))
        return np.stack(states)

    def control(self, state, phase, command):
        """Return a policy's control (C,) in `state` (S,), at `phase` [rad] of its clock, told `command` (4,)."""
        return self.run(state, np.reshape(phase, (*np.shape(state)[:-1], 1)), command)

    def run(self, *inputs):
        """Return the first output (O,) for inputs (N,) in the file's order, or outputs (B, O) for inputs (B, N)."""
        return self._computed(self.outputs[:1], *inputs)[0]

    def run_all(self, *inputs):
        """Return all outputs by name, for inputs as of `run`."""
        return dict(zip(self.outputs, self._computed(self.outputs, *inputs), strict=True))

    def _computed(self, outputs, *inputs):
        """Return the outputs of these names, each (O,) or (B, O) as the inputs are (N,) or (B, N)."""
        with np.errstate(over="ignore"):  # what is too large for single precision is infinite
            arrays = [np.asarray(array, np.float32) for array in inputs]
        if arrays[0].ndim == 1:
            return [
                output[0] for output in self._program(outputs, *(array[None] for array in arrays))
            ]
        return self._program(outputs, *arrays)


def load(file):
    """Return the model in an .npz file, by its path or open; ValueError says what is wrong with it."""
    try:
        _check_size(file)
        with np.load(file, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
        told = json.loads(bytes(arrays.pop("program")).decode("ascii"))
        if told["format"] != FORMAT:
            raise ValueError(f"wanted {FORMAT!r}, got {told['format']!r}")
        constants = {name: arrays.pop(name) for name in told["constants"]}
        outputs = [told["output"], *told.get("more_outputs", ())]
        program = Program(told["nodes"], told["inputs"], outputs, constants)
        return Model(told["facts"], program, outputs, told["body"], arrays)
    except DAMAGED as error:
        raise ValueError(f"not a NeuroAnimator file: {error}") from error


def _check_size(file):
    """Refuse an archive that would fill the memory: a few bytes can stand for gigabytes."""
    with zipfile.ZipFile(file) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > MAX_SIZE:
        raise ValueError(f"wanted at most {MAX_SIZE:,} bytes, got {size:,}")
    if hasattr(file, "seek"):
        file.seek(0)
