"""A formula in JAX as an inline C function, for loops over elements."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from neuroanimator.codegen.c_text import ELEMENTWISE, power
from neuroanimator.codegen.program import Operation
from neuroanimator.codegen.trace import Input, UnsupportedError, trace

EXACT = ("neg", "square", "add", "sub", "mul", "div", "max", "min", "clamp", "gt", "select_n")
"""Operations with the same C in float32 and float64."""


def c_formula(name: str, function: Callable[..., Any], *shapes: tuple[int, ...]) -> str:
    """Return C text of `function`, whose arguments and result are single elements: numbers (1,) or vectors (1, 3).

    The surrounding program defines `INLINE`, the type `real`, and `AXIS`, the distance between components of a vector.
    Numbers are passed and returned by value. Vectors are pointers to their first component; a vector result is the
    last argument.

    Raises UnsupportedError for operations without C.
    """
    with jax.enable_x64(True):
        inputs = [Input(shape, dtype=np.float64) for shape in shapes]
        program = trace(lambda _, *arguments: function(*arguments), None, *inputs)
    terms = {address: f"(real){value!r}" for address, value in program.constants.literals.items()}
    parameters = []
    for number, addresses in enumerate(program.inputs):
        pointer = "*" if addresses.size > 1 else ""
        parameters.append(f"const real {pointer}x{number}")
        for axis, address in enumerate(addresses.ravel().tolist()):
            terms[address] = f"x{number}[{axis} * AXIS]" if pointer else f"x{number}"
    lines = []
    for operation in program.operations:
        lines += _statements(operation, terms)
    (output,) = program.outputs
    results = [terms[address] for address in output.ravel().tolist()]
    if len(results) == 1:
        lines.append(f"return {results[0]};")
        return_type = "real"
    else:
        lines += [f"y[{axis} * AXIS] = {result};" for axis, result in enumerate(results)]
        return_type = "void"
        parameters.append("real *y")
    head = f"INLINE {return_type} {name}({', '.join(parameters)}) {{"
    return " ".join([head, *lines, "}"])


def _statements(operation: Operation, terms: dict[int, str]) -> Iterator[str]:
    """Yield statements for each entry of `operation`; `terms` maps addresses to C, and is extended by the results."""
    formula = _formula(operation)
    targets = operation.output.ravel().tolist()
    for target, *sources in zip(targets, *operation.entries(), strict=True):
        value = formula.format(*[terms[int(source)] for source in sources])
        terms[target] = f"w{target}"
        yield f"const real w{target} = {value};"


def _formula(operation: Operation) -> str:
    if operation.name in EXACT:
        return ELEMENTWISE[operation.name]
    if operation.name == "integer_pow":
        return power(operation.params["y"])
    if operation.name == "sqrt":
        return "(real)sqrt({0})"
    raise UnsupportedError(operation.name)
