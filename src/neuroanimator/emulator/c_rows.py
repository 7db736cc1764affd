"""Functions of a module on rows of numbers, such as a policy's, as C programs.

The definition is in JAX. The program is generated from it, and checked against it before its first use on a machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.codegen.backend import backend
from neuroanimator.codegen.c_function import c_function, prelude
from neuroanimator.codegen.cores import in_parts
from neuroanimator.codegen.kept import (
    CProgram,
    LoadedProgram,
    WrongProgramError,
    address,
    declared,
    load_program,
)
from neuroanimator.codegen.program import Constants
from neuroanimator.codegen.trace import Input
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.emulator.compiled import call_compiled, is_traced, of_rows
from neuroanimator.emulator.probes import Probes, flat_rows
from neuroanimator.files.remembered import Remembered

SOUND_SHARE = 0.5
"""Minimum share of the inputs for a program's check for which JAX gives finite numbers: fewer would prove little."""

ROWS_OF_THREAD = 128
"""Minimum number of rows per thread: fewer take less time than waking it."""

Function = Callable[..., tuple[Array, ...]]
"""Function of a module and vectors that returns vectors, with booleans as 0 or 1."""


class CRows:
    """A function of rows, loaded. Arrays are float32 in C order; threads may share it."""

    def __init__(self, program: LoadedProgram):
        self._program = program
        self._constants_at = address(program.constants)
        sizes = program.sizes
        self._widths = [sizes[f"y{number}"] for number in range(sizes["outputs"])]
        parameters = 2 + sizes["inputs"] + sizes["outputs"]
        self._run = declared(program.library, "rows", parameters)

    def __call__(self, *inputs: Float[np.ndarray, "B _"]) -> list[Float[np.ndarray, "B _"]]:
        """Return the function of each row of `inputs`: an array for each of its outputs."""
        count = len(inputs[0])
        outputs = [np.empty((count, width), np.float32) for width in self._widths]
        arrays = (*inputs, *outputs)

        def run(rows: slice) -> None:
            addresses = [address(array[rows]) for array in arrays]
            self._run(self._constants_at, rows.stop - rows.start, *addresses)

        in_parts(run, count, smallest=ROWS_OF_THREAD)
        return outputs


@dataclass(frozen=True, eq=False)
class RowFunction:
    """A function of a module and vectors, to be called with rows of vectors."""

    function: Function
    about: Callable[[Any], list[str]]
    """What its program depends on besides the package's code, from the module."""
    samples: Callable[[Any], Sequence[Float[np.ndarray, "N _"]]]
    """A thousand rows or more of each input of the module, on which C must agree with JAX."""

    def in_c(self, module: Any) -> CRows | None:
        """Return it in C, remembered as long as the module lives; None if the backend is JAX, or if there is no C."""
        return None if backend() == "jax" else _c_rows(module, self)

    def __call__(
        self, module: Any, *inputs: Float[np.ndarray, "B _"]
    ) -> list[Float[np.ndarray, "B _"]]:
        """Return the results for each row of `inputs`: in C if there is a program, otherwise in JAX."""
        in_c = self.in_c(module)
        rows = tuple(as_float32(array) for array in inputs)
        if in_c is not None:
            return in_c(*rows)
        outputs = call_compiled(of_rows(self.function), module, *rows)
        return [flat_rows(np.array(output, np.float32)) for output in outputs]


@Remembered
def _c_rows(module: Any, rows: RowFunction) -> CRows | None:
    if is_traced(module) or not _is_float32(module):
        return None
    function = rows.function

    @cache  # not needed for a kept program
    def inputs() -> list[Float[np.ndarray, "N _"]]:
        return [as_float32(array) for array in rows.samples(module)]

    def make() -> CProgram:
        return _program(function, module, [array.shape[1] for array in inputs()])

    def refer() -> Probes:
        return _probes_of(function, module, inputs())

    program = load_program(lambda: [function.__name__, *rows.about(module)], make, refer, _check)
    return None if program is None else CRows(program)


def _is_float32(module: Any) -> bool:
    """Return whether the module's numbers in JAX are float32, as in C."""
    dtypes = {leaf.dtype for leaf in jax.tree.leaves(module) if eqx.is_inexact_array(leaf)}
    return dtypes <= {np.dtype(np.float32)}


def _program(function: Function, module: Any, lengths: list[int]) -> CProgram:
    """Return the program, `rows(k, count, inputs, outputs)`, for inputs of these lengths."""
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
    """Return `function` with booleans as 0 and 1."""

    def in_floats(module: Any, *inputs: Array) -> tuple[Array, ...]:
        outputs = function(module, *inputs)
        return tuple(jnp.asarray(output, jnp.float32) for output in outputs)

    return in_floats


def _probes_of(function: Function, module: Any, inputs: list[Float[np.ndarray, "N _"]]) -> Probes:
    """Return the probes of `function`; WrongProgramError if too few of `inputs` prove anything."""
    probes = Probes.of(function.__name__, function, module, inputs)
    if len(probes.inputs[0]) < SOUND_SHARE * len(inputs[0]):
        raise WrongProgramError(f"{probes.name}: too few of the test inputs give usable results.")
    return probes


def _check(probes: Probes, program: LoadedProgram) -> None:
    """Raise WrongProgramError unless C agrees with JAX on every row, to within rounding."""
    probes.compare(*CRows(program)(*probes.inputs))
