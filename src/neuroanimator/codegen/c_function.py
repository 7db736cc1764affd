"""Any JAX function of float32 arrays as C functions, and its derivative, with a tape between forward and backward."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any, NamedTuple

from neuroanimator.codegen.c_text import Writer, fused, with_gathered_rows
from neuroanimator.codegen.placement import placed
from neuroanimator.codegen.program import (
    EARLY,
    FLOAT_BYTES,
    LATE,
    SPACES,
    TAPE,
    WIDE,
    WIDTH,
    Constants,
    Operation,
    Program,
)
from neuroanimator.codegen.trace import Input, trace

MAX_STACK = 2**22
"""Maximum size of a function's arrays on the stack [bytes], half a thread's; larger ones are thread-local variables."""


def prelude() -> str:
    """Return the text that begins every file of such functions: types and elementary functions."""
    return (resources.files("neuroanimator.codegen") / "prelude.c").read_text(encoding="utf-8")


@dataclass(frozen=True)
class CFunction:
    """C text of a function, and the sizes its callers need."""

    text: str
    tape: int = 0
    """Number of floats on the tape from the forward part to the backward part."""
    wide_tape: int = 0
    """Number of registers of lanes on its wide tape."""


class LatePart(NamedTuple):
    """A function that continues from the tape; late inputs and outputs are assigned to such parts in order."""

    name: str
    """Suffix added to the name of the whole function."""
    inputs: int
    """Number of its late inputs."""
    outputs: int


def c_function(
    name: str,
    function: Callable[..., Any],
    module: Any,
    inputs: Sequence[Input],
    constants: Constants,
    *,
    values: int = 1,
    late: Sequence[LatePart] = (),
    is_public: bool = False,
) -> CFunction:
    """Return C text of `static void name(const float *k, const float *x0, ..., float *y0, ...)`.

    `function` (module, x0, ...) returns an array or a tuple of arrays; `k` are the `constants`, to which those of the
    function are added. Arrays are in C order; wide ones have their sixteen lanes last, and outputs are wide if any input
    is. With late inputs there are several functions: `name_forward(k, early inputs, t, tv, early outputs)`, and for each
    part of `late` a `name_part(k, t, tv, its inputs, its outputs)` that continues from the tape `t`, and the tape of
    lanes `tv`; the first `values` outputs, possibly none, are the early ones. Without `late` there is one such part,
    `backward`. The functions keep no state between calls, so threads may share them. If `is_public`, they can be called
    from outside the library.

    Raises UnsupportedError for operations without C, such as loops.
    """
    program = trace(function, module, *inputs, constants=constants)
    linkage = "" if is_public else "static "
    everything = range(len(program.outputs))
    early_inputs = [number for number, entry in enumerate(inputs) if not entry.is_late]
    late_inputs = [number for number, entry in enumerate(inputs) if entry.is_late]
    if not late_inputs:
        whole = _Part(program, inputs, early_inputs, everything, is_late=False)
        lines = whole.write(f"{linkage}void {name}", tapes=())
        return CFunction("\n".join(lines) + "\n")
    tapes = ("float *NA_RESTRICT t", "float *NA_RESTRICT tv")
    forward = _Part(program, inputs, early_inputs, everything[:values], is_late=False)
    lines = forward.write(f"{linkage}void {name}_forward", tapes)
    read_only = tuple(f"const {tape}" for tape in tapes)
    late_outputs = everything[values:]
    for part in late or [LatePart("backward", len(late_inputs), len(late_outputs))]:
        own_inputs = late_inputs[: part.inputs]
        own_outputs = late_outputs[: part.outputs]
        late_inputs = late_inputs[part.inputs :]
        late_outputs = late_outputs[part.outputs :]
        going_on = _Part(program, inputs, own_inputs, own_outputs, is_late=True)
        lines += going_on.write(f"{linkage}void {name}_{part.name}", read_only)
    return CFunction(
        "\n".join(lines) + "\n",
        tape=program.sizes.get(TAPE, 0),
        wide_tape=program.sizes.get(TAPE | WIDE, 0),
    )


@dataclass(frozen=True)
class _Part:
    """One of the functions of a program: the whole, the part before the late inputs, or the part after some of them."""

    program: Program
    inputs: Sequence[Input]
    """Inputs of the whole program."""
    own_inputs: Sequence[int]
    outputs: range
    is_late: bool

    def write(self, declared: str, tapes: tuple[str, ...]) -> list[str]:
        """Return the function's lines."""
        part = placed(
            self.program,
            list(with_gathered_rows(self.program, self._operations())),
            [self.program.inputs[number].ravel() for number in self.own_inputs],
            [self.program.outputs[number].ravel() for number in self.outputs],
            self._spaces(),
        )
        body = list(fused(self._body(part)))  # it may allocate more room
        names = [*("k", "t", "tv")[: 1 + len(tapes)], *self._empty()]
        unused = "".join(f"(void){name}; " for name in names)
        head = f"{declared}({', '.join(self._parameters(tapes))}) {{"
        return [head, *self._arrays(part.sizes), unused, *body, "}"]

    def _spaces(self) -> list[int]:
        """Return the spaces it works in."""
        lateness = LATE if self.is_late else EARLY
        return [lateness, lateness | WIDE]

    def _empty(self) -> list[str]:
        """Return the empty parameters, such as the control of an undriven system."""
        inputs = self.program.inputs
        outputs = self.program.outputs
        names = [f"x{number}" for number in self.own_inputs if not inputs[number].size]
        return names + [f"y{number}" for number in self.outputs if not outputs[number].size]

    def _parameters(self, tapes: tuple[str, ...]) -> list[str]:
        xs = [f"const float *x{number}" for number in self.own_inputs]
        ys = [f"float *y{number}" for number in self.outputs]
        between = [*tapes, *xs] if self.is_late else [*xs, *tapes]
        return ["const float *NA_RESTRICT k", *between, *ys]

    def _arrays(self, sizes: dict[int, int]) -> list[str]:
        declared = []
        scratch = 0
        for space in self._spaces():
            size = sizes.get(space, 0)
            if size:
                storage, lanes = ("NA_SCRATCH ", "LANES * ") if space & WIDE else ("", "")
                declared.append(f"{storage}NA_ALIGNED float {SPACES[space]}[{lanes}{size}];")
                scratch += FLOAT_BYTES * size * (WIDTH if space & WIDE else 1)
        if scratch > MAX_STACK:
            declared = [f"static __thread {array}" for array in declared]
        return declared

    def _operations(self) -> list[Operation]:
        """Return this part's operations: all early ones, or the late ones on which its own outputs depend."""
        operations = self.program.operations
        if self.is_late:
            operations = self.program.needed_by([self.program.outputs[n] for n in self.outputs])
        return [operation for operation in operations if operation.is_late == self.is_late]

    def _body(self, part: Program) -> Iterator[str]:
        """Yield statements that load the inputs, compute, and store the outputs."""
        writer = Writer(part)
        for number, addresses in zip(self.own_inputs, part.inputs, strict=True):
            yield from writer.loaded(f"x{number}", addresses)
        for operation in part.operations:
            yield from writer.write(operation)
        is_wide = any(self.inputs[number].is_wide for number in self.own_inputs)
        for number, addresses in zip(self.outputs, part.outputs, strict=True):
            yield from writer.stored(addresses, f"y{number}", is_wide=is_wide)
