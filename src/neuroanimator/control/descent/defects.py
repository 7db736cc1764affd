"""Defects of multiple shooting: an emulator's errors along a known motion of the physics, added to every super step.

`link` is such a super step in C, with its derivatives: (latent state, control) → the next latent state.

Where the emulated motion departs from the physics, a descent would follow it. With the defects of a replayed motion
added, the emulator reproduces exactly that motion for its controls, and still has the derivatives by them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.codegen.backend import backend
from neuroanimator.codegen.c_map import (
    CMap,
    MapDefinition,
    MapReference,
    map_references,
    program_of_maps,
)
from neuroanimator.codegen.kept import CProgram, LoadedProgram
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.c_emulator import load_checked
from neuroanimator.emulator.compiled import is_traced
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.probes import Probes, probes_of
from neuroanimator.emulator.super_step import latent_size
from neuroanimator.files.remembered import Remembered
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.body_frame import Frame

LINK = "link"
"""Name of the map in C."""

CHECKED_GRADIENTS = 64
"""Number of probes whose gradients are compared, with sixteen cotangents each: a thousand."""


def still_frame(emulator: Emulator) -> Frame:
    """Return the frame in which latent states are compared, without coasting."""
    return replace(emulator.frame, dt=0.0)


def no_defects(emulator: Emulator, steps: int) -> Float[np.ndarray, "T V"]:
    """Return zeros: the emulator unchanged."""
    changes = emulator.normaliser.change_scale.shape[0]
    return np.zeros((steps, changes), np.float32)


def find_defects(
    emulator: Emulator, states: ArrayLike, controls: ArrayLike
) -> Float[AnyArray, "T V"]:
    """Return the additions to every super step that make the emulator pass through `states` of the physics.

    `states` (T+1, S) are the result of `controls` (T, C). Computed by the `backend`.
    """
    link = link_of(emulator) if backend() != "jax" else None
    if link is None:
        return _find_defects(emulator, as_jax(states), as_jax(controls))
    latent = np.ascontiguousarray(emulator.encode(np.asarray(states, np.float32)), np.float32)
    held = np.asarray(controls, np.float32)
    predicted = link.of_rows(np.concatenate([latent[:-1], held], axis=1))
    return still_frame(emulator).difference(predicted, latent[1:])


@eqx.filter_jit
def _find_defects(
    emulator: Emulator, states: Float[Array, "T1 S"], controls: Float[Array, "T C"]
) -> Float[Array, "T V"]:
    latent = emulator.encode(states)
    latent_controls = emulator.encode_control(controls)
    predicted = jax.vmap(emulator.step_latent)(latent[:-1], latent_controls)
    return still_frame(emulator).difference(predicted, latent[1:])


def step_with_defect(
    emulator: Emulator,
    latent: Float[Array, " I"],
    control: Float[Array, " C"],
    defect: Float[Array, " V"],
) -> Float[Array, " I"]:
    """Return the latent state one super step later: `Emulator.step_latent` with the defect added."""
    return still_frame(emulator).apply(emulator.step_latent(latent, control), defect)


def rollout_with_defects(
    emulator: Emulator,
    latent: Float[Array, " I"],
    controls: Float[Array, "T C"],
    defects: Float[Array, "T V"],
) -> Float[Array, "T+1 I"]:
    """Return the trajectory of latent states from `latent`, start included, with the defects added.

    Not unrolled, unlike `Emulator.rollout`: its derivatives compile in a third of the time and run as fast.
    """

    def step(latent: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        control, defect = inputs
        following = step_with_defect(emulator, latent, control, defect)
        return following, following

    inputs = (emulator.encode_control(controls), defects)
    _, trajectory = jax.lax.scan(step, latent, inputs)
    return jnp.concatenate([latent[None], trajectory])


def link(
    emulator: Emulator, defect: Float[Array, " V"], x: Float[Array, " X"]
) -> Float[Array, " I"]:
    """Return the latent state one super step after x, a latent state and a control, with the defect added."""
    latent, control = jnp.split(x, [len(x) - emulator.control.size])
    return step_with_defect(emulator, latent, emulator.encode_control(control), defect)


def link_definition(emulator: Emulator) -> MapDefinition:
    """Return the map `link` of `emulator` in JAX."""
    return MapDefinition(link, emulator, latent_size(emulator) + emulator.control.size)


def _no_defect(emulator: Emulator) -> Float[np.ndarray, " V"]:
    return np.zeros(emulator.normaliser.change_scale.shape[0], np.float32)


def chain_program(emulator: Emulator) -> CProgram:
    """Return the program of the map `link` for one emulator."""
    return program_of_maps({LINK: link_definition(emulator)}, len(_no_defect(emulator)))


@Remembered
def link_of(emulator: Emulator) -> CMap | None:
    """Return the map `link` of `emulator` in C, without defects; remembered as long as the emulator lives.

    None if there is no such program.
    """
    if is_traced(emulator):
        return None
    program = load_checked(emulator, chain_program, LinkReference.of, LinkReference.check)
    return None if program is None else CMap(program, LINK, _no_defect(emulator))


@dataclass(frozen=True, eq=False)
class LinkReference:
    """Reference of the map `link` of an emulator: super steps from probes, and gradients of some with a random defect."""

    emulator: Emulator
    probes: Probes
    xs: Float[np.ndarray, "N X"]
    """A latent state and a control of each probe."""
    defect: Float[np.ndarray, " V"]
    with_defect: MapReference

    @classmethod
    def of(cls, emulator: Emulator) -> LinkReference:
        """Return the reference of `emulator`, computed by JAX."""
        probes = probes_of(emulator)
        states, controls = probes.inputs
        latents = np.asarray(emulator.encode(states), np.float32)
        xs = np.concatenate([latents, controls], axis=1)
        rng = np.random.default_rng(1)
        defect = 0.01 * rng.normal(size=_no_defect(emulator).shape).astype(np.float32)
        chosen = np.linspace(0, len(xs) - 1, CHECKED_GRADIENTS).astype(int)
        definition = link_definition(emulator)
        (with_defect,) = map_references([definition.with_numbers(defect)], [xs[chosen]])
        return cls(emulator, probes, xs, defect, with_defect)

    def check(self, program: LoadedProgram) -> None:
        """Raise WrongProgramError unless the map of `program` agrees."""
        in_c = CMap(program, LINK, _no_defect(self.emulator))
        self.probes.compare(np.asarray(self.emulator.decode(in_c.of_rows(self.xs))))
        replace(in_c, numbers=self.defect).check(self.with_defect)
