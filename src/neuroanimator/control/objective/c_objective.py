"""An objective in generated C: its costs' observations of single states, their residuals, and those of the controls.

A cost of whole motions observes the entries of states it computes with. The program is identified by the objective's
form: its numbers (weights, goals, tolerances) are arguments of every call, so that another goal of the same kind needs no
other program. The package's costs are identified by their names, all others by what they compute.
"""

from __future__ import annotations

import ctypes
from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache, partial
from typing import Any, NamedTuple, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from neuroanimator.codegen.c_map import (
    Caller,
    CMap,
    MapDefinition,
    MapReference,
    c_struct,
    compiled_callers,
    facts_computed,
    facts_of,
    map_references,
    program_of_maps,
)
from neuroanimator.codegen.kept import (
    CProgram,
    LoadedProgram,
    address,
    aligned,
    has_code_in_sources,
    load_program,
)
from neuroanimator.codegen.program import WIDTH
from neuroanimator.codegen.trace import Input, TooLongError, trace
from neuroanimator.control.objective.objective import (
    CostFunction,
    CostTerm,
    Objective,
    StateTerm,
    Trajectory,
    checked_rows,
)
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.encoding import Encoding
from neuroanimator.files.remembered import Remembered
from neuroanimator.state.arrays import AnyArray

CALLER = ("neuroanimator.control.objective", "objective.c")
"""C file that calls the maps of an objective."""

MAX_TEXT = 1_000_000
"""Maximum length of a program: each 100 kB take a compiler three seconds, and JAX needs fifteen for anything."""

NOISE = 0.1
"""Standard deviation around rest, in every number, of the states at which maps are compared with JAX."""

FORMS = 64
"""Maximum number of forms whose programs are remembered."""

START = 0
"""Row of a motion's start."""


@dataclass(frozen=True)
class MotionShape:
    """Sizes of the motions that an objective judges."""

    steps: int
    state: int
    """Length of a state."""
    control: int
    """Length of a control."""
    dt: float
    """Duration of a super step [s]."""


@dataclass(frozen=True, eq=False)
class CObjective:
    """The program of an objective's form with one objective's numbers; threads may share it."""

    shape: MotionShape
    encoding: Encoding | None
    """Encoding of the observed latent states; None if these are the states themselves."""
    observations: int
    """Count of all observations of a motion by the terms, and of controls that terms of states look at."""
    looks_at_start: bool
    """Whether a term looks at the start of motions."""
    struct: np.ndarray
    """`na_objective` of `objective.c`; it points into `kept`."""
    kept: tuple[Any, ...]
    call: Caller
    """Calls `objective.c`."""

    def cost(self, states: Float[np.ndarray, "T1 S"], controls: Float[np.ndarray, "T C"]) -> float:
        """Return J of a motion."""
        return self.call("cost_of_states", states, controls)

    def cost_and_slopes(
        self, states: Float[np.ndarray, "T1 S"], controls: Float[np.ndarray, "T C"]
    ) -> tuple[float, tuple[Float[np.ndarray, "T1 S"], Float[np.ndarray, "T C"]]]:
        """Return (J, (its gradient by the states, its gradient by the controls))."""
        slopes = (np.empty_like(states), np.empty_like(controls))
        return self.call("slopes_of_states", states, controls, *slopes), slopes


@cache
def _library() -> ctypes.CDLL | None:
    """Return the library of `objective.c`; None if nothing can be compiled."""
    functions = {
        "room_of_objective": (1, ctypes.c_long),
        "cost_of_states": (4, ctypes.c_double),
        "slopes_of_states": (6, ctypes.c_double),
    }
    return compiled_callers([CALLER], functions)


class CostView(NamedTuple):
    """Part of a motion that one cost looks at."""

    rows: Int[np.ndarray, " K"]
    """States of the motion."""
    entries: Int[np.ndarray, " O"] | None = None
    """Entries of these states, for a cost of whole motions; None for a term that observes states itself."""
    has_controls: bool = False
    """Whether it also looks at the controls."""


Cost = CostTerm | CostFunction


@dataclass(frozen=True)
class ObjectiveForm:
    """An objective without its numbers, and the motions it judges; forms are equal if their programs are.

    The costs of states are the terms except those of controls alone, then the functions.
    """

    objective: Objective = field(compare=False)
    """An objective of this form."""
    emulator: Emulator = field(compare=False)
    """An emulator whose motions have this shape."""
    shape: MotionShape
    identity: Hashable
    """Identity of the costs and the encoding in this process."""

    @classmethod
    def of(cls, objective: Objective, emulator: Emulator, steps: int) -> ObjectiveForm:
        """Return the form of an objective that judges motions of `steps` super steps."""
        shape = MotionShape(steps, emulator.state.size, emulator.control.size, emulator.dt)
        encoding = () if emulator.encoding.is_identity else id(emulator.encoding)
        return cls(objective, emulator, shape, (_identity(objective), encoding))

    @property
    def encoding(self) -> Encoding | None:
        """The encoding of latent states; None if these are the states themselves."""
        return None if self.emulator.encoding.is_identity else self.emulator.encoding

    @property
    def sizes(self) -> list[int]:
        """Sizes of the terms' arrays, then the number of controls with a scale."""
        return [np.size(array) for array in numbers_of(self.objective)] + [self.shape.control]

    def numbers(
        self, objective: Objective, scale: Float[np.ndarray, " C"]
    ) -> Float[np.ndarray, " P"]:
        """Return the numbers for every call: the arrays of an objective of this form, then the `scale` of controls."""
        flat = [np.ravel(array) for array in numbers_of(objective)]
        return aligned(np.concatenate([*flat, scale]).astype(np.float32))

    def with_numbers(self, numbers: Float[AnyArray, " P"]) -> Objective:
        """Return the objective of this form with these `numbers`."""
        used = 0

        def placed(leaf: Any) -> Any:
            nonlocal used
            if not is_number(leaf):
                return leaf
            some = numbers[used : used + np.size(leaf)]
            used += np.size(leaf)
            return some.reshape(np.shape(leaf))

        return replace(self.objective, terms=jax.tree.map(placed, self.objective.terms))

    def about(self) -> list[str]:
        """Return everything that the program depends on; nothing without a cost that looks at states."""
        if not self.views:
            return []
        facts = ["objective", str(self.shape)]
        if is_known_by_name(self.objective):
            shapes = [np.shape(array) for array in numbers_of(self.objective)]
            facts += [str(jax.tree.structure(self.objective)), str(shapes)]
        else:
            for definition in self.definitions().values():
                facts += facts_computed(definition, sum(self.sizes))
        if self.encoding is not None:
            facts += facts_of(self.encoding)
        return facts

    def _costs(self, numbers: Float[AnyArray, " P"]) -> list[Cost]:
        """Return the costs of states, with these `numbers`."""
        objective = self.with_numbers(numbers)
        of_states, _ = objective.apart()
        return [*of_states.terms, *objective.functions]

    @cached_property
    def views(self) -> list[CostView]:
        """Parts of a motion that each cost looks at."""
        costs = self._costs(np.zeros(sum(self.sizes), np.float32))
        return [self._view(number, cost) for number, cost in enumerate(costs)]

    def _view(self, number: int, cost: Cost) -> CostView:
        if observes_states(cost):
            return CostView(checked_rows(cost, self.shape.steps, self.shape.dt))
        return self._view_of_motion(number)

    def _view_of_motion(self, number: int) -> CostView:
        """Return the part of a motion that a cost of whole motions computes with."""
        shape = self.shape

        def judge(_: None, numbers: Array, states: Array, controls: Array) -> Array:
            cost = self._costs(numbers)[number]
            return _judged(cost, Trajectory(states, controls, self._scale(numbers), shape.dt))

        inputs = ((sum(self.sizes),), (shape.steps + 1, shape.state), (shape.steps, shape.control))
        _, of_states, of_controls = trace(judge, None, *map(Input, inputs)).read()
        # At least one number: there is no map of none.
        of_states[START, 0] |= not of_states.any()
        rows = np.flatnonzero(of_states.any(axis=1))
        entries = np.flatnonzero(of_states.any(axis=0))
        return CostView(rows, entries, bool(of_controls.any()))

    @cached_property
    def observed_sizes(self) -> list[int]:
        """Number of observations of a state by each cost."""
        inputs = ((sum(self.sizes),), (self.shape.state,))
        arrays = [jax.ShapeDtypeStruct(shape, np.float32) for shape in inputs]
        sizes = []
        for number in range(len(self.views)):
            (size,) = jax.eval_shape(partial(self._observe, number, None), *arrays).shape
            sizes.append(size)
        return sizes

    def _scale(self, numbers: Float[AnyArray, " P"]) -> Float[AnyArray, " C"]:
        return numbers[len(numbers) - self.shape.control :]

    @property
    def controls(self) -> int:
        """Count of all controls of a motion, if a cost of states also looks at them; 0 otherwise."""
        has_controls = any(view.has_controls for view in self.views)
        return self.shape.steps * self.shape.control * has_controls

    def definitions(self) -> dict[str, MapDefinition]:
        """Return every map by name."""
        result = {}
        observed = 0
        for number, view in enumerate(self.views):
            observe = partial(self._observe, number)
            result[f"state_{number}"] = MapDefinition(observe, None, self.shape.state)
            if self.encoding is not None:
                latent = self.encoding.layout.size
                result[f"latent_{number}"] = MapDefinition(observe, self.encoding, latent)
            observed += len(view.rows) * self.observed_sizes[number]
        result["residuals"] = MapDefinition(self._residuals, None, observed + self.controls)
        controls = self.shape.steps * self.shape.control
        result["efforts"] = MapDefinition(self._efforts, None, controls)
        return result

    def _observe(
        self,
        number: int,
        encoding: Encoding | None,
        numbers: Float[Array, " P"],
        state: Float[Array, " I"],
    ) -> Float[Array, " O"]:
        """Return what a cost observes of a state, or of a latent one if there is an `encoding`."""
        if encoding is not None:
            state = encoding.decode(state)
        cost = self._costs(numbers)[number]
        if observes_states(cost):
            return cost.observe(state)
        return state[self.views[number].entries]

    def _residuals(
        self, _: None, numbers: Float[Array, " P"], observed: Float[Array, " N"]
    ) -> Float[Array, " R"]:
        """Return the residuals of the terms of states, then the values of the functions."""
        shape = self.shape
        controls = jnp.zeros((shape.steps, shape.control))
        if self.controls:
            controls = observed[len(observed) - self.controls :].reshape(controls.shape)
        parts = []
        used = 0
        costs = zip(self._costs(numbers), self.views, self.observed_sizes, strict=True)
        for cost, view, size in costs:
            count = len(view.rows) * size
            seen = observed[used : used + count].reshape(len(view.rows), size)
            used += count
            if observes_states(cost):
                parts.append(jnp.sqrt(cost.weight) * cost.compare(seen, shape.dt))
                continue
            assert view.entries is not None
            states = jnp.zeros((shape.steps + 1, shape.state))
            states = states.at[np.ix_(view.rows, view.entries)].set(seen)
            motion = Trajectory(states, controls, self._scale(numbers), shape.dt)
            parts.append(_judged(cost, motion))
        return jnp.concatenate(parts)

    def _efforts(
        self, _: None, numbers: Float[Array, " P"], controls: Float[Array, " N"]
    ) -> Float[Array, " Q"]:
        """Return the residuals of the terms of controls alone."""
        still = jnp.zeros((self.shape.steps + 1, self.shape.state))
        held = controls.reshape(self.shape.steps, self.shape.control)
        motion = Trajectory(still, held, self._scale(numbers), self.shape.dt)
        return self.with_numbers(numbers).apart()[1].residuals(motion)

    def write(self) -> CProgram:
        """Return the program of all maps."""
        program = program_of_maps(self.definitions(), sum(self.sizes))
        if len(program.text) > MAX_TEXT:
            raise TooLongError(len(program.text))
        return program

    def refer(self) -> dict[str, MapReference]:
        """Return JAX's reference of each map: at states near rest, their observations, and random controls."""
        rng = np.random.default_rng(0)
        noise = rng.normal(size=(WIDTH, self.shape.state))
        states = (self.emulator.rest + NOISE * noise).astype(np.float32)
        latents = np.asarray(self.emulator.encode(states), np.float32)
        points = {}
        for number in range(len(self.views)):
            points[f"state_{number}"] = states
            if self.encoding is not None:
                points[f"latent_{number}"] = latents
        references = self._references(points)
        controls = self.shape.steps * self.shape.control
        efforts = rng.normal(size=(WIDTH, controls)).astype(np.float32)
        observed = []
        for number, view in enumerate(self.views):
            for _ in view.rows:
                observed.append(rng.permutation(references[f"state_{number}"].values))
        residuals = np.concatenate([*observed, efforts[:, : self.controls]], axis=1)
        return references | self._references({"residuals": residuals, "efforts": efforts})

    def _references(self, points: dict[str, Float[np.ndarray, "16 _"]]) -> dict[str, MapReference]:
        """Return JAX's references of the maps of these names at their `points`."""
        definitions = self.definitions()
        functions = [definitions[name].with_numbers(self._typical) for name in points]
        references = map_references(functions, list(points.values()))
        return dict(zip(points, references, strict=True))

    @property
    def _typical(self) -> Float[np.ndarray, " P"]:
        """Numbers with which the maps are checked."""
        return self.numbers(self.objective, as_float32(self.emulator.bounds.magnitude))

    def check(self, references: dict[str, MapReference], program: LoadedProgram) -> None:
        """Raise WrongProgramError unless every map agrees with JAX."""
        numbers = self._typical
        for name, reference in references.items():
            CMap(program, name, numbers).check(reference)

    def load(self, program: LoadedProgram, numbers: Float[np.ndarray, " P"]) -> CObjective | None:
        """Return the objective that calls `program` with these numbers; None if its caller cannot be compiled."""
        library = _library()
        if library is None:
            return None
        # By name, not from the definitions: JAX would trace these, also where the program is kept.
        map_of = partial(CMap, program, numbers=numbers)
        observed = "state" if self.encoding is None else "latent"
        rows = [view.rows.astype("long") for view in self.views]
        terms = []
        for number, some in enumerate(rows):
            of_latent = map_of(f"{observed}_{number}").struct()
            of_state = map_of(f"state_{number}").struct()
            terms.append(c_struct(of_latent, of_state, address(some), len(some)))
        all_terms = np.concatenate(terms)
        struct = c_struct(
            address(all_terms),
            len(terms),
            map_of("residuals").struct(),
            map_of("efforts").struct(),
            self.shape.steps,
            self.shape.state,
            self.controls,
            len(self.objective.functions),
        )
        return CObjective(
            self.shape,
            self.encoding,
            map_of("residuals").size("inputs"),
            any((some == START).any() for some in rows),
            struct,
            (program, numbers, rows, all_terms),
            Caller(library, struct, "room_of_objective"),
        )


def observes_states(cost: Cost) -> TypeGuard[StateTerm]:
    """Return whether a cost looks at single states, independently, rather than at whole motions."""
    return isinstance(cost, StateTerm) and type(cost).residuals is StateTerm.residuals


def _judged(cost: Cost, motion: Trajectory) -> Float[Array, " R"]:
    """Return the weighted residuals of a term, or the value of a function."""
    if isinstance(cost, CostTerm):
        return jnp.sqrt(cost.weight) * cost.residuals(motion)
    return jnp.reshape(cost(motion), (1,))


def is_number(leaf: Any) -> bool:
    """Return whether a leaf of a term is an argument of every call; all others are part of the program."""
    return isinstance(leaf, float) or getattr(leaf, "dtype", np.dtype(object)).kind == "f"


def numbers_of(objective: Objective) -> list[Any]:
    """Return the arrays of the terms that hold their numbers."""
    return [leaf for leaf in jax.tree.leaves(objective.terms) if is_number(leaf)]


def is_known_by_name(objective: Objective) -> bool:
    """Return whether the names of all costs determine what they compute, as their code is the package's."""
    has_numbers_alone = all(map(is_number, jax.tree.leaves(objective.terms)))
    is_ours = all(map(has_code_in_sources, objective.terms))
    return is_ours and has_numbers_alone and not objective.functions


def _identity(objective: Objective) -> Hashable:
    """Return the identity of an objective in this process, apart from its numbers."""
    shapes = []
    for leaf in jax.tree.leaves(objective.terms):
        shapes.append(np.shape(leaf) if is_number(leaf) else id(leaf))
    if is_known_by_name(objective):
        return str(jax.tree.structure(objective)), *shapes
    functions = map(id, objective.functions)
    return jax.tree_util.tree_structure(objective.terms), *shapes, *functions


@Remembered
def _programs_of(objective: Objective) -> dict[Hashable, CObjective | None]:
    """Return the known programs of an objective, by the motions it judges and the scale of their controls."""
    return {}


def c_objective(
    objective: Objective, emulator: Emulator, steps: int, scale: Float[np.ndarray, " C"]
) -> CObjective | None:
    """Return `objective` in C for motions of `steps` super steps, whose controls count as full effort at `scale`.

    None if there is no such program: without a compiler, without a cost of states, and, reported
    once, for costs without C and for a program that differs from JAX near the emulator's rest.
    """
    encoding = None if emulator.encoding.is_identity else emulator.encoding
    # The remembered program holds the encoding, so that no other one can get its address.
    key = (steps, emulator.state.size, emulator.dt, scale.tobytes(), id(encoding))
    known = _programs_of(objective)
    if key not in known:
        prepared = _prepared(ObjectiveForm.of(objective, emulator, steps))
        in_c = None
        if prepared is not None:
            form, program = prepared
            in_c = form.load(program, form.numbers(objective, scale))
        known[key] = in_c
    return known[key]


@lru_cache(maxsize=FORMS)
def _prepared(form: ObjectiveForm) -> tuple[ObjectiveForm, LoadedProgram] | None:
    """Return (the first form equal to this one, its program); None if there is no program."""
    reported = str(form.objective)
    program = load_program(form.about, form.write, form.refer, form.check, reported)
    return None if program is None else (form, program)
