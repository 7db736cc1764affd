"""Any JAX function of float32 arrays as one function of C."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from neuroanimator.codegen.c_text import Writer
from neuroanimator.codegen.program import WIDTH, trace

HEAD = f"""#include <math.h>
#include <string.h>
typedef float wide __attribute__((vector_size({4 * WIDTH}), aligned({4 * WIDTH}), may_alias));
"""
"""What every file of such functions begins with."""


def c_function(name: str, function: Callable[..., Any], *shapes: tuple[int, ...]) -> str:
    """Return C text of `static void name(const float *x0, ..., float *y)`, for `function` of arrays of `shapes`.

    Arrays are in C's order. The function keeps nothing between calls, so threads may share it.

    Raises UnsupportedError for what there is no C for, such as loops.
    """
    program = trace(function, *shapes)
    writer = Writer(program, f"{name}_k")
    body = [line for operation in program.operations for line in writer.write(operation)]
    answer = program.room(program.outputs[0].shape).ravel()
    body += writer.copied(program.outputs[0].ravel(), answer)
    loads = [
        f"memcpy(w + {each.ravel()[0]}, x{i}, {4 * math.prod(shape)});"
        for i, (each, shape) in enumerate(zip(program.inputs, shapes, strict=True))
        if each.size
    ]
    lines = [
        *writer.declared(),
        f"static void {name}({''.join(f'const float *x{i}, ' for i in range(len(shapes)))}float *y) {{",
        f"float w[{program.size}] __attribute__((aligned({4 * WIDTH})));",
        *loads,
        *body,
        f"memcpy(y, w + {answer[0]}, {4 * len(answer)});",
        "}",
    ]
    return "\n".join(lines) + "\n"
