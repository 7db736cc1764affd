"""Write an emulator or a policy as a WebAssembly module, with the ES module that calls it and its types."""

from __future__ import annotations

import ctypes
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from neuroanimator.codegen.wasm import wasm_module
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ResourceError
from neuroanimator.export.programs.c_file import check_functions
from neuroanimator.export.programs.c_header import (
    about,
    c_header,
    filled,
    identifier,
    stored_latent_size,
)
from neuroanimator.export.programs.definition import (
    PHASE,
    Model,
    Port,
    ProgramDefinition,
    definition_of,
    emulator_of,
)
from neuroanimator.export.programs.exported_files import (
    CheckedProgram,
    ExportedFiles,
    write_program,
)

if TYPE_CHECKING:
    import wasmtime

FUNCTIONS = {
    "emulator": (
        "step",
        "step_batch",
        "rollout",
        "encode",
        "advance_batch",
        "vjp",
        "covers",
        "trust",
        "step_trusted",
    ),
    "policy": ("control",),
    "state-policy": ("control",),
    "commanded-policy": ("control",),
}
"""Functions that a module exports, by the kind of its model."""

NUMBERS = ("rest", "control_low", "control_high")
"""Arrays that it exports."""

ALIGNMENT = 64
"""Alignment of arrays in a module's memory [bytes]."""

PAGE = 1 << 16
"""Size of a page, by which a module's memory grows [bytes]."""


def write_wasm(model: Model, path: str | Path, licence: str = "") -> ExportedFiles:
    """Write `model` to `path`, after checking it against JAX, with `fish.js`, `fish.d.ts` and test vectors beside it.

    The ES module documents its functions, and names the `licence` if there is one.

    Raises ResourceError without Zig and wasmtime, UnsupportedError for an operation without a translation to C, and
    NeuroAnimatorError if a function differs from JAX; then nothing is written.
    """
    definition = definition_of(model, licence)
    name = identifier(Path(path).stem)
    callers = {
        suffix: _filled(suffix, model, definition, name).encode("ascii")
        for suffix in (".js", ".d.ts")
    }
    return write_program(path, definition, checked_wasm(model, definition, name), callers)


def checked_wasm(
    model: Model, definition: ProgramDefinition, name: str, *, has_gradient: bool = True
) -> CheckedProgram:
    """Return the module, whose functions' names begin with `name`; raises as `write_wasm`.

    An emulator's without its gradient is a third smaller.
    """
    runtime = import_wasmtime()
    content = wasm_bytes(model, definition, name, has_gradient=has_gradient)
    call = WasmModule(runtime, content, name).call
    functions, difference = check_functions(call, model, definition, has_gradient=has_gradient)
    return CheckedProgram(content, functions, "wasmtime", difference)


def wasm_bytes(
    model: Model, definition: ProgramDefinition, name: str, *, has_gradient: bool = True
) -> bytes:
    """Return the module, whose functions' names begin with `name`."""
    header = c_header(model, definition, name, has_gradient=has_gradient)
    text = f"#define {name.upper()}_IMPLEMENTATION\n{header}"
    exports = [*FUNCTIONS[definition.facts["kind"]], *NUMBERS]
    if not has_gradient:
        exports.remove("vjp")
    return wasm_module(text, name, exports)


class WasmModule:
    """A WebAssembly module that runs in this process, isolated from it; the names of what it exports begin with `name`."""

    def __init__(self, runtime: Any, content: bytes, name: str):
        self._name = name
        self._store: wasmtime.Store = runtime.Store()
        module = runtime.Module(self._store.engine, content)
        self._exports = runtime.Instance(self._store, module, []).exports(self._store)
        if "_initialize" in self._exports:  # of a C library, if it has one
            self._exports["_initialize"](self._store)

    def write(self, variable: str, numbers: np.ndarray) -> None:
        """Write to one of the module's arrays."""
        address = self._exports[f"{self._name}_{variable}"].value(self._store)
        ctypes.memmove(self._start() + address, numbers.ctypes.data, numbers.nbytes)

    def call(self, function: str, *arguments: np.ndarray | float) -> int | float | None:
        """Call a function with arrays, which are copied in and back, and numbers."""
        top = self._exports["__heap_base"].value(self._store)
        placed: list[tuple[np.ndarray, int]] = []
        converted: list[float] = []
        for argument in arguments:
            if isinstance(argument, np.ndarray):
                top = -(-top // ALIGNMENT) * ALIGNMENT
                placed.append((argument, top))
                converted.append(top)
                top += argument.nbytes
            else:
                converted.append(argument)
        self._make_room(top)
        for array, address in placed:
            ctypes.memmove(self._start() + address, array.ctypes.data, array.nbytes)
        answer = self._exports[f"{self._name}_{function}"](self._store, *converted)
        for array, address in placed:
            ctypes.memmove(array.ctypes.data, self._start() + address, array.nbytes)
        return answer

    def _start(self) -> int:
        """Return the address in this process of the module's memory, which moves when it grows."""
        pointer = self._exports["memory"].data_ptr(self._store)
        return ctypes.cast(pointer, ctypes.c_void_p).value or 0

    def _make_room(self, size: int) -> None:
        memory = self._exports["memory"]
        missing = size - memory.data_len(self._store)
        if missing > 0:
            memory.grow(self._store, -(-missing // PAGE))


def _filled(suffix: str, model: Model, definition: ProgramDefinition, name: str) -> str:
    """Return the ES module, or its types, with names, sizes and facts filled in."""
    facts = definition.facts
    emulator = emulator_of(model)
    kind = facts["kind"]
    if suffix == ".js" and not isinstance(model, Emulator):
        kind = "policy"  # the arguments of its function are filled in
    values = {
        "about": about(definition),
        "generator": facts["generator"],
        "loading": filled("loading.js", {}),
        "measures": filled("measures.d.ts", {}).rstrip(),
        "name": name,
        "facts": json.dumps(facts),
        "inputs": json.dumps([(port.name, _length(port)) for port in definition.inputs]),
        "outputs": json.dumps([(port.name, port.layout.size) for port in definition.outputs]),
        "state": str(emulator.state.size),
        "control": str(emulator.control.size),
        "latent": str(stored_latent_size(emulator)),
    }
    return filled(f"{kind}{suffix}", values)


def _length(port: Port) -> int:
    """Return the length of an input's array; 0 if it is a number."""
    return 0 if port.layout is PHASE else port.layout.size


def import_wasmtime() -> Any:
    """Return the package that runs modules; ResourceError without it."""
    try:
        import wasmtime
    except ImportError:
        raise ResourceError(
            "A WebAssembly module is run before it is written, and wasmtime is missing. Install it with: "
            "pip install 'neuroanimator[wasm]'"
        ) from None
    return wasmtime
