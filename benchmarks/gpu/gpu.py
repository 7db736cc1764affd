"""Cores against a card: super steps a second by batch size of emulators and of MuJoCo, each on both; beside the card's roofline.

python -m benchmarks.gpu.gpu                       pendulum, fish and human; without a GPU one line, and no file
python -m benchmarks.gpu.gpu --ant FILE            an ant, too: an emulator made by `new Ant-v5` and `train`
python -m benchmarks.gpu.gpu --device cpu --quick  the same program, small, on the CPU: a test, no figures

Four contestants take super steps of the same bodies from the same states under the same controls, in turn: the emulator on the
card (JAX) and on all cores (generated C), MJX on the card, and MuJoCo in C on all cores. MuJoCo and MJX each step by the cheapest
scheme that is as accurate over a super step as the emulator; `own_...` is MuJoCo by the model's own scheme, `times_real` how
many seconds pass in one second of the card. Everything on the card is float32, including matrix products. Compilation is timed
separately. The human walks by the policy in examples/human, and so are the states that he is measured at.

Takes at most eight minutes on an H200 with 16 cores. Beside JAX it needs, as wheels: mujoco 3.17 (7 MB), mujoco-mjx 3.17 (7 MB;
without it its columns are empty) and what the package needs to be imported. MuJoCo Warp is left out: its compiler alone is a
wheel of more than 100 MB. The roofline is the smaller of the limits by the measured rates of arithmetic and of memory: a super
step reads and writes its own state and control once, weights stay on the chip.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.following.emulated_walk import walk
from benchmarks.harness import HUMAN, keep_rows, parser_of, seconds_of, show_rows
from neuroanimator import Emulator, load_emulator
from neuroanimator.cli.policy_returns import loaded_policy
from neuroanimator.codegen.cores import core_count
from neuroanimator.emulator.c_emulator import c_emulator
from neuroanimator.emulator.runner import program_of
from neuroanimator.learn.evaluation.accuracy import one_step_error, root_mean_square, scheme_error
from neuroanimator.learn.evaluation.held_out import HeldOut, held_out_runs, make_test
from neuroanimator.physics.loading import trust_files
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.system import Scheme

BATCHES = (1_000, 10_000, 100_000, 1_000_000)

MJX_BATCHES = (10_000, 100_000)
"""Those at which MJX is measured: it compiles for up to a minute for each."""

MAX_PHYSICS = 2_000
"""Largest number of bodies that MuJoCo steps in a timed call: its rate no longer changes from there on."""

MAX_ON_CORES = 100_000
"""Largest batch that is measured on the cores, whose rate no longer changes from there on."""

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

EVALUATIONS = {"euler": 1, "implicitfast": 1, "implicit": 1, "rk4": 4}
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


class Body(NamedTuple):
    """One body that all contestants step."""

    name: str
    emulator: Emulator
    test: HeldOut
    """States and controls that it is timed at, and by which schemes are held against the emulator."""


def main() -> None:
    parser = parser_of(__doc__, quick="small, for a look")
    parser.add_argument("--device", choices=("gpu", "cpu"), default="gpu")
    parser.add_argument("--ant", type=Path, help="an emulator of Gymnasium's ant")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    options = parser.parse_args()
    device = _device(options.device)
    if device is None:
        seen = ", ".join(str(one) for one in jax.devices())
        print(f"No GPU is at hand: nothing was measured. JAX sees {seen}.")
        return
    began = time.perf_counter()
    rows = []
    with jax.default_device(device), jax.default_matmul_precision("highest"):
        peaks = _peaks(QUICK_PEAK_SIZE if options.quick else PEAK_SIZE)
        for body in _bodies(options.ant):
            for row in _rows(body, peaks, options.quick):
                rows.append({"device": device.device_kind} | row)
                print(f"{time.perf_counter() - began:.0f} s: {rows[-1]}", flush=True)
            if options.device == "gpu":
                keep_rows(options.out / "gpu.csv", rows, options)
    show_rows(rows)


def _bodies(ant: Path | None) -> Iterator[Body]:
    for name in ("pendulum-50", "fish-50"):
        emulator = load_emulator(name)
        yield Body(name, emulator, held_out_runs(emulator, 16))
    yield _human()
    if ant is not None:
        trust_files(ant.with_suffix("").with_suffix(".toml"))
        emulator = load_emulator(ant)
        yield Body("ant", emulator, held_out_runs(emulator, 16))


def _human() -> Body:
    """Return the human who walks on command, at states of a walk."""
    policy, system, task = loaded_policy(
        HUMAN / "human.policy.safetensors", HUMAN / "commanded.toml"
    )
    assert isinstance(system, MujocoSystem)
    starts, controls, _ = walk(policy, task, system)
    driven = np.ascontiguousarray(np.swapaxes(controls, 0, 1))
    runs = system.simulate(starts, driven, policy.dt, scheme=system.fine, threads=core_count())
    test = make_test(system, policy.dt, runs.states, driven)
    return Body("human", policy.emulator, test)


def _device(kind: str) -> Any:
    """Return the first device of a kind; None if there is none."""
    try:
        return jax.devices(kind)[0]
    except RuntimeError:
        return None


def _rows(body: Body, peaks: Peaks, is_quick: bool) -> Iterator[dict[str, Any]]:
    """Yield a row a batch: rates of all contestants in super steps a second."""
    steps, rounds = (QUICK_STEPS, QUICK_ROUNDS) if is_quick else (STEPS, ROUNDS)
    emulator, test = body.emulator, body.test
    rounding = _difference_from_c(body)
    if not rounding <= ROUNDING:
        raise SystemExit(f"{body.name}: off by {rounding:.2g} from C. Nothing is timed.")
    opponents = _opponents(body)
    roofline = _roofline(emulator, peaks)
    for batch in QUICK_BATCHES if is_quick else BATCHES:
        row: dict[str, Any] = {"body": body.name, "batch": batch, "off_from_c": rounding}
        row["error"] = float(root_mean_square(one_step_error(emulator, test)))
        # the emulator, on both
        on_card = _tried(partial(_emulated, body, batch, steps), rounds)
        row |= _card_columns("emulator_on_card", on_card, batch * steps)
        row |= {"roofline": roofline, "emulator_on_cores": ""}
        if batch <= MAX_ON_CORES:
            row["emulator_on_cores"] = _rate_on_cores(body, batch, steps, rounds)
        # the physics, on both
        row |= _physics_columns(body, opponents, batch, is_quick)
        yield row | _ratios(row, emulator.dt)


def _card_columns(name: str, timed: Timed | None, steps: int) -> dict[str, Any]:
    if timed is None:
        return {name: "out of memory", f"{name}_compile_s": ""}
    return {name: steps / timed.seconds, f"{name}_compile_s": timed.compile_seconds}


def _ratios(row: dict[str, Any], dt: float) -> dict[str, Any]:
    """Return what one of the rates is worth beside another; empty where one of them is missing."""
    pairs = {
        "emulator_on_card_times_mjx": ("emulator_on_card", "mjx_on_card"),
        "emulator_on_cores_times_mujoco": ("emulator_on_cores", "mujoco_on_cores"),
        "emulator_on_cores_times_mjx": ("emulator_on_cores", "mjx_on_card"),
        "card_times_cores": ("emulator_on_card", "emulator_on_cores"),
    }
    found: dict[str, Any] = {}
    for name, (above, below) in pairs.items():
        rates = row[above], row[below]
        is_known = all(isinstance(rate, float) for rate in rates)
        found[name] = rates[0] / rates[1] if is_known else ""
    for name in ("emulator_on_card", "emulator_on_cores", "mjx_on_card", "mujoco_on_cores"):
        found[f"{name}_times_real"] = row[name] * dt if isinstance(row[name], float) else ""
    return found


def _rate_on_cores(body: Body, batch: int, steps: int, rounds: int) -> float:
    """Return the emulator's rate in generated C on all cores, as NumPy users run it."""
    program = program_of(body.emulator)
    assert program is not None, "There is no C compiler."
    starts, controls = body.test.moments(batch)
    held = np.repeat(controls[:, None].astype(np.float32), steps, axis=1)
    begun = starts.astype(np.float32)
    return batch * steps / _median_seconds(partial(program.rollouts, begun, held), rounds)


def _median_seconds(play: Callable[[], Any], rounds: int) -> float:
    play()
    return float(np.median(seconds_of(play, rounds)))


def _physics_columns(
    body: Body, opponents: dict[str, Scheme], batch: int, is_quick: bool
) -> dict[str, Any]:
    """Return the rates of MuJoCo on all cores and of MJX on the card."""
    names = (
        "mjx_on_card",
        "mjx_on_card_compile_s",
        "mjx_scheme",
        "mujoco_on_cores",
        "mujoco_scheme",
    )
    found: dict[str, Any] = dict.fromkeys((*names, "mujoco_on_cores_own"), "")
    system, test = body.test.system, body.test
    if not isinstance(system, MujocoSystem):
        return found
    rounds = QUICK_ROUNDS if is_quick else ROUNDS
    for label, scheme in {"": opponents["mujoco"], "_own": system.scheme}.items():
        if batch > MAX_ON_CORES:
            break
        count = min(batch, MAX_PHYSICS)
        starts, controls = test.moments(count)
        play = partial(
            system.simulate, starts, controls[:, None], test.dt, scheme=scheme, threads=core_count()
        )
        found[f"mujoco_on_cores{label}"] = count / _median_seconds(play, rounds)
    found["mujoco_scheme"] = _in_words(opponents["mujoco"], test.dt)
    if "mjx" in opponents and (is_quick or batch in MJX_BATCHES):
        timed = _tried(partial(_stepped, body, opponents["mjx"], batch), 1 if is_quick else 3)
        found |= _card_columns("mjx_on_card", timed, batch)
        found["mjx_scheme"] = _in_words(opponents["mjx"], test.dt)
    return found


def _in_words(scheme: Scheme, dt: float) -> str:
    return f"{scheme.integrator} x{scheme.steps(dt)}"


def _emulated(body: Body, batch: int, steps: int) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    """Return (a function that makes `steps` super steps of `batch` motions under held controls, its arguments)."""
    emulator = body.emulator
    starts, controls = body.test.moments(batch)
    latent = jnp.asarray(emulator.encode(starts.astype(np.float32)), jnp.float32)
    held = jnp.asarray(emulator.encode_control(controls.astype(np.float32)), jnp.float32)
    leap = jax.vmap(emulator.step_latent)

    def run(latent: jax.Array, held: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, steps, lambda _, latent: leap(latent, held), latent)

    return run, (latent, held)


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
    spans = seconds_of(lambda: jax.block_until_ready(program(*arguments)), rounds)
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


def _difference_from_c(body: Body) -> float:
    """Return by how much of its largest number a super step on this device differs from generated C; 0 without a compiler."""
    program = c_emulator(body.emulator)
    if program is None:
        return 0.0
    states, controls, _ = body.test.transitions
    states = states.astype(np.float32)
    controls = controls.astype(np.float32)
    rollout = body.emulator.rollout(jnp.asarray(states), jnp.asarray(controls[:, None]))
    in_jax = np.asarray(rollout)[:, 1]
    in_c, _ = program.rollouts(states, np.ascontiguousarray(controls[:, None]))
    return float(np.abs(in_jax - in_c[:, 1]).max() / np.abs(in_c).max())


def _opponents(body: Body) -> dict[str, Scheme]:
    """Return the schemes by which MuJoCo and, if installed, MJX step: the cheapest as accurate as the emulator."""
    test = body.test
    if not isinstance(test.system, MujocoSystem):
        return {}
    error = float(root_mean_square(one_step_error(body.emulator, test)))
    able = []
    for integrator, cost in EVALUATIONS.items():
        for parts in DIVISIONS:
            scheme = Scheme(integrator, test.dt / parts)
            its_error = scheme_error(test, scheme)
            if its_error <= error:
                able.append((cost * parts, its_error, scheme))
    able.sort(key=lambda one: one[:2])
    of_mjx = [scheme for _, _, scheme in able if scheme.integrator in MJX_INTEGRATORS]
    own = test.system.scheme
    found = {"mujoco": able[0][2] if able else own}
    if importlib.util.find_spec("mujoco.mjx") is not None:
        found["mjx"] = of_mjx[0] if of_mjx else own
    return found


def _stepped(body: Body, scheme: Scheme, batch: int) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    """Return (a function that takes `batch` motions through one super step by MJX, its arguments)."""
    from mujoco import mjx

    system = body.test.system
    assert isinstance(system, MujocoSystem)
    own_model = system.model_with(scheme)
    model = mjx.put_model(own_model)
    data = mjx.make_data(own_model)
    starts, controls = body.test.moments(batch)
    ends = own_model.nq, own_model.nq + own_model.nv
    substeps = scheme.steps(body.test.dt)

    def one(state: jax.Array, control: jax.Array) -> jax.Array:
        begun = data.replace(qpos=state[: ends[0]], qvel=state[ends[0] : ends[1]], ctrl=control)
        ended = jax.lax.fori_loop(0, substeps, lambda _, at: mjx.step(model, at), begun)
        return jnp.concatenate([ended.qpos, ended.qvel])

    arguments = (jnp.asarray(starts, jnp.float32), jnp.asarray(controls, jnp.float32))
    return jax.vmap(one), arguments


if __name__ == "__main__":
    main()
