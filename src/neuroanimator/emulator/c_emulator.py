"""An emulator as a C program, generated from its definition in JAX and checked against it.

Programs take controls in float32, and states in float32 or float64, which they return. They compute the same as
`emulator.step` and `rollout`; where JAX differentiates, compiles or transforms, JAX itself is used.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from importlib import resources
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from neuroanimator.codegen.c_function import c_function, prelude
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.codegen.cores import in_parts
from neuroanimator.codegen.kept import (
    CProgram,
    LoadedProgram,
    Reference,
    address,
    declared,
    load_program,
)
from neuroanimator.codegen.program import WIDTH, Constants
from neuroanimator.codegen.trace import Input
from neuroanimator.emulator.checks import MAX_MAGNITUDE
from neuroanimator.emulator.compiled import is_traced
from neuroanimator.emulator.description import describe
from neuroanimator.emulator.origin import GRID, Origin
from neuroanimator.emulator.probes import Probes, probes_of
from neuroanimator.emulator.super_step import SuperStep, latent_size
from neuroanimator.emulator.tensors import emulator_tensors
from neuroanimator.files.atomic import canonical_json, digest
from neuroanimator.files.remembered import Remembered

MIN_LANES = 4
"""Minimum number of motions for lanes: fewer are faster one after the other."""

STEPS_OF_THREAD = 512
"""Minimum number of super steps per thread: fewer take less time than waking it."""

Program = Callable[[Any], CProgram]
"""Function that writes a program."""


def super_step(
    emulator: SuperStep, latent: Float[Array, " I"], control: Float[Array, " C"]
) -> tuple[Float[Array, " I"], Float[Array, " S"]]:
    """Return (the latent state one super step later, its decoded state)."""
    following = emulator.step_latent(latent, emulator.encode_control(control))
    return following, emulator.decode(following)


def encode(emulator: SuperStep, state: Float[Array, " S"]) -> Float[Array, " I"]:
    """Return the latent state."""
    return emulator.encode(state)


def super_step_trusted(
    emulator: SuperStep, latent: Float[Array, " I"], control: Float[Array, " C"]
) -> tuple[Float[Array, " I"], Float[Array, " S"], Float[Array, ""]]:
    """Return the results of `super_step` and the trust score of its input."""
    following, score = emulator.step_latent_trusted(latent, emulator.encode_control(control))
    return following, emulator.decode(following), score


def c_program(emulator: SuperStep) -> CProgram:
    """Return the program for single motions: `step`, `rollout` and `rollout_trusted` of `rollout.c`."""
    functions = {"super_step": super_step, "super_step_trusted": super_step_trusted}
    return _program(emulator, functions, "rollout.c", is_wide=False)


def c_program_of_lanes(emulator: SuperStep) -> CProgram:
    """Return the program for sixteen parallel motions: `rollouts` of `rollouts.c`."""
    return _program(emulator, {"super_step_lanes": super_step}, "rollouts.c", is_wide=True)


def _program(
    emulator: SuperStep, super_steps: dict[str, Callable[..., Any]], template: str, *, is_wide: bool
) -> CProgram:
    """Return `encode` and `super_steps` in C, then the functions of `template` that call them.

    Only numbers and our own names are written: no text from an emulator's file reaches a compiler.
    """
    latent, control, state = _inputs(emulator, is_wide=is_wide)
    constants = Constants()
    functions = [c_function("encode", encode, emulator, [state], constants)]
    for name, function in super_steps.items():
        functions.append(c_function(name, function, emulator, [latent, control], constants))
    texts = [function.text for function in functions]
    return CProgram(_library(emulator, texts, template), constants.data(), {})


def _inputs(emulator: SuperStep, *, is_wide: bool) -> tuple[Input, Input, Input]:
    """Return the inputs for a latent state, a control and a state."""
    latent = Input((latent_size(emulator),), is_wide)
    control = Input((emulator.control.size,), is_wide)
    return latent, control, Input((emulator.state.size,), is_wide)


def _library(emulator: SuperStep, functions: list[str], template: str) -> str:
    """Return the text of a library: generated functions, then those of `template` that call them."""
    latent, control, state = _inputs(emulator, is_wide=False)
    sizes = {"STATE": state, "CONTROL": control, "LATENT": latent}
    defines = [f"#define {name} {entry.shape[0]}" for name, entry in sizes.items()]
    defines.append(f"#define MAX_MAGNITUDE {MAX_MAGNITUDE:.1f}")
    defines.append(f"#define GRID {GRID:.1f}")
    defines.append(f"#define PARAMETERS {len(emulator.parameter_entries)}")
    folder = resources.files("neuroanimator.emulator")
    calls = [(folder / name).read_text(encoding="utf-8") for name in ("origin.c", template)]
    return "\n".join([prelude(), *defines, *tables(emulator.origin), *functions, *calls])


def tables(origin: Origin, prefix: str = "") -> Iterator[str]:
    """Yield the tables of `origin` in C: the first entry along each axis, and the entries that move, with their axes."""
    yield f"#define {prefix.upper()}AXES {origin.state.size}"
    for vector, axes in (("state", origin.state), ("latent", origin.latent)):
        entries = axes.moved_entries
        rows = {
            "first": axes.firsts,
            "entry": entries,
            "axis": [axes.of_entries[entry] for entry in entries],
        }
        yield f"#define {prefix.upper()}MOVED_{vector.upper()} {len(entries)}"
        for table, row in rows.items():
            numbers = ", ".join(map(str, row or [0]))  # C has no empty arrays
            yield f"static const int {prefix}{vector}_{table}[] = {{{numbers}}};"


class CEmulator:
    """An emulator's program, loaded. Arrays are in C order: states float32 or float64, as their results, all else float32.

    Threads may share it. Results come with a flag for whether they are sound: the inputs are such as `Emulator` accepts, and
    a rollout's states are finite.
    """

    def __init__(self, program: LoadedProgram, lanes: Callable[[], LoadedProgram | None]):
        """`lanes` loads the program for sixteen parallel motions, when it is needed."""
        self._program = program
        self._constants_at = address(program.constants)
        self._lanes = lanes
        self._step = declared(program.library, "step", 5)
        self._rollout = declared(program.library, "rollout", 6)
        self._rollout_trusted = declared(program.library, "rollout_trusted", 7)

    def step(
        self, state: Float[np.ndarray, " S"], control: Float[np.ndarray, " C"]
    ) -> tuple[Float[np.ndarray, " S"], bool]:
        """Return (the state one super step later, whether it and the inputs are sound)."""
        following = np.empty_like(state)
        is_sound = self._step(
            self._constants_at,
            address(state),
            address(control),
            address(following),
            state.dtype == float,
        )
        return following, bool(is_sound)

    def rollout(
        self, state: Float[np.ndarray, "*B S"], controls: Float[np.ndarray, "*B T C"]
    ) -> tuple[Float[np.ndarray, "*B T+1 S"], bool]:
        """Return (the trajectory from `state`, start included, whether it is sound), for one motion or a batch."""
        if state.ndim == 2:
            return self.rollouts(state, controls)
        steps = len(controls)
        states = np.empty((steps + 1, len(state)), state.dtype)
        is_sound = self._rollout(
            self._constants_at,
            address(state),
            address(controls),
            steps,
            address(states),
            state.dtype == float,
        )
        return states, bool(is_sound)

    def rollouts(
        self, states: Float[np.ndarray, "B S"], controls: Float[np.ndarray, "B T C"]
    ) -> tuple[Float[np.ndarray, "B T+1 S"], bool]:
        """Return (the trajectories from each of `states`, whether all are sound), sixteen at a time."""
        lanes = self._lanes() if len(states) >= MIN_LANES else None
        if lanes is not None:
            return _rollouts(lanes, states, controls)
        count, size = states.shape
        motions = np.empty((count, controls.shape[1] + 1, size), states.dtype)
        are_sound = True
        for row, (state, held) in enumerate(zip(states, controls, strict=True)):
            motions[row], is_sound = self.rollout(state, held)
            are_sound &= is_sound
        return motions, are_sound

    def rollouts_trusted(
        self, states: Float[np.ndarray, "B S"], controls: Float[np.ndarray, "B T C"]
    ) -> tuple[Float[np.ndarray, "B T+1 S"], Float[np.ndarray, "B T"]]:
        """Return (the trajectory from each of `states`, the score of each super step), one motion after the other."""
        count, steps, _ = controls.shape
        motions = np.empty((count, steps + 1, states.shape[1]), states.dtype)
        scores = np.empty((count, steps), np.float32)

        def run(rows: slice) -> None:
            for row in range(rows.start, rows.stop):
                self._rollout_trusted(
                    self._constants_at,
                    address(states[row]),
                    address(controls[row]),
                    steps,
                    address(motions[row]),
                    address(scores[row]),
                    states.dtype == float,
                )

        in_parts(run, count, smallest=max(1, STEPS_OF_THREAD // max(1, steps)))
        return motions, scores


def _rollouts(
    lanes: LoadedProgram,
    states: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B T C"],
) -> tuple[Float[np.ndarray, "B T+1 S"], bool]:
    """Return (the trajectories by the program for sixteen parallel motions, whether all are sound)."""
    count, steps, _ = controls.shape
    motions = np.empty((count, steps + 1, states.shape[1]), states.dtype)
    function = declared(lanes.library, "rollouts", 7)

    def run(rows: slice) -> int:
        return function(
            address(lanes.constants),
            address(states[rows]),
            address(controls[rows]),
            rows.stop - rows.start,
            steps,
            address(motions[rows]),
            states.dtype == float,
        )

    smallest = max(WIDTH, STEPS_OF_THREAD // max(1, steps))
    return motions, all(in_parts(run, count, smallest=smallest))


@Remembered
def c_emulator(emulator: SuperStep) -> CEmulator | None:
    """Return the emulator as compiled C, remembered as long as it lives.

    None without a C compiler, for operations without C, or while JAX is transforming it. A program whose results differ
    from JAX's is refused, which is reported once.
    """
    if is_traced(emulator):
        return None
    program = load_checked(emulator, c_program, probes_of, _check)
    if program is None:
        return None
    return CEmulator(program, _lanes_of(weakref.ref(emulator)))


def _lanes_of(emulator: weakref.ref[SuperStep]) -> Callable[[], LoadedProgram | None]:
    """Return a function that loads the program for sixteen parallel motions at its first call."""

    @cache
    def load() -> LoadedProgram | None:
        living = emulator()
        if living is None:
            return None
        return load_checked(living, c_program_of_lanes, probes_of, _check_lanes)

    return load


def facts_of_emulator(emulator: SuperStep) -> list[str]:
    """Return all facts, in words and numbers, that an emulator's programs depend on besides the package's code.

    Its measured errors are not among them.
    """
    emulator = replace(emulator, calibration=None, validation=None)
    return [canonical_json(describe(emulator)), digest(emulator_tensors(emulator))]


def load_checked(
    emulator: SuperStep,
    write: Program,
    refer: Callable[[Any], Reference],
    check: Callable[[Reference, LoadedProgram], None],
) -> LoadedProgram | None:
    """Return the program that `write` writes for `emulator`, compiled and checked on its first use: see `load_program`.

    None if there is no such program; a wrong one is reported once.
    """
    if find_compiler() is None or emulator.normaliser.change_scale.dtype != np.float32:
        return None

    def about() -> list[str]:
        return [write.__name__, *facts_of_emulator(emulator)]

    return load_program(about, partial(write, emulator), partial(refer, emulator), check)


def _check(probes: Probes, program: LoadedProgram) -> None:
    """Compare a super step from each probe, and its trust score."""
    in_c = CEmulator(program, lambda: None)
    states, controls = probes.inputs
    following = [in_c.step(*pair)[0] for pair in zip(states, controls, strict=True)]
    _, scores = in_c.rollouts_trusted(states, controls[:, None])
    probes.compare(np.stack(following), scores)


def _check_lanes(probes: Probes, program: LoadedProgram) -> None:
    """Compare a super step from each probe, all at once."""
    states, controls = probes.inputs
    motions, _ = _rollouts(program, states, controls[:, None])
    probes.compare(motions[:, 1])
