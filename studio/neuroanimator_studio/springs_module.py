"""A mass-spring body's physics as a WebAssembly module that is called as an emulator's is."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.authoring import INTEGRATORS, DeformableSystem, c_source, wasm_module

CALLS = Path(__file__).with_name("mass_spring_calls.c")
"""What can be called, the same for every body."""

AS_EMULATOR = ("step", "rollout", "encode", "advance_batch", "covers", "rest")
"""What is called as of an emulator."""

AS_REPLAY = ("rollout", "rollout_usual")
"""What replays motions, by the truth and as a user would run it."""

EXPONENTIAL = """static double exponential(double exponent) {
    if (exponent < -1) {
        const double half = exponential(exponent / 2);
        return half * half;
    }
    double sum = 1;
    for (int n = 20; n > 0; n--) sum = 1 + exponent * sum / n;
    return sum;
}
#define exp exponential
"""
"""e to the power of a negative number, by which muscles relax.

WebAssembly has no instruction for it, and the library that has it takes Zig most of a minute to build.
"""


def physics_module(
    system: DeformableSystem, dt: float, name: str, exports: tuple[str, ...]
) -> bytes:
    """Return the module whose super steps are `dt` [s] of the true physics; the names of its `exports` begin with `name`.

    Raises ResourceError without Zig, and NeuroAnimatorError where it fails.
    """
    body = system.body
    numbers = ", ".join(f"{number:.9g}" for number in system.rest)
    lines = [
        f"#define NAME {name}",
    ]
    # how a super step is made, by the truth and as a user would run it
    for prefix, scheme in (("", system.truth), ("USUAL_", system.scheme)):
        lines += [
            f"#define {prefix}INTEGRATOR {INTEGRATORS.index(scheme.integrator)}",
            f"#define {prefix}STEPS {scheme.steps(dt)}",
            f"#define {prefix}DT {scheme.dt!r}",
        ]
    lines += [
        EXPONENTIAL,
        c_source(body, "double", 1),
        f"const float {name}_rest[] = {{{numbers}}};",
        CALLS.read_text(encoding="utf-8"),
    ]
    return wasm_module("\n".join(lines), name, exports)
