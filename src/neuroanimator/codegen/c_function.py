"""Any JAX function of float32 arrays as one function of C."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from neuroanimator.codegen.c_text import Writer
from neuroanimator.codegen.program import ALIGNMENT, FLOAT_BYTES, trace

HEAD = f"""#include <math.h>
#include <string.h>
typedef float wide __attribute__((vector_size({ALIGNMENT}), aligned({ALIGNMENT}), may_alias));
"""
"""What every file of such functions begins with."""


def c_function(name: str, function: Callable[..., Any], *shapes: tuple[int, ...]) -> str:
    """Return C text of `static void name(const float *x0, ..., float *y)`, for `function` of arrays of `shapes`.

    Arrays are in C's order. The function keeps nothing between calls, so threads may share it.
    Raises UnsupportedError for what there is no C for, such as loops.
    """
    program = trace(function, *shapes)
    writer = Writer(program, f"{name}_k")
    body: list[str] = []
    for operation in program.operations:
        body += writer.write(operation)
    answer = program.room(program.outputs[0].shape).ravel()
    body += writer.copied(program.outputs[0].ravel(), answer)
    loads = []
    for i, (addresses, shape) in enumerate(zip(program.inputs, shapes, strict=True)):
        if addresses.size:
            size = FLOAT_BYTES * math.prod(shape)
            loads.append(f"memcpy(w + {addresses.ravel()[0]}, x{i}, {size});")
    parameters = "".join(f"const float *x{i}, " for i in range(len(shapes)))
    lines = [
        *writer.declared(),
        f"static void {name}({parameters}float *y) {{",
        f"float w[{program.size}] __attribute__((aligned({ALIGNMENT})));",
        *loads,
        *body,
        f"memcpy(y, w + {answer[0]}, {FLOAT_BYTES * len(answer)});",
        "}",
    ]
    return "\n".join(lines) + "\n"
