"""Emulators on a GPU: super steps per second by batch size, beside the device's roofline and MuJoCo MJX.

python benchmarks/gpu.py                        batches of 1e3 to 1e7, and results/gpu.csv; without a GPU one line, and no file
python benchmarks/gpu.py --device cpu --quick   the same program, small, on the CPU: a test, no figures

Everything is float32, including matrix products. Compilation is timed separately. MJX (pip install mujoco-mjx) steps the pendulum
by the cheapest scheme that is as accurate over a super step as the emulator; without it that column is empty. The roofline is the
smaller of the limits by the measured rates of arithmetic and of memory: a super step reads and writes its own state and control
once, weights stay on the chip.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator import Emulator, load_emulator
from neuroanimator.emulator.c_emulator import c_emulator
from neuroanimator.evaluation.accuracy import one_step_error, root_mean_square, scheme_error
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.held_out import HeldOut, held_out_runs
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.system import Scheme
from neuroanimator.terminal import print_table

EMULATORS = ("pendulum-50", "fish-50")

BATCHES = (1_000, 10_000, 100_000, 1_000_000, 10_000_000)

QUICK_BATCHES = (64, 1_000)

STEPS = 50
"""Super steps in a timed call: launching it then costs little."""

QUICK_STEPS = 5

ROUNDS = 7

QUICK_ROUNDS = 2

MJX_INTEGRATORS = ("euler", "implicitfast", "rk4")
"""Those that MJX has."""

DIVISIONS = (1, 2, 3, 4, 5, 8, 10, 16, 20, 25, 40, 50)
"""Physics steps in a super step, tried for each integrator."""

EVALUATIONS = {"euler": 1, "implicitfast": 1, "rk4": 4}
"""Number of accelerations that an integrator computes in a step: its cost."""

ROUNDING = 1e-5
"""Maximum difference of a super step in JAX from one in C, over the largest number."""

PEAK_SIZE = 4096
"""Rows and columns of the product by which the rate of arithmetic is measured."""

QUICK_PEAK_SIZE = 512

OUT_OF_MEMORY = "RESOURCE_EXHAUSTED"
"""What JAX says where a batch is too large."""


class Peaks(NamedTuple):
    """What a device can do, measured."""

    operations: float
    """Floating-point operations a second, of a product of large matrices."""
    bytes: float
    """Bytes read and written a second, of a copy."""


class Timed(NamedTuple):
    """What a program costs."""

    compile_seconds: float
    seconds: float
    """Median of all rounds."""
    fastest_seconds: float


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--device", choices=("gpu", "cpu"), default="gpu")
    parser.add_argument("--quick", action="store_true", help="small, for a look; writes no file")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    options = parser.parse_args()
    device = _device(options.device)
    if device is None:
        seen = ", ".join(str(one) for one in jax.devices())
        print(f"No GPU is at hand: nothing was measured. JAX sees {seen}.")
        return
    with jax.default_device(device), jax.default_matmul_precision("highest"):
        rows = list(_rows(options.quick))
    if not options.quick and options.device == "gpu":
        write_csv(options.out / "gpu.csv", [{"device": device.device_kind} | row for row in rows])
    print_table(rows)
    print(f"{device.device_kind}; {describe_machine()}")


def _device(kind: str) -> jax.Device | None:
    try:
        return jax.devices(kind)[0]
    except RuntimeError:
        return None


def _rows(is_quick: bool) -> Iterator[dict[str, Any]]:
    steps, rounds = (QUICK_STEPS, QUICK_ROUNDS) if is_quick else (STEPS, ROUNDS)
    peaks = _peaks(QUICK_PEAK_SIZE if is_quick else PEAK_SIZE)
    for name in EMULATORS:
        emulator = load_emulator(name)
        rounding = _difference_from_c(emulator)
        if not rounding <= ROUNDING:
            raise SystemExit(
                f"{name}: a super step is off by {rounding:.2g} from C. Nothing is timed."
            )
        opponent = _opponent(emulator)
        for batch in QUICK_BATCHES if is_quick else BATCHES:
            row = {"emulator": name, "batch": batch, "off_from_c": rounding}
            timed = _tried(partial(_emulated, emulator, batch, steps), rounds)
            row |= _emulator_columns(emulator, batch, steps, timed, peaks)
            row |= _opponent_columns(opponent, batch, is_quick, timed, steps)
            yield row


def _emulator_columns(
    emulator: Emulator, batch: int, steps: int, timed: Timed | None, peaks: Peaks
) -> dict[str, Any]:
    """Return the emulator's rate beside what the device allows; a batch too large for its memory has none."""
    bound = _roofline(emulator, peaks)
    if timed is None:
        return {
            "compile_s": "",
            "steps_per_s": "out of memory",
            "roofline": bound,
            "of_roofline": "",
        }
    rate = batch * steps / timed.seconds
    return {
        "compile_s": timed.compile_seconds,
        "steps_per_s": rate,
        "roofline": bound,
        "of_roofline": rate / bound,
    }


def _emulated(
    emulator: Emulator, batch: int, steps: int
) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    """Return (a function that makes `steps` super steps of `batch` motions under random controls, its arguments)."""
    bounds = emulator.bounds
    rest = jnp.asarray(emulator.encode(np.asarray(emulator.rest)), jnp.float32)
    low = jnp.asarray(bounds.low, jnp.float32)
    high = jnp.asarray(bounds.high, jnp.float32)
    leap = jax.vmap(emulator.step_latent)

    def run(latent: jax.Array, key: jax.Array) -> jax.Array:
        shares = jax.random.uniform(key, (batch, len(low)))
        controls = emulator.encode_control(low + shares * (high - low))
        # Held: drawing controls anew at every super step would be timed as well.
        return jax.lax.fori_loop(0, steps, lambda _, latent: leap(latent, controls), latent)

    return run, (jnp.tile(rest, (batch, 1)), jax.random.key(0))


def _tried(
    make: Callable[[], tuple[Callable[..., Any], tuple[Any, ...]]], rounds: int
) -> Timed | None:
    """Return what a function costs; None where the device has not the memory."""
    try:
        return _timed(*make(), rounds)
    except jax.errors.JaxRuntimeError as error:
        if OUT_OF_MEMORY in str(error):
            return None
        raise


def _timed(function: Callable[..., Any], arguments: tuple[Any, ...], rounds: int) -> Timed:
    began = time.perf_counter()
    program = jax.jit(function).lower(*arguments).compile()
    compile_seconds = time.perf_counter() - began
    jax.block_until_ready(program(*arguments))
    spans = []
    for _ in range(rounds):
        began = time.perf_counter()
        jax.block_until_ready(program(*arguments))
        spans.append(time.perf_counter() - began)
    return Timed(compile_seconds, float(np.median(spans)), min(spans))


def _peaks(size: int) -> Peaks:
    square = jnp.ones((size, size), jnp.float32)
    product = _timed(lambda a: a @ a, (square,), ROUNDS)
    long = jnp.ones(16 * size * size, jnp.float32)
    copy = _timed(lambda a: a + 1, (long,), ROUNDS)
    return Peaks(2 * size**3 / product.fastest_seconds, 2 * long.nbytes / copy.fastest_seconds)


def _roofline(emulator: Emulator, peaks: Peaks) -> float:
    """Return how many super steps a second the device allows, by what XLA counts of one step of many motions."""
    count = 1024
    latent = jnp.zeros((count, emulator.encode(np.asarray(emulator.rest)).shape[-1]), jnp.float32)
    controls = jnp.zeros((count, emulator.control.size), jnp.float32)
    program = jax.jit(jax.vmap(emulator.step_latent)).lower(latent, controls).compile()
    analysis = program.cost_analysis() or {}
    operations = float(analysis.get("flops", 0)) / count
    moved = 4 * (2 * latent.shape[1] + controls.shape[1])
    by_operations = peaks.operations / operations if operations else float("inf")
    return min(by_operations, peaks.bytes / moved)


def _difference_from_c(emulator: Emulator) -> float:
    """Return by how much of its largest number a super step on this device differs from generated C; 0 without a compiler."""
    program = c_emulator(emulator)
    if program is None:
        return 0.0
    test = held_out_runs(emulator, 8)
    states, controls, _ = test.transitions
    states = states.astype(np.float32)
    controls = controls.astype(np.float32)
    in_jax = np.asarray(emulator.rollout(jnp.asarray(states), jnp.asarray(controls[:, None])))[:, 1]
    in_c, _ = program.rollouts(states, np.ascontiguousarray(controls[:, None]))
    return float(np.abs(in_jax - in_c[:, 1]).max() / np.abs(in_c).max())


class Opponent(NamedTuple):
    """MJX, stepping by the cheapest scheme that is as exact as the emulator."""

    system: MujocoSystem
    test: HeldOut
    scheme: Scheme
    substeps: int
    error: float
    emulator_error: float


def _opponent(emulator: Emulator) -> Opponent | None:
    """Return whom the emulator is held against; None where it is no body of MuJoCo's, or MJX is not installed."""
    try:
        from mujoco import mjx
    except ImportError:
        return None
    del mjx
    test = held_out_runs(emulator, 16)
    system = test.system
    if not isinstance(system, MujocoSystem):
        return None
    error = float(root_mean_square(one_step_error(emulator, test)))
    able = []
    for integrator in MJX_INTEGRATORS:
        for parts in DIVISIONS:
            scheme = Scheme(integrator, test.dt / parts)
            its_error = scheme_error(test, scheme)
            if its_error <= error:
                able.append((EVALUATIONS[integrator] * parts, parts, its_error, scheme))
    if not able:
        return None
    _, parts, its_error, scheme = min(able, key=lambda one: one[:3])
    return Opponent(system, test, scheme, parts, its_error, error)


def _opponent_columns(
    opponent: Opponent | None, batch: int, is_quick: bool, timed: Timed | None, steps: int
) -> dict[str, Any]:
    """Return MJX's rate in super steps, and how many times faster the emulator is."""
    names = ("error", "mjx_error", "mjx_scheme", "mjx_compile_s", "mjx_steps_per_s", "times_mjx")
    empty: dict[str, Any] = dict.fromkeys(names, "")
    if opponent is None:
        return empty
    rounds = QUICK_ROUNDS if is_quick else ROUNDS
    physics = _tried(partial(_stepped, opponent, batch), rounds)
    shown = f"{opponent.scheme.integrator} x{opponent.substeps}"
    empty |= {"error": opponent.emulator_error, "mjx_error": opponent.error, "mjx_scheme": shown}
    if physics is None:
        return empty | {"mjx_steps_per_s": "out of memory"}
    rate = batch / physics.seconds
    faster = ""
    if timed is not None:
        faster = batch * steps / timed.seconds / rate
    return empty | {
        "mjx_compile_s": physics.compile_seconds,
        "mjx_steps_per_s": rate,
        "times_mjx": faster,
    }


def _stepped(opponent: Opponent, batch: int) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    """Return (a function that takes `batch` motions through one super step by MJX, its arguments)."""
    from mujoco import mjx

    own_model = opponent.system.model_with(opponent.scheme)
    model = mjx.put_model(own_model)
    data = mjx.make_data(own_model)
    starts, controls = opponent.test.moments(batch)
    size = own_model.nq

    def one(state: jax.Array, control: jax.Array) -> jax.Array:
        begun = data.replace(qpos=state[:size], qvel=state[size:], ctrl=control)
        ended = jax.lax.fori_loop(0, opponent.substeps, lambda _, at: mjx.step(model, at), begun)
        return jnp.concatenate([ended.qpos, ended.qvel])

    arguments = (jnp.asarray(starts, jnp.float32), jnp.asarray(controls, jnp.float32))
    return jax.vmap(one), arguments


if __name__ == "__main__":
    main()
