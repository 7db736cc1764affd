"""How fast: compiled against compiled, one core against one core, interleaved in one process.

An emulator is timed in JAX and as C generated from it; the faster counts, as the physics is C.

A Python function is the exception: it is timed as its author runs it, and the report says so.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import mujoco
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.codegen.c_emulator import CEmulator, c_emulator
from neuroanimator.emulator.emulator import UNROLL, Emulator
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.evaluation.accuracy import HeldOut, scheme_error
from neuroanimator.evaluation.speed_function import (
    FUNCTION_STEPS,
    PYTHON_FUNCTION,
    function_error,
    function_player,
    function_schemes,
)
from neuroanimator.evaluation.speed_mass_spring import (
    PLAIN,
    deformable_players,
    deformable_schemes,
    twin_error,
)
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.systems.functions.function_system import FUNCTION, PythonSystem
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.rigid.warnings import warnings_counted
from neuroanimator.systems.system import Scheme

PHYSICS_STEPS = 20_000
"""Length of the timed run: the measure of the 1998 table."""

TIMED_SUPER_STEPS = 8_000
"""Super steps in one timed call of the emulator, so that the call itself (30 µs from Python) does not count."""

IN_JAX, IN_C = "emulator in JAX", "emulator in C"

REPEATS = 9
"""Timings of each side; the median is reported."""

STRETCHES = 40
"""Fresh starts within a timed run of the physics: few enough that Python between them does not count."""

OPPONENT_INTEGRATORS = ("euler", "implicitfast", "implicit", "rk4")
OPPONENT_DIVISIONS = (1, 2, 3, 4, 5, 8, 10, 16, 20, 25, 40, 50)
"""Physics steps per super step tried for each integrator, besides the system's own."""


@dataclass(frozen=True)
class Opponent:
    """One way to step the physics through a super step."""

    scheme: Scheme
    error: float
    """One-step error against fine physics, over the change's standard deviation."""
    seconds: float
    """Time for one super step [s]."""


@dataclass(frozen=True)
class Speed:
    """Both speed-ups, one core, one trajectory."""

    emulator_seconds: float
    """Per super step, by the faster of generated C and JAX."""
    physics_seconds: float
    """Per physics step of the system's own scheme."""
    nominal: float
    """`PHYSICS_STEPS` of the system's own scheme against the super steps that replace them."""
    equal_error: float
    """Against the fastest physics whose error is no larger than the emulator's."""
    rival: Opponent
    """That fastest physics."""
    opponents: tuple[Opponent, ...]
    physics: str = "MuJoCo"
    """Who steps the physics: `MuJoCo` or a `C twin`, compiled, `JAX` without one, a `Python function`, which is not."""
    tuned_seconds: float | None = None
    """Per physics step of the same scheme by a program made for this body alone; None where there is none."""
    jax_seconds: float | None = None
    """Per super step in JAX."""

    @property
    def runtime(self) -> str:
        """What the emulator was fastest in."""
        return (
            "JAX"
            if self.jax_seconds is None or self.emulator_seconds >= self.jax_seconds
            else "generated C"
        )


class _Rivalry(NamedTuple):
    """How one kind of physics is timed."""

    physics: str
    players: dict[str, Callable[[], None]]
    """By integrator."""
    steps: int
    """Physics steps in one play."""
    schemes: set[Scheme]
    error: Callable[[HeldOut, Scheme], float]


def _rivalry_of(test: HeldOut) -> _Rivalry:
    system = test.system
    if isinstance(system, PythonSystem):
        schemes = function_schemes(system, test.dt, OPPONENT_DIVISIONS)
        players = {FUNCTION: function_player(system, test)}
        return _Rivalry(PYTHON_FUNCTION, players, FUNCTION_STEPS, schemes, function_error)
    if isinstance(system, DeformableSystem):
        physics, players = deformable_players(system, test, PHYSICS_STEPS, STRETCHES)
        schemes = deformable_schemes(system, test.dt, OPPONENT_DIVISIONS)
        return _Rivalry(physics, players, PHYSICS_STEPS, schemes, twin_error)
    assert isinstance(system, MujocoSystem)
    players = {kind: physics_player(system, test, kind) for kind in OPPONENT_INTEGRATORS}
    schemes = {
        Scheme(kind, test.dt / parts)
        for kind in OPPONENT_INTEGRATORS
        for parts in OPPONENT_DIVISIONS
    }
    return _Rivalry(
        "MuJoCo", players, PHYSICS_STEPS, schemes | {system.scheme, system.truth}, scheme_error
    )


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process on one core, where the system allows it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def measure_speed(emulator: Emulator, test: HeldOut, error: float, repeats: int = REPEATS) -> Speed:
    """Return the speed-ups of an emulator whose one-step error is `error`."""
    system = test.system
    with one_core():
        rivalry = _rivalry_of(test)
        own = emulator_players(emulator)
        each = interleaved({**own, **rivalry.players}, repeats)
    per_super_step = min(each[name] for name in own) / TIMED_SUPER_STEPS
    per_step = {kind: each[kind] / rivalry.steps for kind in rivalry.players}
    opponents = [
        Opponent(
            scheme, rivalry.error(test, scheme), per_step[scheme.integrator] * scheme.steps(test.dt)
        )
        for scheme in sorted(rivalry.schemes, key=lambda scheme: (scheme.integrator, scheme.dt))
    ]
    able = [o for o in opponents if o.error <= error]
    rival = min(
        able or opponents, key=lambda o: o.seconds
    )  # an error that is no number is no worse than any
    tuned = per_step[system.scheme.integrator]
    plain = per_step.get(PLAIN, tuned)
    nominal = plain * emulator.substeps / per_super_step
    equal = rival.seconds / per_super_step
    return Speed(
        per_super_step,
        plain,
        nominal,
        equal,
        rival,
        tuple(opponents),
        rivalry.physics,
        tuned if PLAIN in per_step else None,
        each[IN_JAX] / TIMED_SUPER_STEPS,
    )


def measure_emulator(emulator: Emulator) -> float:
    """Return the time of one super step [s], where there is no physics to compare it with."""
    with one_core():
        return min(interleaved(emulator_players(emulator)).values()) / TIMED_SUPER_STEPS


def interleaved(players: dict[str, Callable[[], None]], repeats: int = REPEATS) -> dict[str, float]:
    """Return each player's median time [s], all played in turn so that a slow moment hits all."""
    times: dict[str, list[float]] = {name: [] for name in players}
    for _ in range(repeats):
        for name, play in players.items():
            began = time.perf_counter()
            play()
            times[name].append(time.perf_counter() - began)
    return {name: float(np.median(spans)) for name, spans in times.items()}


def emulator_players(emulator: Emulator) -> dict[str, Callable[[], Any]]:
    """Return functions that take `TIMED_SUPER_STEPS` super steps, compiled: in JAX, and in C where that can be had."""
    players: dict[str, Callable[[], Any]] = {IN_JAX: emulator_player(emulator)}
    if (program := program_in_c(emulator)) is not None:
        players[IN_C] = program.player(*(np.asarray(each) for each in _timed_motion(emulator)))
    return players


def program_in_c(emulator: Emulator) -> CEmulator | None:
    """Return the emulator in C; None where there is no program that does what JAX does."""
    try:
        return c_emulator(emulator)
    except NeuroAnimatorError:
        return None


def emulator_player(emulator: Emulator) -> Callable[[], None]:
    """Return a function that takes `TIMED_SUPER_STEPS` super steps in JAX, already compiled.

    Like the loop of the physics it keeps the last state only, in the numbers the super step is made in: a
    deformable body is decoded where it is drawn.
    """
    start, controls = _timed_motion(emulator)
    run = compiled(emulator, _last_state)
    run(start, controls)
    return lambda: run(start, controls).block_until_ready()


def _timed_motion(emulator: Emulator) -> tuple[Array, Array]:
    """Return a start and controls in the numbers of the super step."""
    rng, spec = np.random.default_rng(0), emulator.spec
    share = rng.uniform(-0.3, 0.3, (TIMED_SUPER_STEPS, spec.control.size))
    return emulator.encode_motion(spec.rest, spec.bounds.middle + share * spec.bounds.half)


def _last_state(
    emulator: Emulator, state: Float[Array, " I"], controls: Float[Array, "T C"]
) -> Float[Array, " I"]:
    step = emulator.step_latent
    return jax.lax.scan(
        lambda state, control: (step(state, control), None), state, controls, unroll=UNROLL
    )[0]


def compiled(emulator: Emulator, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function` of the emulator and arrays as a compiled function of the arrays.

    The weights go in as arguments, as in use: constants could be folded into the code.
    """
    weights, rest = eqx.partition(emulator, eqx.is_array)
    run = jax.jit(lambda weights, *inputs: function(eqx.combine(weights, rest), *inputs))
    return partial(run, weights)


def physics_player(system: MujocoSystem, test: HeldOut, integrator: str) -> Callable[[], None]:
    """Return a function that runs `PHYSICS_STEPS` steps of MuJoCo inside C from unseen states, under random controls.

    A fresh state of the test begins each stretch, so that contacts are as frequent as in use. A step's
    cost hardly depends on its length, so each integrator is timed at the system's own.
    """
    model = system.model_with(Scheme(integrator, system.physics_dt))
    data, (starts, controls) = mujoco.MjData(model), test.moments(STRETCHES)
    kind, signals = system.drive(controls[:, None])

    def play() -> None:
        with warnings_counted:
            for start, signal in zip(starts, signals[:, 0], strict=True):
                system.put(data, start)
                mujoco.mj_setState(model, data, signal, int(kind))
                mujoco.mj_step(model, data, nstep=PHYSICS_STEPS // STRETCHES)

    return play
