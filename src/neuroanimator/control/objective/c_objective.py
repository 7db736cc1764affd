"""An objective in generated C: what its terms observe of single states, the residuals of that, and those of the controls.

The program is known by the objective's form: its numbers (weights, goals, tolerances) go in with every call, so that
another goal of the same kind needs no other program. Costs that are any JAX function are left to JAX.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.codegen.c_map import (
    CMap,
    MapDefinition,
    MapStruct,
    callers,
    check_maps,
    facts_of,
    judge_of,
    program_of_maps,
)
from neuroanimator.codegen.kept import FLAGS, CProgram, LoadedProgram, aligned, load_program
from neuroanimator.codegen.program import WIDTH
from neuroanimator.codegen.workspaces import WorkspacePool
from neuroanimator.compiler.compiler import compiled_library
from neuroanimator.control.objective.objective import Objective, StateTerm
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.encoding import Encoding
from neuroanimator.emulator.probes import compiled_quickly
from neuroanimator.jax_later import Array, jax, jnp
from neuroanimator.pytrees import leaves, map_leaves, structure_in_words
from neuroanimator.storage.remembered import UNKNOWN, Remembered

CALLER = ("neuroanimator.control.objective", "objective.c")
"""The C that calls the maps of an objective."""

NOISE = 0.1
"""Distance from rest, in every number, of the states at which maps are compared with JAX."""

START = 0
"""The row of a motion that is its start."""


@dataclass(frozen=True)
class MotionShape:
    """What the motions are that an objective judges."""

    steps: int
    state: int
    """Numbers of a state."""
    control: int
    """Numbers of a control."""
    dt: float
    """[s]"""


class TermStruct(ctypes.Structure):
    """`na_term` of `objective.c`."""

    _fields_ = (
        ("of_latent", MapStruct),
        ("of_state", MapStruct),
        ("rows", ctypes.c_void_p),
        ("count", ctypes.c_long),
    )


class ObjectiveStruct(ctypes.Structure):
    """`na_objective` of `objective.c`."""

    _fields_ = (
        ("terms", ctypes.c_void_p),
        ("count", ctypes.c_long),
        ("residuals", MapStruct),
        ("efforts", MapStruct),
        ("steps", ctypes.c_long),
        ("state", ctypes.c_long),
    )


@dataclass(frozen=True, eq=False)
class CTerm:
    """A term that looks at states."""

    of_latent: CMap
    """(Numbers, latent state) → what it observes of that."""
    of_state: CMap
    """The same of a state as it is."""
    rows: np.ndarray
    """Which states of a motion it looks at, as C's `long`."""

    def struct(self) -> TermStruct:
        """Return what C calls it by."""
        return TermStruct(
            self.of_latent.struct(), self.of_state.struct(), self.rows.ctypes.data, len(self.rows)
        )


@dataclass(frozen=True, eq=False)
class CObjective:
    """The program of an objective's form with one objective's numbers; threads may share it."""

    library: ctypes.CDLL
    """Of `objective.c`."""
    shape: MotionShape
    encoding: Encoding | None
    """Of the latent states that are observed; None where these are the states themselves."""
    terms: tuple[CTerm, ...]
    residuals: CMap
    """(Numbers, what all terms observed) → residuals of the terms that look at states."""
    efforts: CMap
    """(Numbers, controls) → residuals of the terms that look at controls alone."""

    @property
    def looks_at_start(self) -> bool:
        """Whether a term looks at the start of motions."""
        return any((term.rows == START).any() for term in self.terms)

    @cached_property
    def struct(self) -> ObjectiveStruct:
        """What C calls it by; it points into this objective, which must live as long."""
        return ObjectiveStruct(
            ctypes.addressof(self._terms),
            len(self.terms),
            self.residuals.struct(),
            self.efforts.struct(),
            self.shape.steps,
            self.shape.state,
        )

    @cached_property
    def _terms(self) -> Any:
        structs = [term.struct() for term in self.terms]
        return (TermStruct * len(structs))(*structs)

    @cached_property
    def _workspaces(self) -> WorkspacePool:
        return WorkspacePool(self.library.room_of_objective(ctypes.addressof(self.struct)))

    def cost(self, states: Float[np.ndarray, "T1 S"], controls: Float[np.ndarray, "T C"]) -> float:
        """Return J of a motion."""
        motion = (states.ctypes.data, controls.ctypes.data)
        with self._workspaces.acquire() as workspace:
            return self.library.cost_of_states(ctypes.addressof(self.struct), *motion, workspace)

    def cost_and_slopes(
        self, states: Float[np.ndarray, "T1 S"], controls: Float[np.ndarray, "T C"]
    ) -> tuple[float, tuple[Float[np.ndarray, "T1 S"], Float[np.ndarray, "T C"]]]:
        """Return (J, (how it changes with the states, how it changes with the controls))."""
        slopes = (np.empty_like(states), np.empty_like(controls))
        arrays = [array.ctypes.data for array in (states, controls, *slopes)]
        with self._workspaces.acquire() as workspace:
            cost = self.library.slopes_of_states(ctypes.addressof(self.struct), *arrays, workspace)
        return cost, slopes


@cache
def _library() -> ctypes.CDLL | None:
    """Return the library of `objective.c`; None where nothing can be compiled."""
    library = compiled_library(callers(CALLER), FLAGS)
    if library is None:
        return None
    address = ctypes.c_void_p
    library.room_of_objective.argtypes = [address]
    library.room_of_objective.restype = ctypes.c_long
    library.cost_of_states.argtypes = [address] * 4
    library.cost_of_states.restype = ctypes.c_double
    library.slopes_of_states.argtypes = [address] * 6
    library.slopes_of_states.restype = ctypes.c_double
    return library


@dataclass(frozen=True)
class ObjectiveForm:
    """An objective without its numbers, and the motions it judges."""

    objective: Objective
    """With terms that look at states and terms of controls, and no functions."""
    shape: MotionShape
    encoding: Encoding | None
    """Of latent states; None where these are the states themselves."""

    @property
    def terms(self) -> list[StateTerm]:
        """The terms that look at states."""
        return [term for term in self.objective.terms if isinstance(term, StateTerm)]

    @property
    def sizes(self) -> list[int]:
        """How many numbers each array of the objective has; then how many controls have a scale."""
        return [np.size(leaf) for leaf in leaves(self.objective)] + [self.shape.control]

    def numbers(self, scale: Float[np.ndarray, " C"]) -> Float[np.ndarray, " P"]:
        """Return what goes in with every call: the arrays of the objective, then the `scale` of controls."""
        flat = [np.ravel(leaf) for leaf in leaves(self.objective)]
        return aligned(np.concatenate([*flat, scale]).astype(np.float32))

    def about(self) -> str:
        """Return all that the program depends on."""
        shapes = [np.shape(leaf) for leaf in leaves(self.objective)]
        facts = ["objective", structure_in_words(self.objective), str(shapes), str(self.shape)]
        if self.encoding is not None:
            facts += facts_of(self.encoding)
        return "\n".join(facts)

    def rows(self, term: StateTerm) -> list[int]:
        """Return which states of a motion `term` looks at."""
        return term.rows(self.shape.steps, self.shape.dt)

    def observed_size(self, term: StateTerm) -> int:
        """Return how many numbers `term` observes of a state."""
        state = jax.ShapeDtypeStruct((self.shape.state,), np.float32)
        (size,) = jax.eval_shape(term.observe, state).shape
        return size

    def definitions(self) -> dict[str, MapDefinition]:
        """Return every map by its name."""
        result = {}
        observed = 0
        for number, term in enumerate(self.terms):
            of_state = partial(self._observe, number)
            result[f"state_{number}"] = MapDefinition(of_state, None, self.shape.state)
            if self.encoding is not None:
                of_latent = partial(self._observe_latent, number)
                latent = self.encoding.layout.size
                result[f"latent_{number}"] = MapDefinition(of_latent, self.encoding, latent)
            observed += len(self.rows(term)) * self.observed_size(term)
        result["residuals"] = MapDefinition(self._residuals, None, observed)
        controls = self.shape.steps * self.shape.control
        result["efforts"] = MapDefinition(self._efforts, None, controls)
        return result

    def _judge(self, numbers: Float[Array, " P"]) -> tuple[Objective, Float[Array, " C"]]:
        """Return the objective with these numbers, and the scale of the controls."""
        *parts, scale = jnp.split(numbers, np.cumsum(self.sizes)[:-1])
        remaining = iter(parts)
        objective = map_leaves(lambda leaf: next(remaining).reshape(np.shape(leaf)), self.objective)
        return objective, scale

    def _state_terms(self, numbers: Float[Array, " P"]) -> list[StateTerm]:
        return replace(self, objective=self._judge(numbers)[0]).terms

    def _observe(
        self, number: int, _: None, numbers: Float[Array, " P"], state: Float[Array, " S"]
    ) -> Float[Array, " O"]:
        return self._state_terms(numbers)[number].observe(state)

    def _observe_latent(
        self,
        number: int,
        encoding: Encoding,
        numbers: Float[Array, " P"],
        latent: Float[Array, " I"],
    ) -> Float[Array, " O"]:
        return self._observe(number, None, numbers, encoding.decode(latent))

    def _residuals(
        self, _: None, numbers: Float[Array, " P"], observed: Float[Array, " N"]
    ) -> Float[Array, " R"]:
        """Return the residuals of the terms that look at states, as `Objective.residuals` does."""
        terms = self._state_terms(numbers)
        shapes = [(len(self.rows(term)), self.observed_size(term)) for term in terms]
        ends = np.cumsum([math.prod(shape) for shape in shapes])
        parts = []
        for term, shape, flat in zip(terms, shapes, jnp.split(observed, ends[:-1]), strict=True):
            residuals = term.compare(flat.reshape(shape), self.shape.dt)
            parts.append(jnp.sqrt(term.weight) * residuals)
        return jnp.concatenate(parts)

    def _efforts(
        self, _: None, numbers: Float[Array, " P"], controls: Float[Array, " N"]
    ) -> Float[Array, " Q"]:
        """Return the residuals of the terms that look at controls alone."""
        objective, scale = self._judge(numbers)
        still = jnp.zeros((self.shape.steps + 1, self.shape.state))
        held = controls.reshape(self.shape.steps, self.shape.control)
        motion = Trajectory(still, held, scale, self.shape.dt)
        return objective.apart()[1].residuals(motion)

    def write(self) -> CProgram:
        """Return the program of all maps."""
        return program_of_maps(self.definitions(), sum(self.sizes))

    def check(
        self,
        rest: Float[np.ndarray, " S"],
        encode: Callable[[np.ndarray], np.ndarray],
        numbers: Float[np.ndarray, " P"],
        program: LoadedProgram,
    ) -> None:
        """Compare all maps with JAX: at states about `rest`, what is observed of them, and random controls."""
        rng = np.random.default_rng(0)
        definitions = self.definitions()
        maps = {name: CMap(program, name, numbers) for name in definitions}
        noise = rng.normal(size=(WIDTH, self.shape.state))
        states = (rest + NOISE * noise).astype(np.float32)
        observed = []
        points = {}
        for number, term in enumerate(self.terms):
            points[f"state_{number}"] = states
            points[f"latent_{number}"] = encode(states)
            seen = maps[f"state_{number}"].of_rows(states)
            for _ in self.rows(term):
                observed.append(rng.permutation(seen))
        points["residuals"] = np.concatenate(observed, axis=1)
        controls = rng.normal(size=(WIDTH, maps["efforts"].inputs))
        points["efforts"] = controls.astype(np.float32)
        functions = [one.with_numbers(numbers) for one in definitions.values()]
        judge = compiled_quickly(judge_of(functions))
        check_maps(list(maps.values()), judge, [points[name] for name in maps])

    def load(self, program: LoadedProgram, numbers: Float[np.ndarray, " P"]) -> CObjective | None:
        """Return the objective that calls `program` with these numbers; None where its caller cannot be compiled."""
        library = _library()
        if library is None:
            return None
        terms = []
        for number, term in enumerate(self.terms):
            of_state = CMap(program, f"state_{number}", numbers)
            of_latent = of_state
            if self.encoding is not None:
                of_latent = CMap(program, f"latent_{number}", numbers)
            terms.append(CTerm(of_latent, of_state, np.array(self.rows(term), np.dtype("long"))))
        residuals = CMap(program, "residuals", numbers)
        efforts = CMap(program, "efforts", numbers)
        return CObjective(library, self.shape, self.encoding, tuple(terms), residuals, efforts)


_known: Remembered[CObjective | None] = Remembered()
"""The program of each objective, by the motions it judges and the scale of their controls."""


def c_objective(
    objective: Objective, emulator: Emulator, steps: int, scale: Float[np.ndarray, " C"]
) -> CObjective | None:
    """Return `objective` in C for motions of so many super steps, whose controls count as full effort at `scale`.

    None where there is no such program: without a compiler, for costs that are any JAX function, and for terms that
    are not the package's own. A program that does not do what JAX does about the emulator's rest is refused, which is
    said once.
    """
    shape = MotionShape(steps, emulator.state.size, emulator.control.size, emulator.dt)
    encoding = None if emulator.encoding.is_identity else emulator.encoding
    # What is remembered holds the encoding, so that no other one comes by its address.
    key = (shape, scale.tobytes(), id(encoding))
    known = _known.of(objective, *key)
    if known is not UNKNOWN:
        return known
    form = ObjectiveForm(objective, shape, encoding)
    return _known.keep(_load(form, emulator, scale), objective, *key)


def _load(
    form: ObjectiveForm, emulator: Emulator, scale: Float[np.ndarray, " C"]
) -> CObjective | None:
    objective = form.objective
    if not objective.is_ours or not form.terms:
        return None
    if not all(term.of_controls or isinstance(term, StateTerm) for term in objective.terms):
        return None
    numbers = form.numbers(scale)

    def encode(states: Float[np.ndarray, "N S"]) -> Float[np.ndarray, "N I"]:
        return np.asarray(emulator.encode(states), np.float32)

    check = partial(form.check, emulator.rest, encode, numbers)
    program = load_program(form.about(), form.write, check)
    return None if program is None else form.load(program, numbers)
