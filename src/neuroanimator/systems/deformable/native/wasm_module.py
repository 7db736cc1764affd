"""A mass-spring body's physics as a WebAssembly module that is called as an emulator's is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.compiler.wasm import wasm_module
from neuroanimator.systems.deformable.body import Body
from neuroanimator.systems.deformable.native.compiled import INTEGRATORS
from neuroanimator.systems.deformable.native.source import c_source
from neuroanimator.systems.system import Scheme

CALLS = Path(__file__).with_name("mass_spring_calls.c")
"""What can be called, the same for every body."""

FUNCTIONS = ("step", "rollout", "encode", "advance_batch", "covers")
"""What the module exports beside `rest`; their names begin with that of the module."""


def physics_module(
    body: Body, scheme: Scheme, dt: float, rest: Float[np.ndarray, " S"], name: str
) -> bytes:
    """Return the module whose super steps are `dt` [s] of the physics by `scheme`, and whose functions begin with `name`.

    Raises ResourceError without Zig, and CompilerError where it fails.
    """
    numbers = ", ".join(f"{number:.9g}" for number in rest)
    lines = [
        f"#define NAME {name}",
        f"#define INTEGRATOR {INTEGRATORS.index(scheme.integrator)}",
        f"#define STEPS {scheme.steps(dt)}",
        f"#define DT {scheme.dt!r}",
    ]
    if not body.time_constant:
        # Only muscles relax by it. WebAssembly has no instruction for it, and Zig builds no library in vain.
        lines.append("#define exp(exponent) 0.0")
    lines += [
        c_source(body, "double", 1),
        f"const float {name}_rest[] = {{{numbers}}};",
        CALLS.read_text(encoding="utf-8"),
    ]
    exports = [f"{name}_{export}" for export in (*FUNCTIONS, "rest")]
    return wasm_module("\n".join(lines), exports)
