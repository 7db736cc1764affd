"""A link of the chain of super steps in generated C: (latent state, control) → the latent state after, defect added."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.codegen.c_map import CMap, MapDefinition, check_maps, judge_of, program_of_maps
from neuroanimator.codegen.kept import CProgram, LoadedProgram
from neuroanimator.codegen.program import WIDTH
from neuroanimator.control.descent.defects import step_with_defect
from neuroanimator.emulator.c_emulator import load_checked
from neuroanimator.emulator.compiled import is_traced
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.probes import Probes, compiled_quickly
from neuroanimator.emulator.super_step import latent_size
from neuroanimator.storage.remembered import UNKNOWN, Remembered

LINK = "link"
"""What the map is called in C."""

CHECKED_GRADIENTS = 64
"""Probes whose gradients are compared, sixteen cotangents each: a thousand."""


def link(
    emulator: Emulator, defect: Float[Array, " V"], x: Float[Array, " X"]
) -> Float[Array, " I"]:
    """Return the latent state one super step after x, a latent state and a control, with the defect added."""
    latent, control = jnp.split(x, [len(x) - emulator.control.size])
    return step_with_defect(emulator, latent, emulator.encode_control(control), defect)


def link_definition(emulator: Emulator) -> MapDefinition:
    """Return what the map `link` of `emulator` is in JAX."""
    return MapDefinition(link, emulator, latent_size(emulator) + emulator.control.size)


def _no_defect(emulator: Emulator) -> Float[np.ndarray, " V"]:
    return np.zeros(emulator.normaliser.change_scale.shape[0], np.float32)


def chain_program(emulator: Emulator) -> CProgram:
    """Return the program of the map `link` for one emulator."""
    return program_of_maps({LINK: link_definition(emulator)}, len(_no_defect(emulator)))


_known: Remembered[CMap | None] = Remembered()
"""The link of each emulator."""


def link_of(emulator: Emulator) -> CMap | None:
    """Return the map `link` of `emulator` in C, without defects; remembered as long as the emulator lives.

    None where there is no such program.
    """
    known = _known.of(emulator)
    if known is not UNKNOWN:
        return known
    if is_traced(emulator):
        return None
    program = load_checked(emulator, chain_program, partial(_check, emulator))
    if program is None:
        return _known.keep(None, emulator)
    in_c = CMap(program, LINK, _no_defect(emulator))
    return _known.keep(in_c, emulator)


def _check(emulator: Emulator, probes: Probes, program: LoadedProgram) -> None:
    """Compare a super step from each probe, sixteen at a time, and the gradients of some, with a random defect."""
    no_defect = _no_defect(emulator)
    in_c = CMap(program, LINK, no_defect)
    latents = np.asarray(emulator.encode(probes.states), np.float32)
    xs = np.concatenate([latents, probes.controls], axis=1)
    probes.compare(np.asarray(emulator.decode(in_c.of_rows(xs))))
    defect = 0.01 * np.random.default_rng(1).normal(size=no_defect.shape).astype(np.float32)
    with_defect = replace(in_c, numbers=defect)
    judge = compiled_quickly(judge_of([partial(link, emulator, jax.device_put(defect))]))
    chosen = np.linspace(0, len(xs) - 1, CHECKED_GRADIENTS).astype(int)
    for some in chosen.reshape(-1, WIDTH):
        check_maps([with_defect], judge, [xs[some]])
