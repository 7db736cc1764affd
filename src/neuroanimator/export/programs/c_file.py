"""Write an emulator or a policy as a C header, after checking its compiled functions against JAX."""

from __future__ import annotations

import ctypes
import shlex
from collections.abc import Callable
from functools import partial
from pathlib import Path

import jax
import numpy as np

from neuroanimator.codegen.compiler import HOW_TO_GET_ONE, compiled_library, find_compiler, obstacle
from neuroanimator.codegen.jax_settings import compiled_quickly
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.probes import BORDERLINE
from neuroanimator.emulator.super_step import trust
from neuroanimator.emulator.trust import EDGE
from neuroanimator.errors import NeuroAnimatorError, ResourceError
from neuroanimator.export.programs.c_header import c_header, identifier
from neuroanimator.export.programs.definition import PHASE, Model, ProgramDefinition, definition_of
from neuroanimator.export.programs.exported_files import (
    CheckedProgram,
    ExportedFiles,
    write_program,
)
from neuroanimator.export.programs.vectors import (
    Vectors,
    make_gradient_vectors,
    make_vectors,
)

FLAGS = (("-O1", "-Wall", "-Wextra", "-Werror"),)
"""Compiler flags for checking a header."""

SCORES = ("trust", "step_trusted")
"""Functions that return a number; others return nothing or an integer."""

SCORE_TOLERANCE = 1e-3
"""Tolerance of scores, absolute and relative: they are sums of squares of differences."""

Call = Callable[..., int | float | None]
"""Calls a C function with arrays and numbers, by its name without the header's prefix."""


def write_c_header(model: Model, path: str | Path, licence: str = "") -> ExportedFiles:
    """Write `model` to `path`, after checking it against JAX, and test vectors beside it (`fish.vectors.json`).

    Names of its functions begin with the file's name: `fish_step` in `fish.h`. The header documents them, and names
    the `licence` if there is one.

    Raises ResourceError without a C compiler, UnsupportedError for an operation without a translation to C, and
    NeuroAnimatorError if a function differs from JAX; then nothing is written.
    """
    compiler = _compiler()
    definition = definition_of(model, licence)
    name = identifier(Path(path).stem)
    text = c_header(model, definition, name)
    functions, difference = check_functions(compiled_header(text, name), model, definition)
    program = CheckedProgram(text.encode("ascii"), functions, f"C by {compiler}", difference)
    return write_program(path, definition, program)


def check_functions(
    call: Call, model: Model, definition: ProgramDefinition, *, has_gradient: bool = True
) -> tuple[dict[str, Vectors], float]:
    """Check all functions of a header against JAX; return (vectors by function, the largest difference).

    Raises NeuroAnimatorError if one differs from JAX.
    """
    values = make_vectors(definition, model)
    if not isinstance(model, Emulator):
        return {definition.name: values}, _check_policy(call, definition, values)
    check_trust(call, model, values)
    difference = check_steps(call, values)
    if not has_gradient:
        return {definition.name: values}, difference
    gradients = make_gradient_vectors(definition, model, values)
    difference = max(difference, check_gradients(call, gradients))
    return {definition.name: values, "vjp": gradients}, difference


def check_steps(call: Call, vectors: Vectors) -> float:
    """Check every way to make super steps against JAX; return the largest difference."""
    states = vectors.inputs["state"]
    controls = vectors.inputs["control"]
    singles = _room(*states.shape)
    rollouts = _room(len(states), 2, states.shape[1])
    for row, (state, control) in enumerate(zip(states, controls, strict=True)):
        call("step", state, control, singles[row])
        call("rollout", state, control, 1, rollouts[row])
    batch = _room(*states.shape)
    call("step_batch", states, controls, len(states), batch)
    ways = {"step": singles, "rollout": rollouts[:, 1], "step_batch": batch}
    return max(vectors.check({"next_state": ways[name]}, f"{name} in C") for name in ways)


def check_gradients(call: Call, vectors: Vectors) -> float:
    """Check vector-Jacobian products against JAX; return the largest difference."""
    computed = _rooms(vectors)
    arrays = [vectors.inputs[name] for name in ("state", "control", "cotangent")]
    arrays += [computed[name] for name in ("by_state", "by_control")]
    for rows in zip(*arrays, strict=True):
        call("vjp", *rows)
    return vectors.check(computed, "vjp in C")


def check_trust(call: Call, emulator: Emulator, vectors: Vectors) -> None:
    """Check trust scores against JAX; one at the edge may be rounded to either side."""
    inputs = [vectors.inputs[name] for name in ("state", "control")]
    rows = list(zip(*inputs, strict=True))
    # Compiled as a whole: operation by operation it takes longer than the rest of the check.
    scores = np.asarray(compiled_quickly(jax.vmap(partial(trust, emulator)))(*map(as_jax, inputs)))
    next_state = _room(emulator.state.size)
    trusted = np.array([call("step_trusted", *row, next_state) for row in rows])
    is_covered = np.array([call("covers", *row) == 1 for row in rows])
    are_close = np.isclose(trusted, scores, rtol=SCORE_TOLERANCE, atol=SCORE_TOLERANCE)
    if not are_close.all() or np.mean(is_covered != (scores <= EDGE)) > BORDERLINE:
        raise NeuroAnimatorError(
            "trust scores in C disagree with JAX, so nothing was written. Please report it."
        )


def _check_policy(call: Call, definition: ProgramDefinition, vectors: Vectors) -> float:
    computed = _rooms(vectors)
    for row in range(vectors.count):
        arguments = []
        for port in definition.inputs:
            numbers = vectors.inputs[port.name][row]
            arguments.append(float(numbers[0]) if port.layout is PHASE else numbers)
        outputs = [computed[name][row] for name in definition.output_names]
        call("control", *arguments, *outputs)
    return vectors.check(computed, "control in C")


def _rooms(vectors: Vectors) -> dict[str, np.ndarray]:
    """Return an array for each output."""
    return {name: _room(*array.shape) for name, array in vectors.expected.items()}


def _room(*shape: int) -> np.ndarray:
    """Return an array for C to write to."""
    return np.zeros(shape, np.float32)


def _compiler() -> str:
    compiler = find_compiler()
    if compiler is None:
        raise ResourceError(
            "A header is compiled and compared with JAX before it is written, and there is no C compiler: "
            f"{HOW_TO_GET_ONE}."
        )
    return Path(shlex.split(compiler)[0]).name


def compiled_header(text: str, name: str) -> Call:
    """Return a function that calls the compiled functions of a header."""
    compiler = _compiler()
    library = compiled_library(f"#define {name.upper()}_IMPLEMENTATION\n{text}", FLAGS)
    if library is None:
        reason = obstacle()
        if reason is not None:
            raise ResourceError(
                f"{name}.h: it could not be compiled to be checked, so nothing was written ({reason}). Try again later."
            )
        raise NeuroAnimatorError(f"{compiler} does not compile {name}.h. Please report it.")

    def call(function: str, *arguments: np.ndarray | float) -> int | float | None:
        converted = [_converted(argument) for argument in arguments]
        called = library[f"{name}_{function}"]
        called.restype = ctypes.c_float if function in SCORES else ctypes.c_int
        return called(*converted)

    return call


def _converted(argument: np.ndarray | float) -> ctypes.c_void_p | ctypes.c_int | ctypes.c_float:
    """Return an argument as C takes it; arrays must be float32 in C order."""
    if isinstance(argument, np.ndarray):
        assert argument.dtype == np.float32
        assert argument.flags.c_contiguous
        return ctypes.c_void_p(argument.ctypes.data)
    if isinstance(argument, int):
        return ctypes.c_int(argument)
    return ctypes.c_float(argument)
