"""Speed: compiled against compiled, one core against one core, interleaved in one process.

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
from jaxtyping import Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.runner import program_of
from neuroanimator.emulator.super_step import rollout
from neuroanimator.learn.evaluation.accuracy import scheme_error, schemes_of
from neuroanimator.learn.evaluation.held_out import HeldOut
from neuroanimator.learn.evaluation.speed_function import (
    FUNCTION_STEPS,
    PYTHON_FUNCTION,
    function_error,
    function_player,
    function_schemes,
)
from neuroanimator.learn.evaluation.speed_mass_spring import (
    deformable_players,
    twin_error,
)
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.physics.deformable.native.compiled import INTEGRATORS
from neuroanimator.physics.functions.function_system import FUNCTION, PythonSystem
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.physics.soft.flex_scene import FlexScene
from neuroanimator.physics.soft.scene import Scene
from neuroanimator.physics.soft.soft_scene import Motion
from neuroanimator.physics.soft.soft_system import SoftSystem
from neuroanimator.systems.system import Scheme

PHYSICS_STEPS = 20_000
"""Number of physics steps in the timed run, as in the 1998 table."""

TIMED_SUPER_STEPS = 8_000
"""Number of super steps in one timed call of the emulator, so that the call itself (30 µs from Python) does not count."""

TIMED_CONTROLS = 0.3
"""Largest random control under which the emulator is timed, as a share of its range."""

IN_JAX = "emulator in JAX"
"""Name of the emulator timed in JAX."""

IN_C = "emulator in C"
"""Name of the emulator timed in generated C."""

REPEATS = 9
"""Number of timings of each side; the median is reported."""

PIECES = 40
"""Number of fresh states that a timed run of the physics starts from: too few for the Python between them to count."""

OPPONENT_DIVISIONS = (1, 2, 3, 4, 5, 8, 10, 16, 20, 25, 40, 50)
"""Numbers of physics steps per super step tried for each integrator, besides the system's own."""

SOFT_NAMES = {Scene.integrator: "C", FlexScene.integrator: "MuJoCo"}
"""Names in reports of the body's physics, by its integrator."""

SOFT_FRAMES = 4
"""Number of super steps in one timed run: each takes milliseconds for a body of thousands of nodes."""

SOFT_DIVISIONS = (2, 4, 5, 8, 10, 16, 20, 25, 40, 50, 80)
"""Numbers of small steps in a super step that are tried."""


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
    """Both speed-ups, on one core, of one trajectory."""

    emulator_seconds: float
    """Time of a super step, by the faster of generated C and JAX [s]."""
    physics_seconds: float
    """Time of a physics step of the system's own scheme [s]."""
    nominal: float
    """Speed-up of the super steps that replace `PHYSICS_STEPS` of the system's own scheme."""
    equal_error: float
    """Speed-up over the fastest physics whose error is no larger than the emulator's."""
    equal_error_opponent: Opponent
    """That fastest physics."""
    opponents: tuple[Opponent, ...]
    """Every way of stepping the physics that was tried."""
    physics: str = "MuJoCo"
    """Name of the physics: `MuJoCo` or a `C twin`, compiled; `JAX` without a twin; a `Python function`, not compiled."""
    jax_seconds: float | None = None
    """Time of a super step in JAX [s]."""

    @property
    def runtime(self) -> str:
        """The emulator's fastest runtime."""
        if self.jax_seconds is None or self.emulator_seconds >= self.jax_seconds:
            return "JAX"
        return "generated C"


class _TimedPhysics(NamedTuple):
    """How one kind of physics is timed."""

    name: str
    players: dict[str, Callable[[], None]]
    """Functions that take `steps` physics steps, by integrator."""
    steps: int
    schemes: set[Scheme]
    error: Callable[[HeldOut, Scheme], float]


def _timed_physics(test: HeldOut) -> _TimedPhysics:
    system = test.system
    if isinstance(system, PythonSystem):
        schemes = function_schemes(system, test.dt, OPPONENT_DIVISIONS)
        players = {FUNCTION: function_player(system, test)}
        return _TimedPhysics(PYTHON_FUNCTION, players, FUNCTION_STEPS, schemes, function_error)
    if isinstance(system, DeformableSystem):
        name, players = deformable_players(system, test, PHYSICS_STEPS, PIECES)
        schemes = schemes_of(system, test.dt, INTEGRATORS, OPPONENT_DIVISIONS)
        return _TimedPhysics(name, players, PHYSICS_STEPS, schemes, twin_error)
    if isinstance(system, SoftSystem):
        integrator = system.scheme.integrator
        players = {integrator: soft_player(system, test)}
        steps = SOFT_FRAMES * system.scheme.steps(test.dt)
        schemes = schemes_of(system, test.dt, [integrator], SOFT_DIVISIONS)
        return _TimedPhysics(SOFT_NAMES[integrator], players, steps, schemes, scheme_error)
    assert isinstance(system, MujocoSystem)
    players = {name: physics_player(system, test, name) for name in system.integrators}
    schemes = {system.scheme, system.truth}
    for integrator in system.integrators:
        schemes |= {Scheme(integrator, test.dt / parts) for parts in OPPONENT_DIVISIONS}
    return _TimedPhysics("MuJoCo", players, PHYSICS_STEPS, schemes, scheme_error)


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
    with one_core():
        physics = _timed_physics(test)
        players = emulator_players(emulator)
        seconds = interleaved(players | physics.players, repeats)
    per_super_step = min(seconds[name] for name in players) / TIMED_SUPER_STEPS
    per_step = {name: seconds[name] / physics.steps for name in physics.players}
    opponents = _opponents(test, physics, per_step)
    able = [opponent for opponent in opponents if opponent.error <= error]
    # if the error is NaN, the fastest of all
    equal_error_opponent = min(able or opponents, key=lambda opponent: opponent.seconds)
    own = per_step[test.system.scheme.integrator]
    return Speed(
        emulator_seconds=per_super_step,
        physics_seconds=own,
        nominal=own * emulator.substeps / per_super_step,
        equal_error=equal_error_opponent.seconds / per_super_step,
        equal_error_opponent=equal_error_opponent,
        opponents=tuple(opponents),
        physics=physics.name,
        jax_seconds=seconds[IN_JAX] / TIMED_SUPER_STEPS,
    )


def _opponents(test: HeldOut, physics: _TimedPhysics, per_step: dict[str, float]) -> list[Opponent]:
    """Return every way of stepping the physics, with its error and its time."""
    opponents = []
    for scheme in sorted(physics.schemes, key=lambda scheme: (scheme.integrator, scheme.dt)):
        seconds = per_step[scheme.integrator] * scheme.steps(test.dt)
        opponents.append(Opponent(scheme, physics.error(test, scheme), seconds))
    return opponents


def measure_emulator(emulator: Emulator, repeats: int = REPEATS) -> float:
    """Return the time of one super step [s], for an emulator with no physics to compare with."""
    with one_core():
        seconds = interleaved(emulator_players(emulator), repeats)
    return min(seconds.values()) / TIMED_SUPER_STEPS


def interleaved(players: dict[str, Callable[[], Any]], repeats: int = REPEATS) -> dict[str, float]:
    """Return each player's median time [s]; they are played in turn, so that a slow moment hits all."""
    times: dict[str, list[float]] = {name: [] for name in players}
    for _ in range(repeats):
        for name, play in players.items():
            began = time.perf_counter()
            play()
            times[name].append(time.perf_counter() - began)
    return {name: float(np.median(spans)) for name, spans in times.items()}


def emulator_players(emulator: Emulator) -> dict[str, Callable[[], Any]]:
    """Return functions that take `TIMED_SUPER_STEPS` super steps, compiled: in JAX, and in C where available."""
    players: dict[str, Callable[[], Any]] = {IN_JAX: emulator_player(emulator)}
    program = program_of(emulator)
    if program is not None:
        start, controls = _timed_motion(emulator)
        players[IN_C] = partial(program.rollout, start, controls)
    return players


def emulator_player(emulator: Emulator) -> Callable[[], None]:
    """Return a function that takes `TIMED_SUPER_STEPS` super steps in JAX, already compiled: a rollout, as users run it."""
    start, controls = _timed_motion(emulator)
    run = compiled(emulator, rollout)
    run(start, controls)
    return lambda: run(start, controls).block_until_ready()


def _timed_motion(
    emulator: Emulator,
) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, "T C"]]:
    """Return a start and controls."""
    rng = np.random.default_rng(0)
    bounds = emulator.bounds
    shape = (TIMED_SUPER_STEPS, emulator.control.size)
    shares = rng.uniform(-TIMED_CONTROLS, TIMED_CONTROLS, shape)
    controls = bounds.middle + shares * bounds.half
    return emulator.rest.astype(np.float32), controls.astype(np.float32)


def compiled(emulator: Emulator, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function` of the emulator and arrays as a compiled function of the arrays.

    The weights are passed as arguments, as in use: constants could be folded into the code.
    """
    weights, rest = eqx.partition(emulator, eqx.is_array)
    run = jax.jit(lambda weights, *inputs: function(eqx.combine(weights, rest), *inputs))
    return partial(run, weights)


def physics_player(system: MujocoSystem, test: HeldOut, integrator: str) -> Callable[[], None]:
    """Return a function that runs `PHYSICS_STEPS` steps of MuJoCo within C from unseen states, under random controls.

    A fresh state of the test begins each of the `PIECES`, so that contacts are as frequent as in use. A step's
    cost hardly depends on its length, so each integrator is timed at the system's own.
    """
    model = system.model_with(Scheme(integrator, system.physics_dt))
    data = mujoco.MjData(model)
    starts, controls = test.moments(PIECES)
    kind, signals = system.drive(controls[:, None])

    def play() -> None:
        with warnings_counted:
            for start, signal in zip(starts, signals[:, 0], strict=True):
                system.put(data, start)
                mujoco.mj_setState(model, data, signal, int(kind))
                mujoco.mj_step(model, data, nstep=PHYSICS_STEPS // PIECES)

    return play


def soft_player(system: SoftSystem, test: HeldOut) -> Callable[[], None]:
    """Return a function that takes `SOFT_FRAMES` super steps of the system's own small steps from an unseen state."""
    starts, controls = test.moments(1)
    start = system.motion(starts)
    motion = Motion(start.positions[..., 0], start.velocities[..., 0], start.origin[..., 0])
    ends = np.arange(SOFT_FRAMES + 1)[:, None] * test.dt * controls
    paths = starts[:, : system.control.size] + ends
    steps = system.scheme.steps(test.dt)

    def play() -> None:
        system.scene.play(motion, paths, test.dt, steps)

    return play
