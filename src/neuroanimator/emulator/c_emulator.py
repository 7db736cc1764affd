"""An emulator as a program in C, generated from its definition in JAX and held against it.

Programs take and give NumPy arrays of float32. What they do is what `emulator.step` and `rollout` do; where JAX
differentiates, compiles or transforms, JAX itself is used.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import resources

import numpy as np
from jaxtyping import Array, Float

from neuroanimator.codegen.c_function import c_function, prelude
from neuroanimator.codegen.kept import CProgram, LoadedProgram, load_program
from neuroanimator.codegen.program import Constants
from neuroanimator.codegen.trace import Input
from neuroanimator.compiler.compiler import find_compiler
from neuroanimator.emulator.compiled import is_traced
from neuroanimator.emulator.description import describe
from neuroanimator.emulator.emulator import Emulator, latent_size
from neuroanimator.emulator.probes import Probes, latent_is_covered, probes_of
from neuroanimator.emulator.tensors import emulator_tensors
from neuroanimator.storage.files import canonical_json, digest
from neuroanimator.storage.remembered import UNKNOWN, Remembered

FEWEST_LANES = 4
"""With fewer motions than this, one after the other is faster."""

Program = Callable[[Emulator], CProgram]
"""What writes a program."""


def super_step(
    emulator: Emulator, latent: Float[Array, " I"], control: Float[Array, " C"]
) -> tuple[Float[Array, " I"], Float[Array, " S"]]:
    """Return (the latent state one super step later, the state it stands for)."""
    following = emulator.step_latent(latent, emulator.encode_control(control))
    return following, emulator.decode(following)


def encode(emulator: Emulator, state: Float[Array, " S"]) -> Float[Array, " I"]:
    """Return the latent state."""
    return emulator.encode(state)


def c_program(emulator: Emulator) -> CProgram:
    """Return the program of single motions: `step`, `rollout` and `covers` of `rollout.c`.

    Only numbers and names of our own are written: none of the text an emulator carries reaches a compiler.
    """
    latent, control, state = _inputs(emulator, is_wide=False)
    constants = Constants()
    write = partial(c_function, constants=constants)
    functions = [
        write("encode", encode, emulator, [state]),
        write("super_step", super_step, emulator, [latent, control]),
        write("latent_is_covered", latent_is_covered, emulator, [latent]),
    ]
    texts = [function.text for function in functions]
    return CProgram(_library(emulator, texts, "rollout.c"), constants.data(), {})


def c_program_of_lanes(emulator: Emulator) -> CProgram:
    """Return the program of sixteen motions side by side: `rollouts` of `rollouts.c`."""
    latent, control, _ = _inputs(emulator, is_wide=True)
    _, _, state = _inputs(emulator, is_wide=False)
    constants = Constants()
    write = partial(c_function, constants=constants)
    functions = [
        write("encode", encode, emulator, [state]),
        write("super_step_lanes", super_step, emulator, [latent, control]),
    ]
    texts = [function.text for function in functions]
    return CProgram(_library(emulator, texts, "rollouts.c"), constants.data(), {})


def _inputs(emulator: Emulator, *, is_wide: bool) -> tuple[Input, Input, Input]:
    """Return what a latent state, a control and a state are."""
    latent = Input((latent_size(emulator),), is_wide)
    control = Input((emulator.control.size,), is_wide)
    return latent, control, Input((emulator.state.size,), is_wide)


def _library(emulator: Emulator, functions: list[str], template: str) -> str:
    """Return the text of a library: generated functions, then those of `template` that call them."""
    latent, control, state = _inputs(emulator, is_wide=False)
    sizes = {"STATE": state, "CONTROL": control, "LATENT": latent}
    defines = [f"#define {name} {entry.shape[0]}" for name, entry in sizes.items()]
    calls = (resources.files("neuroanimator.emulator") / template).read_text(encoding="utf-8")
    return "\n".join([prelude(), *defines, *functions, calls])


@dataclass(frozen=True, eq=False)
class CEmulator:
    """An emulator's program, loaded. All arrays are float32; threads may share it."""

    program: LoadedProgram
    lanes: Callable[[], LoadedProgram | None]
    """Loads the program of sixteen motions side by side, which not everybody needs."""
    state_size: int

    def step(
        self, state: Float[np.ndarray, " S"], control: Float[np.ndarray, " C"]
    ) -> Float[np.ndarray, " S"]:
        """Return the state one super step later."""
        following = np.empty(self.state_size, np.float32)
        self.program.library.step(
            pointer(self.program.constants),
            pointer(state),
            pointer(control),
            pointer(following),
        )
        return following

    def rollout(
        self, state: Float[np.ndarray, " S"], controls: Float[np.ndarray, "T C"]
    ) -> Float[np.ndarray, "T+1 S"]:
        """Return the trajectory from `state`, it included."""
        states = np.empty((len(controls) + 1, self.state_size), np.float32)
        self.program.library.rollout(
            pointer(self.program.constants),
            pointer(state),
            pointer(controls),
            ctypes.c_long(len(controls)),
            pointer(states),
        )
        return states

    def rollouts(
        self, states: Float[np.ndarray, "B S"], controls: Float[np.ndarray, "B T C"]
    ) -> Float[np.ndarray, "B T+1 S"]:
        """Return the trajectories from each of `states`, sixteen at a time."""
        lanes = self.lanes() if len(states) >= FEWEST_LANES else None
        if lanes is None:
            pairs = zip(states, controls, strict=True)
            return np.stack([self.rollout(state, held) for state, held in pairs])
        count, steps, _ = controls.shape
        result = np.empty((count, steps + 1, self.state_size), np.float32)
        lanes.library.rollouts(
            pointer(lanes.constants),
            pointer(states),
            pointer(controls),
            ctypes.c_long(count),
            ctypes.c_long(steps),
            pointer(result),
        )
        return result

    def covers(self, state: Float[np.ndarray, " S"]) -> bool:
        """Return whether `state` lies in the range of the training."""
        function = self.program.library.covers
        function.restype = ctypes.c_float
        return bool(function(pointer(self.program.constants), pointer(state)))


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Return where an array lies, for C."""
    return ctypes.c_void_p(array.ctypes.data)


_known: Remembered[CEmulator | None] = Remembered()
"""The program of each emulator."""


def c_emulator(emulator: Emulator) -> CEmulator | None:
    """Return the emulator as compiled C, remembered as long as it lives.

    None where there is no C compiler, no C for what the emulator does, or where JAX is transforming it. A program that
    does not do what JAX does is refused, which is said once.
    """
    known = _known.of(emulator)
    if known is not UNKNOWN:
        return known
    if is_traced(emulator):
        return None
    program = load_checked(emulator, c_program, _check)
    result = None
    if program is not None:
        lanes = _Lanes(weakref.ref(emulator))
        result = CEmulator(program, lanes, emulator.state.size)
    return _known.keep(result, emulator)


class _Lanes:
    """The program of sixteen motions side by side of an emulator, loaded when it is first asked for."""

    def __init__(self, emulator: weakref.ref[Emulator]) -> None:
        self._emulator = emulator
        self._is_loaded = False
        self._program: LoadedProgram | None = None

    def __call__(self) -> LoadedProgram | None:
        emulator = self._emulator()
        if not self._is_loaded and emulator is not None:
            self._program = load_checked(emulator, c_program_of_lanes, _check_lanes)
            self._is_loaded = True
        return self._program


def load_checked(
    emulator: Emulator, write: Program, check: Callable[[Probes, LoadedProgram], None]
) -> LoadedProgram | None:
    """Return what `write` writes, compiled, and checked on its first use on this machine.

    None where that cannot be; that a program is wrong is said once.
    """
    if find_compiler() is None or emulator.normaliser.change_scale.dtype != np.float32:
        return None
    facts = [write.__name__, canonical_json(describe(emulator)), digest(emulator_tensors(emulator))]

    def check_it(program: LoadedProgram) -> None:
        check(probes_of(emulator), program)

    return load_program("\n".join(facts), partial(write, emulator), check_it)


def _check(probes: Probes, program: LoadedProgram) -> None:
    """Compare a super step from each probe, and whether it is covered."""
    in_c = CEmulator(program, lambda: None, probes.states.shape[1])
    pairs = zip(probes.states, probes.controls, strict=True)
    probes.compare(np.stack([in_c.step(state, control) for state, control in pairs]))
    probes.compare_covered(np.array([in_c.covers(state) for state in probes.states]))


def _check_lanes(probes: Probes, program: LoadedProgram) -> None:
    """Compare a super step from each probe, all at a time."""
    in_c = CEmulator(program, lambda: program, probes.states.shape[1])
    probes.compare(in_c.rollouts(probes.states, probes.controls[:, None])[:, 1])
