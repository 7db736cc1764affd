"""J and its derivatives in generated C: one call of `descent.c` for each quantity that a method needs.

    z → controls → chain of super steps → the terms' observations of latent states → residuals r,  J = |r|²/2

Derivatives are computed forward for sixteen tangents of z at a time, or backward from sixteen residuals, whichever is
less work.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from copy import copy
from functools import cache, partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.codegen.backend import backend
from neuroanimator.codegen.c_map import (
    Caller,
    CMap,
    MapDefinition,
    MapReference,
    c_struct,
    callers,
    compiled_callers,
    facts_computed,
    facts_of,
    map_references,
    program_of_maps,
)
from neuroanimator.codegen.kept import (
    LoadedProgram,
    address,
    has_code_in_sources,
    load_program,
)
from neuroanimator.codegen.program import WIDTH, aligned_zeros
from neuroanimator.control.descent.defects import LINK, link_definition, link_of
from neuroanimator.control.descent.evaluator import EmulatedMotion, Evaluator, QuadraticModel
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.descent.problem import Problem, VariedParameters
from neuroanimator.control.objective.c_objective import (
    CALLER,
    CObjective,
    ObjectiveForm,
    c_objective,
)
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.files.remembered import Remembered

CALLERS = (CALLER, ("neuroanimator.control.descent", "descent.c"))
"""C files that call the maps of a problem."""

CONTROLS = "controls"
"""Name of a parametrisation's map in C."""


class CEvaluator(Evaluator):
    """An evaluator that calls generated C; made by `c_evaluator`. Threads may share it."""

    def __init__(
        self,
        problem: Problem,
        library: ctypes.CDLL,
        objective: CObjective,
        controls: CMap,
        link: CMap,
    ):
        self._emulator: Emulator = problem.emulator
        self._objective = objective
        self._defects = as_float32(problem.defects)
        entries = () if problem.varied is None else problem.varied.latent_entries
        varied = np.array(entries, "long")
        struct = c_struct(
            objective.struct,
            controls.struct(),
            link.struct(),
            self._defects.shape[1],
            len(varied),
            address(varied),
        )
        self._kept = (controls, link, varied)  # the struct points into them
        self._call = Caller(library, struct, "room_of_problem")
        self._begin_at(problem.start)

    def _begin_at(self, state: Float[Array | np.ndarray, " S"]) -> None:
        """Remember the start of motions, and the terms' observations of it."""
        start = np.array(state, np.float32)
        self._start = start
        self._latent = start
        if self._objective.encoding is not None:
            self._latent = as_float32(self._emulator.encode(start))
        self._observed = np.zeros(self._objective.observations, np.float32)
        if self._objective.looks_at_start:
            self._call("observe_start", start, self._observed)
        begin = (self._latent, self._observed, self._defects)
        self._begin = c_struct(*map(address, begin))

    def at(self, start: Float[np.ndarray, " S"]) -> CEvaluator:
        other = copy(self)
        other._begin_at(start)
        return other

    def costs(self, zs: Float[np.ndarray, "K Z"]) -> Float[np.ndarray, " K"]:
        rows = as_float32(zs)
        costs = np.empty(len(rows))
        self._call("costs", self._begin, rows, len(rows), costs)
        return costs

    def gradients(
        self, zs: Float[np.ndarray, "K Z"]
    ) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, "K Z"]]:
        rows = as_float32(zs)
        slopes = np.empty(rows.shape, np.float32)
        pairs = zip(rows, slopes, strict=True)
        costs = [self._call("gradient", self._begin, z, slope) for z, slope in pairs]
        return np.array(costs), slopes.astype(float)

    def quadratic_models(self, zs: Float[np.ndarray, "K Z"]) -> list[QuadraticModel]:
        return [self._quadratic_model(z) for z in as_float32(zs)]

    def _quadratic_model(self, z: Float[np.ndarray, " Z"]) -> QuadraticModel:
        curvature = np.empty((len(z), len(z)), np.float32)
        slope = np.empty(len(z), np.float32)
        cost = self._call("quadratic_model", self._begin, z, curvature, slope)
        return QuadraticModel(curvature, slope.astype(float), cost)

    def motion(self, z: Float[np.ndarray, " Z"]) -> EmulatedMotion:
        shape = self._objective.shape
        controls = np.empty((shape.steps, shape.control), np.float32)
        latents = np.empty((shape.steps + 1, len(self._latent)), np.float32)
        self._call("motion", self._begin, as_float32(z), controls, latents)
        states = latents
        if self._objective.encoding is not None:
            states = self._emulator.decode(latents)
        states[0] = self._start
        return EmulatedMotion(states.astype(float), controls.astype(float))


@contextmanager
def loading_programs(emulator: Emulator, parametrisation: Parametrisation) -> Iterator[None]:
    """Load the programs of a descent, except that of its objective, while the block runs.

    On a new machine they are made in parallel with the objective's, on all cores. What fails here fails again in
    `c_evaluator`, which reports it. With the backend JAX nothing is loaded, and after the first descent through an emulator
    no threads are started: they take longer than a rollout.
    """
    if backend() == "jax" or link_of.knows(emulator):
        yield
        return
    with ThreadPoolExecutor() as pool:
        pool.submit(link_of, emulator)  # the longest first
        pool.submit(_library)
        pool.submit(controls_map, parametrisation)
        yield


@cache
def _library() -> ctypes.CDLL | None:
    """Return the library of `descent.c`; None if nothing can be compiled."""
    functions = {
        "room_of_problem": (1, ctypes.c_long),
        "observe_start": (4, None),
        "quadratic_model": (6, ctypes.c_double),
        "gradient": (5, ctypes.c_double),
        "motion": (6, None),
        "costs": (6, None),
    }
    return compiled_callers(CALLERS, functions)


def c_evaluator(problem: Problem) -> CEvaluator | None:
    """Return the evaluator of `problem` in C; None if there is none."""
    steps = problem.parametrisation.steps
    scale = as_float32(problem.control_scale)
    objective = c_objective(problem.objective, problem.emulator, steps, scale)
    if objective is None:
        return None
    controls = controls_map(problem.varied or problem.parametrisation)
    link = link_of(problem.emulator)
    library = _library()
    if controls is None or link is None or library is None:
        return None
    return CEvaluator(problem, library, objective, controls, link)


@Remembered
def controls_map(parametrisation: Parametrisation | VariedParameters) -> CMap | None:
    """Return z → controls (T, C) in C, followed by varied parameters; None if there is no such program."""
    definition = controls_definition(parametrisation)

    def about() -> list[str]:
        of_controls = parametrisation
        if isinstance(of_controls, VariedParameters):
            of_controls = of_controls.parametrisation
        if has_code_in_sources(of_controls):
            return [CONTROLS, *facts_of(parametrisation)]
        return [CONTROLS, *facts_computed(definition, len(NO_NUMBERS))]

    make = partial(program_of_maps, {CONTROLS: definition}, len(NO_NUMBERS))
    refer = partial(_controls_reference, definition)
    program = load_program(about, make, refer, _check, type(parametrisation).__name__)
    return None if program is None else CMap(program, CONTROLS, NO_NUMBERS)


def descent_maps(problem: Problem, form: ObjectiveForm) -> dict[str, MapDefinition]:
    """Return the maps of a descent by their names in C: those of its objective's `form`, `controls` of z, and the `link`."""
    return {
        **form.definitions(),
        CONTROLS: controls_definition(problem.parametrisation),
        LINK: link_definition(problem.emulator),
    }


def descent_callers() -> str:
    """Return the C program that computes J and its derivatives by calling the maps of a descent."""
    return callers(*CALLERS)


def controls_definition(parametrisation: Parametrisation | VariedParameters) -> MapDefinition:
    """Return the map z → controls (T, C), followed by varied parameters, in JAX."""
    return MapDefinition(_controls, parametrisation, parametrisation.size)


NO_NUMBERS = aligned_zeros(0)
"""All numbers of a parametrisation are constants of its program: spline bases are sparse, which the program uses."""


def _controls(
    parametrisation: Parametrisation | VariedParameters,
    _: Float[Array, " 0"],
    z: Float[Array, " Z"],
) -> Float[Array, " Y"]:
    controls = parametrisation.controls(z).ravel()
    if isinstance(parametrisation, VariedParameters):
        return jnp.concatenate([controls, parametrisation.values(z)])
    return controls


def _controls_reference(definition: MapDefinition) -> MapReference:
    """Return controls and their derivatives at random z, by JAX."""
    zs = np.random.default_rng(0).normal(size=(WIDTH, definition.inputs)).astype(np.float32)
    (reference,) = map_references([definition.with_numbers(NO_NUMBERS)], [zs])
    return reference


def _check(reference: MapReference, program: LoadedProgram) -> None:
    CMap(program, CONTROLS, NO_NUMBERS).check(reference)


def controls_in_c(
    parametrisation: Parametrisation, zs: Float[np.ndarray, "K Z"]
) -> Float[np.ndarray, "K T C"] | None:
    """Return the controls of each row of `zs`; None if there is no program."""
    in_c = controls_map(parametrisation)
    if in_c is None:
        return None
    return in_c.of_rows(zs).reshape(len(zs), parametrisation.steps, -1)
