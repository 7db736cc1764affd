"""J and its derivatives in generated C.

    z → controls → chain → states → residuals r,    J = |r|²/2
    dJ/dz and dr/dz: cotangents of sixteen residuals at a time, back to the states, through the chain to the controls, to z

Costs that are any JAX function are left to JAX.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from functools import partial
from importlib import resources
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.codegen.c_function import c_function
from neuroanimator.codegen.kept import CProgram, LoadedProgram, aligned, load_program
from neuroanimator.codegen.program import WIDTH, Constants
from neuroanimator.codegen.trace import Input
from neuroanimator.control.descent.chain import Chain, chain_of
from neuroanimator.control.descent.evaluator import EmulatedMotion, Evaluator, QuadraticModel
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.descent.problem import Problem
from neuroanimator.control.objective.c_objective import (
    OURS,
    CObjective,
    MotionShape,
    backward,
    c_objective,
    compare_pulled,
    cotangents,
    forward,
    half_squares,
    in_first_lane,
    lanes,
    program_of_parts,
    pulled_in_jax,
    random_lanes,
)
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.emulator.c_emulator import pointer
from neuroanimator.storage.files import digest
from neuroanimator.storage.remembered import UNKNOWN, Remembered

TRIED = 3
"""Random z a parametrisation's program is compared with JAX on."""


@dataclass(frozen=True)
class _Pass:
    """A motion with what is needed to go back along it."""

    z: Float[np.ndarray, " Z"]
    controls: Float[np.ndarray, "T C"]
    states: Float[np.ndarray, "T1 S"]
    of_states: Float[np.ndarray, " R"]
    """Residuals of the terms that look at states."""
    of_controls: Float[np.ndarray, " Q"]
    """Residuals of the terms that look at controls alone."""
    tapes: dict[str, np.ndarray]

    @property
    def cost(self) -> float:
        """J"""
        return half_squares(self.of_states) + half_squares(self.of_controls)


class CEvaluator(Evaluator):
    """An evaluator that calls generated C; made by `c_evaluator`."""

    def __init__(
        self, problem: Problem, chain: Chain, objective: CObjective, varied: LoadedProgram
    ):
        self._emulator = problem.emulator
        self._chain = chain
        self._objective = objective
        self._varied = varied
        self._shape_of_controls = (problem.parametrisation.steps, problem.emulator.control.size)
        self._shape_of_states = (problem.parametrisation.steps + 1, problem.emulator.state.size)
        self._defects = aligned(np.ravel(problem.defects)).reshape(np.shape(problem.defects))
        self._begin_at(np.asarray(problem.start, np.float32))

    def _begin_at(self, start: Float[np.ndarray, " S"]) -> None:
        self._start = start
        self._latent = np.ascontiguousarray(self._emulator.encode(start), np.float32)

    def at(self, start: Float[np.ndarray, " S"]) -> CEvaluator:
        other = copy(self)
        other._begin_at(start.astype(np.float32))
        return other

    def costs(self, zs: Float[np.ndarray, "K Z"]) -> Float[np.ndarray, " K"]:
        result = np.empty(len(zs))
        for first in range(0, len(zs), WIDTH):
            result[first : first + WIDTH] = self._costs_of_few(
                as_float32(zs[first : first + WIDTH])
            )
        return result

    def _costs_of_few(self, zs: Float[np.ndarray, "K Z"]) -> Float[np.ndarray, " K"]:
        controls = np.empty((len(zs), *self._shape_of_controls), np.float32)
        states = np.empty((len(zs), *self._shape_of_states), np.float32)
        for z, held in zip(zs, controls, strict=True):
            forward(self._varied, "controls", [z], held)
        states[:, 0] = self._start
        self._chain.lanes(self._latent, controls, self._defects, states)
        motions = zip(states, controls, strict=True)
        return np.array([self._objective.cost(*motion) for motion in motions])

    def gradients(
        self, zs: Float[np.ndarray, "K Z"]
    ) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, "K Z"]]:
        costs = np.empty(len(zs))
        slopes = np.empty(zs.shape)
        for number, z in enumerate(as_float32(zs)):
            motion = self._forward(z)
            costs[number] = motion.cost
            by_states = self._pull_states(motion, in_first_lane(motion.of_states))
            by_controls = self._pull_controls(motion, in_first_lane(motion.of_controls))
            slopes[number] = by_states[:, 0] + by_controls[:, 0]
        return costs, slopes

    def quadratic_models(self, zs: Float[np.ndarray, "K Z"]) -> list[QuadraticModel]:
        return [self._quadratic_model(z) for z in as_float32(zs)]

    def motion(self, z: Float[np.ndarray, " Z"]) -> EmulatedMotion:
        motion = self._forward(as_float32(z))
        return EmulatedMotion(motion.states.astype(float), motion.controls.astype(float))

    def _forward(self, z: Float[np.ndarray, " Z"]) -> _Pass:
        """Return the motion of z, ready to go back along."""
        controls = np.empty(self._shape_of_controls, np.float32)
        states = np.empty(self._shape_of_states, np.float32)
        states[0] = self._start
        tapes = {"controls": forward(self._varied, "controls", [z], controls)}
        tapes["chain"] = self._chain.forward(self._latent, controls, self._defects, states)
        of_states, tapes["states"] = self._objective.of_states(states, controls)
        of_controls, tapes["efforts"] = self._objective.of_controls(controls)
        return _Pass(z, controls, states, of_states, of_controls, tapes)

    def _pull_states(
        self, motion: _Pass, of: Float[np.ndarray, "R 16"]
    ) -> Float[np.ndarray, "Z 16"]:
        """Return what sixteen cotangents of the states' residuals say of z."""
        of_states = lanes(*self._shape_of_states)
        of_controls = lanes(*self._shape_of_controls)
        self._objective.pull_states(motion.tapes["states"], of, of_states, of_controls)
        touched = np.flatnonzero(of_states.any(axis=(1, 2)))
        last = int(touched[-1]) if len(touched) else 0
        self._chain.backward(motion.tapes["chain"], of_states, last, of_controls)
        return self._pull_z(motion, of_controls)

    def _pull_controls(
        self, motion: _Pass, of: Float[np.ndarray, "Q 16"]
    ) -> Float[np.ndarray, "Z 16"]:
        """Return what sixteen cotangents of the controls' residuals say of z."""
        of_controls = lanes(*self._shape_of_controls)
        self._objective.pull_controls(motion.tapes["efforts"], of, of_controls)
        return self._pull_z(motion, of_controls)

    def _pull_z(
        self, motion: _Pass, of_controls: Float[np.ndarray, "T C 16"]
    ) -> Float[np.ndarray, "Z 16"]:
        of_z = lanes(len(motion.z))
        backward(self._varied, "controls", motion.tapes["controls"], of_controls, of_z)
        return of_z

    def _quadratic_model(self, z: Float[np.ndarray, " Z"]) -> QuadraticModel:
        motion = self._forward(z)
        residuals = np.concatenate([motion.of_states, motion.of_controls])
        count = len(residuals)
        rows = np.empty((count, len(z)), np.float32)
        for first, of in _units(len(motion.of_states)):
            _fill(rows[: len(motion.of_states)], first, self._pull_states(motion, of))
        for first, of in _units(len(motion.of_controls)):
            _fill(rows[len(motion.of_states) :], first, self._pull_controls(motion, of))
        curvature = np.empty((len(z), len(z)), np.float32)
        slope = np.empty(len(z), np.float32)
        # Not by NumPy, whose threads wait for each other where a machine is busy.
        self._varied.library.quadratic_model(
            pointer(rows),
            pointer(residuals),
            ctypes.c_long(count),
            ctypes.c_long(len(z)),
            pointer(curvature),
            pointer(slope),
        )
        return QuadraticModel(curvature, slope.astype(float), motion.cost)


def _fill(rows: Float[np.ndarray, "R Z"], first: int, of_z: Float[np.ndarray, "Z 16"]) -> None:
    """Write sixteen rows of a Jacobian, or as many as are left."""
    present = min(WIDTH, len(rows) - first)
    rows[first : first + present] = of_z.T[:present]


def _units(count: int) -> Iterator[tuple[int, Float[np.ndarray, "R 16"]]]:
    """Yield (the first of them, unit cotangents of `count` residuals), sixteen at a time."""
    for first in range(0, count, WIDTH):
        of = lanes(count)
        present = np.arange(min(WIDTH, count - first))
        of[first + present, present] = 1
        yield first, of


def c_evaluator(problem: Problem) -> CEvaluator | None:
    """Return the evaluator of `problem` in C; None where there is none, for costs that are any JAX function too."""
    emulator = problem.emulator
    steps = problem.parametrisation.steps
    shape = MotionShape(steps, emulator.state.size, emulator.control.size, emulator.dt)
    scale = np.asarray(problem.control_scale, np.float32)
    objective = c_objective(problem.objective, shape, scale, emulator.rest)
    if objective is None:
        return None
    varied = _varied_of(problem.parametrisation)
    chain = chain_of(emulator)
    if varied is None or chain is None:
        return None
    return CEvaluator(problem, chain, objective, varied)


_known: Remembered[LoadedProgram | None] = Remembered()
"""The program of each parametrisation."""


def _varied_of(parametrisation: Parametrisation) -> LoadedProgram | None:
    """Return the program of `controls`, forward and backward, and of `quadratic_model`."""
    known = _known.of(parametrisation)
    if known is not UNKNOWN:
        return known
    program = None
    if type(parametrisation).__module__.startswith(OURS):
        leaves, structure = jax.tree.flatten(parametrisation)
        numbers = {str(number): np.asarray(leaf) for number, leaf in enumerate(leaves)}
        about = "\n".join(["controls", str(structure), digest(numbers)])
        make = partial(_write_controls, parametrisation)
        program = load_program(about, make, partial(_check_controls, parametrisation))
    return _known.keep(program, parametrisation)


def controls_in_c(
    parametrisation: Parametrisation, zs: Float[np.ndarray, "K Z"]
) -> Float[np.ndarray, "K T C"] | None:
    """Return the controls each row of `zs` stands for; None where there is no program for it."""
    program = _varied_of(parametrisation)
    if program is None:
        return None
    controls = np.empty((len(zs), parametrisation.steps, len(parametrisation.middle)), np.float32)
    for z, held in zip(zs, controls, strict=True):
        forward(program, "controls", [z], held)
    return controls


def _write_controls(parametrisation: Parametrisation) -> CProgram:
    constants = Constants()
    z = Input((parametrisation.size,))
    shape = (parametrisation.steps, len(parametrisation.middle))

    def pull(parametrisation: Parametrisation, z: Array, of: Array) -> Any:
        value, pull = jax.vjp(parametrisation.controls, z)
        return value, *pull(of)

    part = c_function(
        "controls", pull, parametrisation, [z, cotangents(*shape)], constants, is_public=True
    )
    program = program_of_parts({"controls": part}, constants, {})
    model = (resources.files("neuroanimator.control.descent") / "model.c").read_text(
        encoding="utf-8"
    )
    return CProgram(program.text + model, program.constants, program.sizes)


def _check_controls(parametrisation: Parametrisation, program: LoadedProgram) -> None:
    """Compare controls and their gradients about random z with JAX."""
    rng = np.random.default_rng(0)
    shape = (parametrisation.steps, len(parametrisation.middle))
    judge = pulled_in_jax(parametrisation.controls)
    for _ in range(TRIED):
        z = rng.normal(size=parametrisation.size).astype(np.float32)
        controls = np.empty(shape, np.float32)
        tape = forward(program, "controls", [z], controls)
        of = random_lanes(rng, *shape)
        found = lanes(len(z))
        backward(program, "controls", tape, of, found)
        compare_pulled((controls, found), judge(z, of))
