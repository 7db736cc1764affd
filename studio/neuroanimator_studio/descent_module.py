"""A descent as a WebAssembly module: J of a motion and its derivatives, for a page that looks for controls.

The C is what a descent of a NumPy user runs (`control.descent.descent.c`, and the maps it calls), for one problem: its
emulator, its terms and what is varied are constants of the module. The numbers of its objective (weights, goals,
tolerances), the start and the defects are data, so that a target may be dragged without another module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import resources
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

import neuroanimator
from neuroanimator import Emulator, NeuroAnimatorError, Objective
from neuroanimator.authoring import (
    DOUBTS,
    FORMS,
    GAUSS_NEWTON,
    Input,
    ObjectiveForm,
    SharedConstants,
    WasmModule,
    as_float32,
    c_function,
    c_map,
    c_number,
    descent_callers,
    descent_maps,
    import_wasmtime,
    latent_size,
    rounded,
    still_frame,
    wasm_module,
)
from neuroanimator.control import Evaluator, Problem, evaluator_of, find_defects

FUNCTIONS = (
    "room", "begin_at", "costs", "quadratic_model", "motion", "defects_of", "numbers", "defects",
)  # fmt: skip
"""What a module exports, all of it called `descent_...`."""

NAME = "descent"

ITERATIONS = 20
"""Backward sweeps of a descent in a page: those of 1998."""


USED = ("forward", "backward", "push", "lanes")
"""What a module calls of its maps: a quadratic model needs no single slope, and what is not called is not in it."""

TOLERANCE = 2e-3
"""Tolerance of J and its derivatives, over their largest: both sum float32 in orders of their own."""


NEARBY = 0.3
"""Distance from each first guess of the z at which modules are held against Python."""


MOVED = (0.5, 1.0)
"""Share of the way to its end by which what may be moved is, for some comparisons."""

COSTS = 7
"""Number of z judged side by side: more than one after the other would be."""

DEFECTIVE = 0.01
"""Distance, in every number, of the motions along which defects are compared."""


@dataclass(frozen=True)
class Write:
    """One number of the objective that follows a movable value: it is `component` of that, plus `offset`."""

    entry: int
    component: int
    offset: float = 0.0


@dataclass(frozen=True)
class Movable:
    """What a page may change of the objective: drag a target, turn a bay, weigh effort."""

    name: str
    kind: str
    """`place`: (x, y, z) in the world. `heading`: an angle about Z, whose numbers are cosine and sine of its half, as in
    quaternions. `number`: one number, such as a weight."""
    unit: str
    value: tuple[float, ...]
    """What it is at first."""
    low: tuple[float, ...]
    high: tuple[float, ...]
    """Between these the descent was tried and does what it says."""
    writes: tuple[Write, ...]

    def components(self, value: Float[np.ndarray, " N"]) -> Float[np.ndarray, " M"]:
        """Return the numbers that `writes` speak of."""
        if self.kind == "heading":
            half = float(value[0]) / 2
            return np.array([np.cos(half), np.sin(half)])
        return np.asarray(value, float)

    def to_json(self) -> dict[str, Any]:
        """Return what a page reads; `at` has (entry of the module's numbers, component, offset) of each number."""
        return {
            "name": self.name,
            "kind": self.kind,
            "unit": self.unit,
            "value": list(self.value),
            "low": list(self.low),
            "high": list(self.high),
            "at": [[write.entry, write.component, write.offset] for write in self.writes],
        }


def entries_of(
    objective: Objective, numbers_of: Callable[[Objective], Any]
) -> Int[np.ndarray, " ..."]:
    """Return where the array that `numbers_of` picks of an objective lies among the numbers of its module."""
    counted = 0

    def number(leaf: Any) -> np.ndarray:
        nonlocal counted
        size = np.size(leaf)
        entries = np.arange(counted, counted + size).reshape(np.shape(leaf))
        counted += size
        return entries

    return numbers_of(jax.tree.map(number, objective))


@dataclass(frozen=True)
class PageDescent:
    """A descent for a page: a problem, where to begin, and what may be moved."""

    name: str
    about: str
    """One line for people: what is found, and when it counts as done."""
    problem: Problem
    guesses: Float[np.ndarray, "K Z"]
    """First guesses; a page descends from the one of least J."""
    movable: tuple[Movable, ...] = ()

    def moved(self, values: dict[str, Any]) -> Problem:
        """Return the problem with other values of what may be moved, by name."""
        objective = self.form.with_numbers(self.moved_numbers(values))
        return replace(self.problem, objective=objective)

    def moved_numbers(self, values: dict[str, Any]) -> Float[np.ndarray, " P"]:
        """Return the module's numbers with other values of what may be moved, by name."""
        numbers = self.numbers.copy()
        for movable in self.movable:
            value = np.atleast_1d(np.asarray(values.get(movable.name, movable.value), float))
            components = movable.components(value)
            for write in movable.writes:
                numbers[write.entry] = components[write.component] + write.offset
        return numbers

    @cached_property
    def form(self) -> ObjectiveForm:
        """The objective without its numbers."""
        problem = self.problem
        return ObjectiveForm.of(problem.objective, problem.emulator, problem.parametrisation.steps)

    @cached_property
    def numbers(self) -> Float[np.ndarray, " P"]:
        """The numbers of the objective as they are at first."""
        return self.form.numbers(self.problem.objective, as_float32(self.problem.control_scale))

    def facts(self) -> dict[str, Any]:
        """Return what a page must know, as JSON."""
        problem = self.problem
        return {
            "name": self.name,
            "about": self.about,
            "system": problem.emulator.system,
            "dt": problem.emulator.dt,
            "steps": problem.parametrisation.steps,
            "state": problem.emulator.state.size,
            "latent": latent_size(problem.emulator),
            "control": problem.emulator.control.size,
            "z": problem.parametrisation.size,
            "defect": int(np.shape(problem.defects)[1]),
            "numbers": len(self.numbers),
            "start": np.asarray(problem.start, float).tolist(),
            "guesses": np.round(self.guesses, 6).tolist(),
            "movable": [movable.to_json() for movable in self.movable],
            "settings": {"iterations": ITERATIONS, **GAUSS_NEWTON},
            "generator": f"neuroanimator {neuroanimator.__version__}",
        }


def descent_module(descent: PageDescent) -> bytes:
    """Return the module of `descent`, after holding it against the descent in Python.

    Raises ResourceError without Zig and wasmtime, UnsupportedError for an objective or an emulator there is no C for, and
    NeuroAnimatorError where the module does not compute what Python does.
    """
    runtime = import_wasmtime()
    content = wasm_module(descent_text(descent), NAME, FUNCTIONS)
    check_module(WasmModule(runtime, content, NAME), descent)
    return content


def descent_text(descent: PageDescent) -> str:
    """Return the C program of `descent`."""
    problem = descent.problem
    emulator = problem.emulator
    form = descent.form
    defect = int(np.shape(problem.defects)[1])
    definitions = descent_maps(problem, form)
    sizes = dict.fromkeys(definitions, len(descent.numbers))
    sizes |= {"controls": 0, "link": defect}
    constants = SharedConstants()
    maps = {}
    for name, definition in definitions.items():
        # So that none is called as one of the functions that call it. Those never called are not compiled.
        maps[name] = c_map(f"{NAME}_{name}", definition, sizes[name], constants, is_public=False)
    structs = {}
    for name, definition in definitions.items():
        # Of whole states, where latent ones are observed, only the start is looked at, which does not change.
        is_start = form.encoding is not None and name.startswith("state_")
        forms = ("forward",) if is_start else USED
        lengths = (definition.inputs, definition.outputs(sizes[name]), maps[name].tape)
        structs[name] = _struct(name, lengths, forms)
    latent = Input((latent_size(emulator),))
    state = Input((emulator.state.size,))
    others = [
        c_function("descent_encode", _encode, emulator, [state], constants),
        c_function("descent_decode", _decode, emulator, [latent], constants),
        c_function("descent_difference", _difference, emulator, [latent, latent], constants),
    ]
    observed = definitions["residuals"].inputs
    defines = {
        "STATE": emulator.state.size,
        "LATENT": latent_size(emulator),
        "CONTROL": emulator.control.size,
        "STEPS": problem.parametrisation.steps,
        "DEFECT": defect,
        "NUMBERS": len(descent.numbers),
        "OBSERVED": observed,
    }
    values = {
        "numbers": ", ".join(c_number(number) for number in descent.numbers.tolist()),
        "rows": "\n".join(_rows(form)),
        "terms": ", ".join(_terms(form, structs)),
        "count": str(len(form.views)),
        "looked_at": str(form.controls),
        "values": str(len(problem.objective.functions)),
        "residuals": structs["residuals"],
        "efforts": structs["efforts"],
        "controls": structs["controls"],
        "link": structs["link"],
        "link_tape": str(maps["link"].tape + 16),
    }
    calls = resources.files("neuroanimator_studio") / "descent_calls.c"
    template = calls.read_text(encoding="utf-8")
    for key, value in values.items():
        template = template.replace(f"@{key}@", value)
    data = ", ".join(c_number(number) for number in constants.data().tolist())
    return "\n".join(
        [
            descent_callers(),
            *(f"#define {name} {value}" for name, value in defines.items()),
            f"static NA_ALIGNED const float descent_k[] = {{{data}}};",
            *(one.text for one in maps.values()),
            *(one.text for one in others),
            template,
        ]
    )


def _encode(emulator: Emulator, state: Float[Array, " S"]) -> Float[Array, " I"]:
    return emulator.encode(state)


def _decode(emulator: Emulator, latent: Float[Array, " I"]) -> Float[Array, " S"]:
    return emulator.decode(latent)


def _difference(
    emulator: Emulator, predicted: Float[Array, " I"], actual: Float[Array, " I"]
) -> Float[Array, " V"]:
    return still_frame(emulator).difference(predicted, actual)


def _struct(name: str, lengths: Sequence[int], forms: Sequence[str]) -> str:
    """Return `na_map` of a map in C, with those of its `forms` that are called, and the lengths of x, y and the tape."""
    functions = [f"{NAME}_{name}_{form}" if form in forms else "0" for form in FORMS]
    numbers = "0" if name in ("controls", "link") else "descent_numbers"
    return f"{{{', '.join(['descent_k', numbers, *functions, *map(str, lengths)])}}}"


def _rows(form: ObjectiveForm) -> Iterator[str]:
    """Yield an array for each cost: the states of a motion it looks at."""
    for number, view in enumerate(form.views):
        rows = ", ".join(str(row) for row in view.rows)
        yield f"static const long descent_rows_{number}[] = {{{rows}}};"


def _terms(form: ObjectiveForm, structs: dict[str, str]) -> Iterator[str]:
    """Yield `na_term` of each cost in C."""
    for number, view in enumerate(form.views):
        of_state = structs[f"state_{number}"]
        of_latent = structs.get(f"latent_{number}", of_state)
        yield f"{{{of_latent}, {of_state}, descent_rows_{number}, {len(view.rows)}}}"


def check_module(module: WasmModule, descent: PageDescent) -> None:
    """Hold a module against the descent in Python: J, its derivatives and the motion, with numbers and starts moved.

    Raises NeuroAnimatorError where they differ.
    """
    rng = np.random.default_rng(0)
    emulator = descent.problem.emulator
    room = np.zeros(int(module.call("room") or 0), np.float32)
    start = as_float32(descent.problem.start)
    for moved in (0.0, *MOVED):
        values = {}
        for movable in descent.movable:
            share = moved * rng.uniform(size=len(movable.value))
            values[movable.name] = movable.value + share * (np.array(movable.high) - movable.value)
        numbers = descent.moved_numbers(values)
        evaluator = evaluator_of(descent.moved(values)).at(start)
        module.write("numbers", numbers)
        module.write("defects", as_float32(descent.problem.defects))
        module.call("begin_at", start, room)
        for guess in descent.guesses:
            z = as_float32(guess + NEARBY * rng.normal(size=guess.shape))
            states, controls = _check_at(module, emulator, evaluator, z, room)
            _check_defects(module, emulator, states, controls)
            # The next ones begin where this one ended.
            start = as_float32(states[-1])


def _check_at(
    module: WasmModule,
    emulator: Emulator,
    evaluator: Evaluator,
    z: Float[np.ndarray, " Z"],
    room: Float[np.ndarray, " N"],
) -> tuple[Float[np.ndarray, "T1 S"], Float[np.ndarray, "T C"]]:
    """Compare everything at `z`; return the motion there, as (states, controls)."""
    zs = z * np.linspace(1.0, 0.5, COSTS)[:, None].astype(np.float32)
    costs = np.zeros(COSTS)
    module.call("costs", zs, COSTS, costs, room)
    _compare("J", costs, evaluator.costs(zs))
    slope = np.zeros_like(z)
    curvature = np.zeros((len(z), len(z)), np.float32)
    cost = module.call("quadratic_model", z, curvature, slope, room)
    model, nearby = evaluator.quadratic_models(np.stack([z, rounded(z[None])[0]]))
    _compare("J", np.array([cost]), np.array([model.cost]))
    _compare("the curvature of J", curvature, model.curvature, nearby.curvature)
    _compare("the slope of J", slope, model.slope, nearby.slope)
    motion = evaluator.motion(z)
    controls = np.zeros(motion.controls.shape, np.float32)
    latents = np.zeros((len(motion.states), latent_size(emulator)), np.float32)
    states = np.zeros(motion.states.shape, np.float32)
    module.call("motion", z, controls, latents, states, room)
    _compare("controls", controls, motion.controls)
    _compare("states", states, motion.states)
    return motion.states, motion.controls


def _check_defects(
    module: WasmModule,
    emulator: Emulator,
    states: Float[np.ndarray, "T1 S"],
    controls: Float[np.ndarray, "T C"],
) -> None:
    """Compare the defects along a motion that is nearly this one."""
    noise = np.random.default_rng(1).normal(size=states.shape)
    states = as_float32(states + DEFECTIVE * noise)
    controls = as_float32(controls)
    expected = find_defects(emulator, states, controls)
    defects = np.zeros(expected.shape, np.float32)
    module.call("defects_of", states, controls, defects)
    _compare("defects", defects, expected)


def _compare(
    name: str,
    found: np.ndarray,
    expected: np.ndarray | Array,
    otherwise: np.ndarray | Array | None = None,
) -> None:
    """Raise NeuroAnimatorError unless these are alike, `otherwise` being what rounding alone makes of what is expected."""
    size = float(np.abs(expected).max(initial=1e-6))
    off = np.abs(found - np.asarray(expected)).max(initial=0)
    doubt = 0.0 if otherwise is None else np.abs(np.asarray(otherwise) - expected).max(initial=0)
    if not off <= TOLERANCE * size + DOUBTS * doubt:
        raise NeuroAnimatorError(
            f"A descent in WebAssembly has other numbers than in Python: {name}, by {off:.2g} of {size:.2g}. "
            "Nothing was written. Please report it."
        )
