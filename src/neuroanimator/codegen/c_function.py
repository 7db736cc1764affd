"""Any JAX function of float32 arrays as functions of C, and its derivative with a tape between forward and backward."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from neuroanimator.codegen.c_text import Writer, fused
from neuroanimator.codegen.program import (
    EARLY,
    FLOAT_BYTES,
    LATE,
    SPACES,
    TAPE,
    WIDE,
    WIDTH,
    Constants,
    Program,
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
    inputs: Sequence[Input],
    constants: Constants,
    *,
    values: int = 1,
    is_public: bool = False,
) -> CFunction:
    """Return C text of `static void name(const float *k, const float *x0, ..., float *y0, ...)`.

    `function` (module, x0, ...) returns an array or a tuple of arrays; `k` are the `constants`, to which those of the
    function are added. Arrays are in C's order; what is wide has its sixteen lanes last, and outputs are wide if an
    input is. With late inputs there are two functions: `name_forward(k, early inputs, t, tv, early outputs)`, and
    `name_backward(k, t, tv, late inputs, late outputs)` that goes on from the tape `t`, and `tv` of lanes; the first
    `values` outputs, of which there may be none, are the early ones. Nothing is kept between calls, so threads may
    share them. What `is_public` can be called from outside the library.

    Raises UnsupportedError for what there is no C for, such as loops.
    """
    program = trace(function, module, *inputs, constants=constants)
    linkage = "" if is_public else "static "
    if not any(entry.is_late for entry in inputs):
        everything = _Part(program, inputs, range(len(program.outputs)), is_late=False)
        lines, scratch = everything.write(f"{linkage}void {name}", tapes=())
        return CFunction("\n".join(lines) + "\n", scratch=scratch)
    forward = _Part(program, inputs, range(values), is_late=False)
    backward = _Part(program, inputs, range(values, len(program.outputs)), is_late=True)
    tapes = ("float *NA_RESTRICT t", "float *NA_RESTRICT tv")
    lines, scratch = forward.write(f"{linkage}void {name}_forward", tapes)
    read_only = tuple(f"const {tape}" for tape in tapes)
    more, more_scratch = backward.write(f"{linkage}void {name}_backward", read_only)
    return CFunction(
        "\n".join([*lines, *more]) + "\n",
        tape=program.sizes.get(TAPE, 0),
        wide_tape=program.sizes.get(TAPE | WIDE, 0),
        scratch=max(scratch, more_scratch),
    )


@dataclass(frozen=True)
class _Part:
    """One of the functions a program becomes: all of it, what comes before the cotangents, or what comes after."""

    program: Program
    inputs: Sequence[Input]
    outputs: range
    is_late: bool

    def write(self, declared: str, tapes: tuple[str, ...]) -> tuple[list[str], int]:
        """Return (the function's lines, bytes of the arrays it declares)."""
        body = list(fused(self._body(Writer(self.program))))  # it may take more room
        arrays, scratch = self._arrays()
        unused = "".join(f"(void){name}; " for name in ("k", "t", "tv")[: 1 + len(tapes)])
        head = f"{declared}({', '.join(self._parameters(tapes))}) {{"
        return [head, *arrays, unused, *body, "}"], scratch

    def _numbers(self) -> list[int]:
        return [n for n, entry in enumerate(self.inputs) if entry.is_late == self.is_late]

    def _parameters(self, tapes: tuple[str, ...]) -> list[str]:
        xs = [f"const float *x{number}" for number in self._numbers()]
        ys = [f"float *y{number}" for number in self.outputs]
        between = [*tapes, *xs] if self.is_late else [*xs, *tapes]
        return ["const float *NA_RESTRICT k", *between, *ys]

    def _arrays(self) -> tuple[list[str], int]:
        lines = []
        scratch = 0
        for space in (EARLY, WIDE):
            number = space | (LATE if self.is_late else EARLY)
            size = self.program.sizes.get(number, 0)
            if size:
                lanes = "LANES * " if space else ""
                lines.append(f"NA_ALIGNED float {SPACES[number]}[{lanes}{size}];")
                scratch += FLOAT_BYTES * size * (WIDTH if space else 1)
        return lines, scratch

    def _body(self, writer: Writer) -> Iterator[str]:
        """Yield what loads the inputs, computes, and stores the outputs."""
        for number in self._numbers():
            yield from writer.loaded(f"x{number}", self.program.inputs[number].ravel())
        for operation in self.program.operations:
            if operation.is_late == self.is_late:
                yield from writer.write(operation)
        is_wide = any(self.inputs[number].is_wide for number in self._numbers())
        for number in self.outputs:
            output = self.program.outputs[number].ravel()
            yield from writer.stored(output, f"y{number}", is_wide=is_wide)
