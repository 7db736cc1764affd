"""Any JAX function of float32 arrays as functions of C, and its derivative with a tape between forward and backward."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from typing import Any

from neuroanimator.codegen.c_text import Writer, fused
from neuroanimator.codegen.program import (
    LATE,
    SPACES,
    TAPE,
    WIDE,
    Addresses,
    Constants,
    Operation,
    Program,
    spaces_of,
)
from neuroanimator.codegen.trace import Input, trace


def prelude() -> str:
    """Return what every file of such functions begins with: types and elementary functions."""
    return (resources.files("neuroanimator.codegen") / "prelude.c").read_text(encoding="utf-8")


@dataclass(frozen=True)
class CFunction:
    """C text of a function, and what its callers need to know."""

    text: str
    tape: int = 0
    """Floats that the forward part leaves for the backward part."""
    wide_tape: int = 0
    """Registers of lanes that it leaves."""
    scratch: int = 0
    """Bytes it needs on the stack."""


def c_function(
    name: str,
    function: Callable[..., Any],
    module: Any,
    *inputs: Input,
    constants: Constants,
) -> CFunction:
    """Return C text of `static void name(const float *k, const float *x0, ..., float *y0, ...)`.

    `function` (module, x0, ...) returns an array or a tuple of arrays; `k` are the `constants`, to which those of the
    function are added. Arrays are in C's order; what is wide has its sixteen lanes last. With late inputs there are
    two functions: `name_forward(k, early inputs, t, tv, early outputs)`, and `name_backward(k, t, tv, late inputs,
    late outputs)` that goes on from the tape `t`, and `tv` of lanes. Nothing is kept between calls, so threads may
    share them.

    Raises UnsupportedError for what there is no C for, such as loops.
    """
    program = trace(function, module, *inputs, constants=constants)
    writer = Writer(program)
    if not any(entry.is_late for entry in inputs):
        body = _body(program, writer, program.operations, list(inputs), is_late=False)
        head, scratch = _head(name, program, inputs, is_late=None)
        return CFunction("\n".join([*head, *body, "}"]) + "\n", scratch=scratch)
    early = [operation for operation in program.operations if not operation.is_late]
    late = [operation for operation in program.operations if operation.is_late]
    forward = _body(program, writer, early, list(inputs), is_late=False)
    backward = _body(program, writer, late, list(inputs), is_late=True)
    forward_head, forward_scratch = _head(f"{name}_forward", program, inputs, is_late=False)
    backward_head, backward_scratch = _head(f"{name}_backward", program, inputs, is_late=True)
    lines = [*forward_head, *forward, "}", *backward_head, *backward, "}"]
    return CFunction(
        "\n".join(lines) + "\n",
        tape=program.sizes.get(TAPE, 0),
        wide_tape=program.sizes.get(TAPE | WIDE, 0),
        scratch=max(forward_scratch, backward_scratch),
    )


def _body(
    program: Program,
    writer: Writer,
    operations: list[Operation],
    inputs: list[Input],
    *,
    is_late: bool,
) -> list[str]:
    """Return what loads the inputs of one part, computes, and stores its outputs."""
    lines: list[str] = []
    for number, (addresses, entry) in enumerate(zip(program.inputs, inputs, strict=True)):
        if entry.is_late == is_late:
            lines += writer.loaded(f"x{number}", addresses.ravel())
    for operation in operations:
        lines += writer.write(operation)
    for number, output in enumerate(program.outputs):
        if _is_late(output) == is_late:
            lines += writer.stored(output.ravel(), f"y{number}")
    return list(fused(lines))


def _head(
    name: str, program: Program, inputs: tuple[Input, ...], *, is_late: bool | None
) -> tuple[list[str], int]:
    """Return (the first lines of a part, bytes of the arrays they declare); `is_late` is None for a whole function."""
    parameters = ["const float *NA_RESTRICT k"]
    xs = [
        f"const float *x{number}"
        for number, entry in enumerate(inputs)
        if is_late is None or entry.is_late == is_late
    ]
    ys = [
        f"float *y{number}"
        for number, output in enumerate(program.outputs)
        if is_late is None or _is_late(output) == is_late
    ]
    if is_late is None:
        parameters += [*xs, *ys]
    elif is_late:
        tapes = ["const float *NA_RESTRICT t", "const float *NA_RESTRICT tv"]
        parameters += [*tapes, *xs, *ys]
    else:
        tapes = ["float *NA_RESTRICT t", "float *NA_RESTRICT tv"]
        parameters += [*xs, *tapes, *ys]
    lines = [f"static void {name}({', '.join(parameters)}) {{"]
    scratch = 0
    for space in (0, WIDE):
        number = space | (LATE if is_late else 0)
        size = program.sizes.get(number, 0)
        if size:
            lanes = "LANES * " if space else ""
            lines.append(f"NA_ALIGNED float {SPACES[number]}[{lanes}{size}];")
            scratch += 4 * size * (16 if space else 1)
    lines.append("(void)k;")
    if is_late is not None:
        lines.append("(void)t; (void)tv;")
    return lines, scratch


def _is_late(addresses: Addresses) -> bool:
    """Return whether any entry depends on a late input."""
    inside = addresses[addresses >= 0]
    return bool((spaces_of(inside) & LATE).any())
