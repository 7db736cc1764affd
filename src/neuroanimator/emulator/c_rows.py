"""Functions of a module that take and give rows of numbers, such as a policy's, as programs in C.

There is one definition, in JAX. The program is generated from it, and held against it before its first use on a machine.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from neuroanimator.codegen.backend import backend
from neuroanimator.codegen.c_function import c_function, prelude
from neuroanimator.codegen.jax_settings import compiled_quickly
from neuroanimator.codegen.kept import CProgram, LoadedProgram, WrongProgramError, load_program
from neuroanimator.codegen.program import Constants
from neuroanimator.codegen.trace import Input, UnsupportedError
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.emulator.c_emulator import address
from neuroanimator.emulator.compiled import call_compiled, is_traced, of_rows
from neuroanimator.emulator.probes import BORDERLINE, Expected, rounded
from neuroanimator.executor.cores import in_parts
from neuroanimator.files.remembered import UNKNOWN, Remembered

SOUND_SHARE = 0.5
"""Share of the inputs a program is tried on of which JAX must make finite numbers: or the trial would say little."""

ROWS_OF_THREAD = 128
"""With fewer rows, waking a thread takes longer than they do."""

Function = Callable[..., tuple[Array, ...]]
"""Of a module and some vectors; it returns vectors, and of truth values 0 or 1."""


class CRows:
    """A function of rows, loaded. Arrays are float32 in C's order; threads may share it."""

    def __init__(self, program: LoadedProgram):
        self._constants = program.constants
        self._constants_at = address(program.constants)
        sizes = program.sizes
        self._widths = [sizes[f"y{number}"] for number in range(sizes["outputs"])]
        self._run = program.library["rows"]
        parameters = 2 + sizes["inputs"] + sizes["outputs"]
        self._run.argtypes = [ctypes.c_void_p] * parameters

    def __call__(self, *inputs: Float[np.ndarray, "B _"]) -> list[Float[np.ndarray, "B _"]]:
        """Return what the function does of each row of `inputs`: an array for each of its outputs."""
        count = len(inputs[0])
        outputs = [np.empty((count, width), np.float32) for width in self._widths]
        arrays = (*inputs, *outputs)

        def run(rows: slice) -> None:
            addresses = [address(array[rows]) for array in arrays]
            self._run(self._constants_at, rows.stop - rows.start, *addresses)

        in_parts(run, count, smallest=ROWS_OF_THREAD)
        return outputs


_known: Remembered[CRows | None] = Remembered()
"""The programs of each module, by their functions' names."""


def c_rows(
    function: Function,
    module: Any,
    about: Callable[[], list[str]],
    samples: Callable[[], Sequence[Float[np.ndarray, "N _"]]],
) -> CRows | None:
    """Return `function` of `module` in C, remembered as long as the module lives.

    `about` says what a program depends on besides the code of the package; `samples` are a thousand rows or more of each
    input, for which C must do what JAX does. None where the backend is JAX or does not come to C, as for `c_emulator`.
    """
    if backend() == "jax":
        return None
    name = function.__name__
    known = _known.of(module, name)
    if known is not UNKNOWN:
        return known
    if is_traced(module) or not _is_float32(module):
        return None
    inputs = cache(samples)  # not needed for a program that is kept

    def make() -> CProgram:
        return _program(function, module, [array.shape[1] for array in inputs()])

    def refer() -> RowsReference:
        return RowsReference.of(function, module, inputs())

    try:
        program = load_program("\n".join([name, *about()]), make, refer, _check)
    except UnsupportedError:
        program = None
    return _known.keep(None if program is None else CRows(program), module, name)


def call_rows(
    function: Function,
    module: Any,
    about: Callable[[], list[str]],
    samples: Callable[[], Sequence[Float[np.ndarray, "N _"]]],
    *inputs: Float[np.ndarray, "B _"],
) -> list[Float[np.ndarray, "B _"]]:
    """Return what `function` of `module` does of each row of `inputs`: in C where `c_rows` has it, or else in JAX."""
    in_c = c_rows(function, module, about, samples)
    inputs = tuple(as_float32(array) for array in inputs)
    if in_c is not None:
        return in_c(*inputs)
    outputs = call_compiled(of_rows(function), module, *inputs)
    return [_as_rows(np.array(output, np.float32)) for output in outputs]


def _is_float32(module: Any) -> bool:
    """Return whether JAX computes what the module computes in float32, as C does."""
    dtypes = {leaf.dtype for leaf in jax.tree.leaves(module) if eqx.is_inexact_array(leaf)}
    return dtypes <= {np.dtype(np.float32)}


def _program(function: Function, module: Any, lengths: list[int]) -> CProgram:
    """Return the program, `rows(k, count, inputs, outputs)`, of inputs of these lengths."""
    outputs = jax.eval_shape(function, module, *map(jnp.zeros, lengths))
    widths = {f"x{number}": length for number, length in enumerate(lengths)}
    sizes = {"inputs": len(lengths), "outputs": len(outputs)}
    for number, output in enumerate(outputs):
        widths[f"y{number}"] = math.prod(output.shape)
        sizes[f"y{number}"] = math.prod(output.shape)
    constants = Constants()
    inputs = [Input((length,)) for length in lengths]
    row = c_function("row", _in_floats(function), module, inputs, constants)
    parameters = [f"const float *x{number}" for number in range(len(lengths))]
    parameters += [f"float *y{number}" for number in range(len(outputs))]
    arguments = [f"{name} + b * {width}" for name, width in widths.items()]
    loop = [
        f"void rows(const float *k, long count, {', '.join(parameters)}) {{",
        f"    for (long b = 0; b < count; b++) row(k, {', '.join(arguments)});",
        "}",
        "",
    ]
    return CProgram("\n".join([prelude(), row.text, *loop]), constants.data(), sizes)


def _in_floats(function: Function) -> Function:
    """Return `function` with 0 and 1 for truth values."""

    def in_floats(module: Any, *inputs: Array) -> tuple[Array, ...]:
        outputs = function(module, *inputs)
        return tuple(jnp.asarray(output, jnp.float32) for output in outputs)

    return in_floats


@dataclass(frozen=True)
class RowsReference:
    """What JAX makes of rows of inputs, and of the same `rounded`."""

    name: str
    """Of the function."""
    inputs: list[Float[np.ndarray, "N _"]]
    exact: list[Shaped[np.ndarray, "N ..."]]
    rerun: list[Shaped[np.ndarray, "N ..."]]

    @classmethod
    def of(
        cls, function: Function, module: Any, inputs: Sequence[Float[np.ndarray, "N _"]]
    ) -> RowsReference:
        """Return what `function` of `module` makes of those `inputs` of which it makes finite numbers.

        Raises WrongProgramError where these are too few to try a program on.
        """
        in_jax = compiled_quickly(of_rows(function))
        exact = [np.asarray(output) for output in in_jax(module, *inputs)]
        rerun = [np.asarray(output) for output in in_jax(module, *map(rounded, inputs))]
        are_sound = np.ones(len(inputs[0]), bool)
        for values in (*exact, *rerun):
            are_sound &= np.isfinite(_as_rows(values)).all(axis=1)
        name = function.__name__
        if are_sound.mean() < SOUND_SHARE:
            raise WrongProgramError(f"{name}: too few of the inputs it is tried on are sound.")
        return cls(
            name,
            [array[are_sound] for array in inputs],
            [values[are_sound] for values in exact],
            [values[are_sound] for values in rerun],
        )


def _check(reference: RowsReference, program: LoadedProgram) -> None:
    """Raise WrongProgramError unless C does to every row what JAX does, to within rounding."""
    computed = CRows(program)(*reference.inputs)
    for values, expected, otherwise in zip(computed, reference.exact, reference.rerun, strict=True):
        wanted = _as_rows(expected)
        if expected.dtype == bool:
            agrees = np.mean((values > 0) != wanted) <= BORDERLINE
        else:
            agrees = Expected.of(wanted, _as_rows(otherwise)).agrees(values)
        if not agrees:
            raise WrongProgramError(f"Generated C does not do what {reference.name} does in JAX.")


def _as_rows(values: Shaped[np.ndarray, "N ..."]) -> Shaped[np.ndarray, "N M"]:
    return values.reshape(len(values), -1)
