"""A chain of super steps in generated C, with defects, and what cotangents of its states say of its controls."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import partial
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.codegen.c_function import c_function, prelude
from neuroanimator.codegen.kept import CProgram, LoadedProgram, WrongProgramError
from neuroanimator.codegen.program import WIDTH, Constants
from neuroanimator.codegen.trace import Input
from neuroanimator.control.descent.defects import step_with_defect
from neuroanimator.control.objective.c_objective import aligned_room, lanes
from neuroanimator.emulator.c_emulator import load_checked, pointer
from neuroanimator.emulator.compiled import is_traced
from neuroanimator.emulator.emulator import Emulator, latent_size
from neuroanimator.emulator.probes import GRADIENT_TOLERANCE, Probes, compiled_quickly
from neuroanimator.storage.remembered import UNKNOWN, Remembered

CHECKED_GRADIENTS = 64
"""Probes whose gradients are compared, sixteen cotangents each: a thousand."""


def advance(
    emulator: Emulator,
    latent: Float[Array, " I"],
    control: Float[Array, " C"],
    defect: Float[Array, " V"],
) -> tuple[Float[Array, " I"], Float[Array, " S"]]:
    """Return (the latent state one super step later, the state it stands for), with the defect added."""
    held = emulator.encode_control(control)
    following = step_with_defect(emulator, latent, held, defect)
    return following, emulator.decode(following)


def advance_and_pull(
    emulator: Emulator,
    latent: Float[Array, " I"],
    control: Float[Array, " C"],
    defect: Float[Array, " V"],
    of_latent: Float[Array, " I"],
    of_state: Float[Array, " S"],
) -> tuple[Array, Array, Array, Array]:
    """Return `advance`, and what cotangents of both say of the latent state and of the control before."""

    def advanced(latent: Array, control: Array) -> tuple[Array, Array]:
        return advance(emulator, latent, control, defect)

    (following, state), pull = jax.vjp(advanced, latent, control)
    before, held = pull((of_latent, of_state))
    return following, state, before, held


def chain_program(emulator: Emulator) -> CProgram:
    """Return the program of `chain.c` for one emulator."""
    sizes = _sizes(emulator)
    constants = Constants()
    write = partial(c_function, module=emulator, constants=constants)
    latent, control, defect, state = (
        sizes[name] for name in ("LATENT", "CONTROL", "DEFECT", "STATE")
    )
    in_lanes = write(
        "advance_lanes",
        advance,
        inputs=(Input((latent,), is_wide=True), Input((control,), is_wide=True), Input((defect,))),
    )
    pulled = write(
        "advance",
        advance_and_pull,
        inputs=(
            Input((latent,)),
            Input((control,)),
            Input((defect,)),
            Input((latent,), is_wide=True, is_late=True),
            Input((state,), is_wide=True, is_late=True),
        ),
        values=2,
    )
    sizes["TAPE"] = max(pulled.tape, WIDTH)
    defines = [f"#define {name} {size}" for name, size in sizes.items()]
    calls = (resources.files("neuroanimator.control.descent") / "chain.c").read_text(
        encoding="utf-8"
    )
    text = "\n".join([prelude(), *defines, in_lanes.text, pulled.text, calls])
    return CProgram(text, constants.data(), sizes)


def _sizes(emulator: Emulator) -> dict[str, int]:
    return {
        "LATENT": latent_size(emulator),
        "CONTROL": emulator.control.size,
        "DEFECT": emulator.normaliser.change_scale.shape[0],
        "STATE": emulator.state.size,
    }


@dataclass(frozen=True, eq=False)
class Chain:
    """The program of an emulator's chain, loaded. Arrays are float32 in C's order, lanes last; threads may share it."""

    program: LoadedProgram

    def forward(
        self,
        start: Float[np.ndarray, " I"],
        controls: Float[np.ndarray, "T C"],
        defects: Float[np.ndarray, "T V"],
        states: Float[np.ndarray, "T1 S"],
    ) -> Float[np.ndarray, " P"]:
        """Fill `states` from row 1 on with the motion from the latent `start`, and return the tapes `backward` needs."""
        steps = len(controls)
        tapes = aligned_room(steps * self.program.sizes["TAPE"])
        self.program.library.chain_forward(
            pointer(self.program.constants),
            pointer(start),
            pointer(controls),
            pointer(defects),
            ctypes.c_long(steps),
            pointer(tapes),
            pointer(states),
        )
        return tapes

    def apart(
        self, latents: Float[np.ndarray, "T I"], controls: Float[np.ndarray, "T C"]
    ) -> Float[np.ndarray, "T I"]:
        """Return where one super step leads from each latent state, without defects."""
        after = np.empty_like(latents)
        self.program.library.chain_apart(
            pointer(self.program.constants),
            pointer(latents),
            pointer(controls),
            ctypes.c_long(len(latents)),
            pointer(after),
        )
        return after

    def backward(
        self,
        tapes: Float[np.ndarray, " P"],
        of_states: Float[np.ndarray, "T1 S 16"],
        last: int,
        of_controls: Float[np.ndarray, "T C 16"],
    ) -> None:
        """Add to the cotangents `of_controls` what those `of_states` say of them.

        Those of states after the first `last` super steps must be zero.
        """
        self.program.library.chain_backward(
            pointer(self.program.constants),
            pointer(tapes),
            pointer(of_states),
            ctypes.c_long(last),
            pointer(of_controls),
        )

    def lanes(
        self,
        start: Float[np.ndarray, " I"],
        controls: Float[np.ndarray, "B T C"],
        defects: Float[np.ndarray, "T V"],
        states: Float[np.ndarray, "B T1 S"],
    ) -> None:
        """Fill `states` from row 1 on with motions from the latent `start`, at most sixteen."""
        count, steps, _ = controls.shape
        assert count <= WIDTH
        self.program.library.chain_lanes(
            pointer(self.program.constants),
            pointer(start),
            pointer(controls),
            pointer(defects),
            ctypes.c_long(count),
            ctypes.c_long(steps),
            pointer(states),
        )


_known: Remembered[Chain | None] = Remembered()
"""The chain of each emulator."""


def chain_of(emulator: Emulator) -> Chain | None:
    """Return the chain of `emulator` in C, remembered as long as it lives; None where there is no such program."""
    known = _known.of(emulator)
    if known is not UNKNOWN:
        return known
    if is_traced(emulator):
        return None
    program = load_checked(emulator, chain_program, partial(_check, emulator))
    return _known.keep(None if program is None else Chain(program), emulator)


def _check(emulator: Emulator, probes: Probes, program: LoadedProgram) -> None:
    """Compare a super step from each probe, sixteen at a time, and the gradients of some, with random defects."""
    chain = Chain(program)
    rng = np.random.default_rng(1)
    latents = np.asarray(compiled_quickly(jax.vmap(emulator.encode))(probes.states), np.float32)
    state = probes.states.shape[1]
    no_defect = np.zeros((1, program.sizes["DEFECT"]), np.float32)
    found = np.empty_like(probes.states)
    for number, start in enumerate(latents):
        lane = number % WIDTH
        controls = np.repeat(probes.controls[number][None, None], lane + 1, axis=0)
        states = np.empty((lane + 1, 2, state), np.float32)
        chain.lanes(start, controls, no_defect, states)
        found[number] = states[lane, 1]
    probes.compare(found)
    count = min(CHECKED_GRADIENTS, len(latents))
    defects = 0.01 * rng.normal(size=(count, 1, no_defect.shape[1])).astype(np.float32)
    cotangents = rng.normal(size=(count, WIDTH, state)).astype(np.float32)
    pull = compiled_quickly(
        jax.vmap(jax.vmap(_pull_state, (None, None, None, None, 0)), (None, 0, 0, 0, 0))
    )
    chosen = np.linspace(0, len(latents) - 1, count).astype(int)
    expected = np.asarray(
        pull(emulator, latents[chosen], probes.controls[chosen], defects[:, 0], cotangents)
    )
    for number, row in enumerate(chosen):
        states = aligned_room(2 * state).reshape(2, state)
        tapes = chain.forward(latents[row], probes.controls[row][None], defects[number], states)
        of_states = lanes(2, state)
        of_states[1] = cotangents[number].T
        of_controls = lanes(1, probes.controls.shape[1])
        chain.backward(tapes, of_states, 1, of_controls)
        off = np.abs(of_controls[0].T - expected[number])
        if not (off <= GRADIENT_TOLERANCE * (np.abs(expected[number]).max() + 1e-6)).all():
            raise WrongProgramError("Generated C has other gradients than the emulator in JAX.")


def _pull_state(
    emulator: Emulator,
    latent: Float[Array, " I"],
    control: Float[Array, " C"],
    defect: Float[Array, " V"],
    of_state: Float[Array, " S"],
) -> Float[Array, " C"]:
    """Return what a cotangent of the state one super step later says of the control."""
    return advance_and_pull(emulator, latent, control, defect, jnp.zeros_like(latent), of_state)[3]
