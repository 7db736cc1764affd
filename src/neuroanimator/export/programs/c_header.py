"""An emulator or a policy as one C header that needs nothing but math.h and string.h.

Only numbers and our own names are written, and parts' names as identifiers: no raw text of a file reaches a compiler.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from importlib import resources
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.codegen.c_function import CFunction, c_function, prelude
from neuroanimator.codegen.c_text import c_number
from neuroanimator.codegen.program import FLOAT_BYTES, WIDTH, Constants
from neuroanimator.codegen.trace import Input
from neuroanimator.emulator.c_emulator import encode, super_step, super_step_trusted, tables
from neuroanimator.emulator.checks import MAX_MAGNITUDE
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.super_step import SuperStep, latent_size, step
from neuroanimator.export.programs.definition import (
    Model,
    ProgramDefinition,
    emulator_of,
)
from neuroanimator.state.layout import Layout
from neuroanimator.text import printable

NUMBERS_PER_LINE = 12
"""Number of array entries per line."""


class SharedConstants(Constants):
    """Constants that store equal arrays once: the functions of one header read the same weights."""

    def __init__(self) -> None:
        super().__init__()
        self._known: dict[tuple, np.ndarray] = {}

    def add(self, numbers: Any) -> np.ndarray:
        array = np.asarray(numbers, np.float32)
        key = (array.shape, array.tobytes())
        if key not in self._known:
            self._known[key] = super().add(array)
        return self._known[key]


def c_header(
    model: Model, definition: ProgramDefinition, name: str, *, has_gradient: bool = True
) -> str:
    """Return the text of `name`.h, whose functions' names begin with `name` (an identifier): see `emulator.h`.

    Without its gradient an emulator's is a third shorter. Raises UnsupportedError for an operation not available in C.
    """
    kind = definition.facts["kind"]
    emulator = emulator_of(model)
    if isinstance(model, Emulator):
        sizes, functions, constants = _emulator_parts(model, name, has_gradient=has_gradient)
    else:
        sizes, functions, constants = _policy_parts(definition, name)
    texts = [function.text for function in functions]
    if isinstance(model, Emulator):
        texts += _origin(model, name)
    room = max(1, emulator.control.size)  # C has no empty arrays
    arrays = {
        f"const float {name}_rest": np.array(emulator.spec.rest),
        f"const float {name}_control_low": np.resize(emulator.bounds.low, room),
        f"const float {name}_control_high": np.resize(emulator.bounds.high, room),
        f"static NA_ALIGNED const float {name}_k": constants.data(),
    }
    names = {"name": name, "NAME": name.upper()}
    values = {
        "about": about(definition),
        "stack": "\n".join(_stack(model, functions, sizes.get("TAPE", 0))),
        "generator": definition.facts["generator"],
        "sizes": "\n".join(_sizes(name, emulator, definition, sizes)),
        "room": str(room),
        "declarations": filled(f"{kind}.h", names),
        "prelude": prelude(),
        "arrays": "\n".join(line for array in arrays.items() for line in _array(*array)),
        "functions": "\n".join(texts),
        "definitions": filled(f"{kind}.c", names),
    }
    return filled("header.h", names | values)


def filled(file: str, values: Mapping[str, str]) -> str:
    """Return the text of a template of this folder, with the value of each `@name@` in its place."""
    text = (resources.files("neuroanimator.export.programs") / file).read_text(encoding="utf-8")
    return re.sub(r"@(\w+)@", lambda found: values[found[1]], text)


def _stack(model: Model, functions: list[CFunction], tape: int) -> Iterator[str]:
    """Yield the lines that tell how much of the stack calls take."""
    arrays = {function: _arrays_size(function.text) for function in functions}
    if not isinstance(model, Emulator):
        yield f"   Calls take about {_kilobytes(max(arrays.values()))} of the stack."
        return
    single = FLOAT_BYTES * tape
    single += max(size for function, size in arrays.items() if "NA_SCRATCH" not in function.text)
    lanes = max(size for function, size in arrays.items() if "NA_SCRATCH" in function.text)
    # Those of `emulator.c`: a latent state, a control and a state of each lane, and latent states that are kept.
    sizes = (latent_size(model), model.control.size, model.state.size, stored_latent_size(model))
    batch = lanes + FLOAT_BYTES * WIDTH * sum(sizes)
    yield f"   A batch takes about {_kilobytes(batch)} of the stack, other calls up to {_kilobytes(single)}. With NA_SCRATCH"
    yield "   defined as `static _Thread_local` (C++: `static thread_local`) a batch's arrays are the thread's variables."


ARRAY = re.compile(r"NA_ALIGNED float \w+\[(LANES \* )?(\d+)\]")
"""Declaration of an array in a function."""


def _arrays_size(text: str) -> int:
    """Return the size of the arrays that functions declare [bytes]."""
    total = 0
    for lanes, size in ARRAY.findall(text):
        total += FLOAT_BYTES * int(size) * (WIDTH if lanes else 1)
    return total


def _kilobytes(size: int) -> str:
    """Return a size with room for registers and numbers of their own."""
    return f"{size // 1000 + 2} kB"


def stored_latent_size(emulator: SuperStep) -> int:
    """Return the length of a latent state that callers keep: it ends with the remainders of the origin's float32."""
    return latent_size(emulator) + emulator.origin.state.size


def _origin(emulator: Emulator, name: str) -> Iterator[str]:
    """Yield the tables of the origin, and the number of entries of a latent state without the origin's remainders."""
    yield f"#define {name.upper()}_NUMBERS {latent_size(emulator)}"
    yield from tables(emulator.origin, f"{name}_")


def identifier(text: str) -> str:
    """Return `text` as a name in C and JavaScript: letters, digits and _ of ASCII, no digit first."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")
    if not name or name[0].isdigit():
        return f"na_{name}"
    return name


def part_names(layout: Layout) -> list[str]:
    """Return an identifier in capitals for each part; later ones of the same name are numbered."""
    names: list[str] = []
    for part in layout.slices:
        name = identifier(part.name).upper()
        while name in names:
            name += f"_{len(names)}"
        names.append(name)
    return names


def _emulator_parts(
    emulator: Emulator, name: str, *, has_gradient: bool
) -> tuple[dict[str, int], list[CFunction], Constants]:
    """Return (sizes by name, the functions of an emulator, the constants they read)."""

    def gradient(
        emulator: Emulator,
        state: Float[Array, " S"],
        control: Float[Array, " C"],
        cotangent: Float[Array, " S"],
    ) -> tuple[Float[Array, " S"], Float[Array, " C"]]:
        _, pull_back = jax.vjp(lambda *inputs: step(emulator, *inputs), state, control)
        return pull_back(cotangent)

    state = (emulator.state.size,)
    control = (emulator.control.size,)
    latent = (latent_size(emulator),)
    constants = SharedConstants()

    def write(suffix: str, function: Callable[..., Any], *inputs: Input) -> CFunction:
        # A gradient alone has no values of its own; other functions have no cotangents.
        return c_function(f"{name}_{suffix}", function, emulator, inputs, constants, values=0)

    functions = [
        write("encoded", encode, Input(state)),
        write("super_step", super_step, Input(latent), Input(control)),
        write("super_step_trusted", super_step_trusted, Input(latent), Input(control)),
        write(
            "super_step_lanes",
            super_step,
            Input(latent, is_wide=True),
            Input(control, is_wide=True),
        ),
    ]
    sizes = {"LATENT": stored_latent_size(emulator)}
    if has_gradient:
        inputs = (Input(state), Input(control), Input(state, is_late=True))
        derivative = write("gradient", gradient, *inputs)
        guarded = f"#ifndef {name.upper()}_WITHOUT_VJP\n{derivative.text}#endif\n"
        functions.append(replace(derivative, text=guarded))
        sizes["TAPE"] = max(derivative.tape, 1)
    return sizes, functions, constants


def _policy_parts(
    definition: ProgramDefinition, name: str
) -> tuple[dict[str, int], list[CFunction], Constants]:
    """Return (no sizes, the function of a policy, the constants it reads)."""
    constants = SharedConstants()
    inputs = [Input((port.layout.size,)) for port in definition.inputs]
    assert isinstance(definition.function, partial)  # the policy is its first argument
    (policy,) = definition.function.args
    answer = definition.function.func
    function = c_function(f"{name}_answer", answer, policy, inputs, constants)
    return {}, [function], constants


def about(definition: ProgramDefinition) -> str:
    """Return one line of ASCII that describes a program, for a comment."""
    facts = definition.facts
    said = f"the {facts['kind']} of {facts['system']}, one super step of {facts['dt']:g} s."
    if "licence" in facts:
        said += f" Weights: {facts['licence']}."
    # Any name of a system or a licence stays within the comment.
    return printable(said).encode("ascii", "replace").decode("ascii").replace("*/", "* /")


def _sizes(
    name: str, emulator: Emulator, definition: ProgramDefinition, others: dict[str, int]
) -> Iterator[str]:
    """Yield the compile-time constants: sizes, the super step, and the offsets of the parts of a state and control."""
    guard = name.upper()
    yield f"#define {guard}_DT {c_number(emulator.dt)} /* a super step [s] */"
    yield f"#define {guard}_SUBSTEPS {emulator.substeps} /* physics steps it stands for */"
    yield f"#define {guard}_STATE {emulator.state.size}"
    yield f"#define {guard}_CONTROL {emulator.control.size}"
    for key, size in others.items():
        yield f"#define {guard}_{key} {size}"
    if others and "TAPE" not in others:
        yield f"#define {guard}_WITHOUT_VJP"
    yield f"#define {guard}_MAX_MAGNITUDE {c_number(MAX_MAGNITUDE)} /* of a number of a state */"
    if "phase_per_step" in definition.facts:
        yield f"#define {guard}_PHASE_PER_STEP {c_number(definition.facts['phase_per_step'])} /* [rad] */"
    yield ""
    for vector, layout in (("STATE", emulator.state), ("CONTROL", emulator.control)):
        if not layout.size:
            continue
        yield f"/* Where each part of a {vector.lower()} begins. */"
        yield "enum {"
        start = 0
        for part_name, part in zip(part_names(layout), layout.slices, strict=True):
            yield f"    {guard}_{vector}_{part_name} = {start}, /* {part.size} [{_ascii(part.unit)}] */"
            start += part.size
        yield "};"
        yield ""


def _ascii(unit: str) -> str:
    """Return a unit in ASCII, which every compiler reads."""
    return unit.replace("·", " ").replace("²", "^2").replace("³", "^3")


def _array(declared: str, numbers: np.ndarray) -> Iterator[str]:
    """Yield the definition of an array of floats."""
    yield f"{declared}[{len(numbers)}] = {{"
    for first in range(0, len(numbers), NUMBERS_PER_LINE):
        line = numbers[first : first + NUMBERS_PER_LINE]
        yield "".join(f"{c_number(number)}," for number in line.tolist())
    yield "};"
