"""Functions (numbers, x) → y in C in every form a descent needs: forward, backward, along tangents, in sixteen lanes.

`map.c` is the counterpart for C code that calls them.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import resources
from typing import Any, NamedTuple

import jax
import jax.extend.core as jaxprs
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.codegen.c_function import CFunction, LatePart, c_function, prelude
from neuroanimator.codegen.compiler import compiled_library
from neuroanimator.codegen.jax_settings import compiled_quickly
from neuroanimator.codegen.kept import (
    FLAGS,
    CProgram,
    LoadedProgram,
    WrongProgramError,
    address,
    declared,
)
from neuroanimator.codegen.program import WIDTH, Constants, aligned_zeros
from neuroanimator.codegen.trace import Input, constant_array
from neuroanimator.files.atomic import digest

TOLERANCE = 1e-3
"""Tolerance of numbers, relative to the largest of their array: C and JAX sum float32 in different orders."""


Lanes = Float[np.ndarray, "_ 16"]


class MapDefinition(NamedTuple):
    """A map in JAX."""

    function: Callable[..., Array]
    """(module, numbers (P,), x (X,)) → y (Y,)"""
    module: Any
    """Any pytree; its arrays are constants of the program."""
    inputs: int
    """Length of x."""

    def with_numbers(self, numbers: Float[np.ndarray, " P"]) -> Callable[[Array], Array]:
        """Return x → y."""
        return partial(self.function, self.module, jax.device_put(numbers))

    def outputs(self, numbers: int) -> int:
        """Return the length of y, given the count of `numbers`."""
        arrays = [jax.ShapeDtypeStruct((size,), np.float32) for size in (numbers, self.inputs)]
        (size,) = jax.eval_shape(self.function, self.module, *arrays).shape
        return size


def facts_of(module: Any) -> list[str]:
    """Return the facts that identify a module whose arrays are constants of a program: its structure and its numbers."""
    numbers = {str(number): np.asarray(leaf) for number, leaf in enumerate(jax.tree.leaves(module))}
    return [str(jax.tree.structure(module)), digest(numbers)]


def facts_computed(definition: MapDefinition, numbers: int) -> list[str]:
    """Return the traced operations and constant arrays of a map of `numbers` numbers and its derivatives.

    For functions from outside the package, whose names say nothing about what they compute.
    """
    function, module, inputs = definition

    def with_derivatives(numbers: Array, x: Array, of_y: Array) -> Any:
        # Traced too: custom derivative rules do not show in the operations of y.
        y, pull = jax.vjp(partial(function, module, numbers), x)
        return y, *pull(of_y)

    sizes = (numbers, inputs, definition.outputs(numbers))
    traced = jax.make_jaxpr(with_derivatives)(
        *(jax.ShapeDtypeStruct((size,), np.float32) for size in sizes)
    )
    arrays = {str(number): array for number, array in enumerate(_arrays_of(traced))}
    return [str(traced), digest(arrays)]


def _arrays_of(traced: Any) -> Iterator[np.ndarray]:
    """Yield the constant arrays of a traced function and of those nested in it."""
    if isinstance(traced, jaxprs.ClosedJaxpr):
        yield from map(constant_array, traced.consts)
        traced = traced.jaxpr
    for eqn in traced.eqns:
        for atom in eqn.invars:
            if isinstance(atom, jaxprs.Literal):
                yield np.asarray(atom.val)
        for parameter in eqn.params.values():
            several = parameter if isinstance(parameter, tuple | list) else (parameter,)
            for nested in several:
                if isinstance(nested, jaxprs.ClosedJaxpr | jaxprs.Jaxpr):
                    yield from _arrays_of(nested)


def c_map(
    name: str,
    definition: MapDefinition,
    numbers: int,
    constants: Constants,
    is_public: bool = True,
) -> CFunction:
    """Return C text of a map with `numbers` numbers; if `is_public`, its functions can be called from outside the program.

    - `name_forward(k, numbers, x, t, tv, y)` writes the tape `t` for the next three,
    - `name_backward(k, t, tv, cotangents of y, cotangents of x)` has sixteen lanes of cotangents,
    - `name_push(k, t, tv, tangents of x, tangents of y)` has sixteen lanes of tangents,
    - `name_slope(k, t, tv, one cotangent of y, one of x)` has no lanes,
    - `name_lanes(k, numbers, x, y)` has sixteen x and y.

    Raises UnsupportedError for operations without C.
    """
    function, module, inputs = definition
    outputs = definition.outputs(numbers)

    def in_every_way(
        module: Any, numbers: Array, x: Array, of_y: Array, tangent: Array, one_of_y: Array
    ) -> Any:
        # Not with jvp and vjp, each of which would compute y again.
        y, push = jax.linearize(partial(function, module, numbers), x)
        pull = jax.linear_transpose(push, x)
        return y, *pull(of_y), push(tangent), *pull(one_of_y)

    arguments = [
        Input((numbers,)),
        Input((inputs,)),
        Input((outputs,), is_wide=True, is_late=True),
        Input((inputs,), is_wide=True, is_late=True),
        Input((outputs,), is_late=True),
    ]
    late = [LatePart("backward", 1, 1), LatePart("push", 1, 1), LatePart("slope", 1, 1)]
    differentiated = c_function(
        name, in_every_way, module, arguments, constants, late=late, is_public=is_public
    )
    wide = [Input((numbers,)), Input((inputs,), is_wide=True)]
    in_lanes = c_function(f"{name}_lanes", function, module, wide, constants, is_public=is_public)
    return CFunction(differentiated.text + in_lanes.text, tape=differentiated.tape)


def program_of_maps(definitions: dict[str, MapDefinition], numbers: int) -> CProgram:
    """Return the program of maps by name, all with the same count of `numbers`; its sizes are those a `CMap` needs."""
    constants = Constants()
    texts = [prelude()]
    sizes = {}
    for name, definition in definitions.items():
        written = c_map(name, definition, numbers, constants)
        texts.append(written.text)
        sizes[f"{name} inputs"] = definition.inputs
        sizes[f"{name} outputs"] = definition.outputs(numbers)
        sizes[f"{name} tape"] = written.tape
    return CProgram("\n".join(texts), constants.data(), sizes)


def callers(*files: tuple[str, str]) -> str:
    """Return the text of a C program that calls maps: the prelude, `map.c` and `files`, each a package and a name in it."""
    pieces = [prelude()]
    for package, name in [("neuroanimator.codegen", "map.c"), *files]:
        pieces.append((resources.files(package) / name).read_text(encoding="utf-8"))
    return "\n".join(pieces)


def compiled_callers(
    files: Sequence[tuple[str, str]], functions: dict[str, tuple[int, Any]]
) -> ctypes.CDLL | None:
    """Return the library of `callers`; None if nothing can be compiled.

    `functions` are the number of parameters and the result of each of its functions.
    """
    library = compiled_library(callers(*files), FLAGS)
    if library is not None:
        for name, declaration in functions.items():
            declared(library, name, *declaration)
    return library


FORMS = {"forward": 6, "backward": 5, "push": 5, "slope": 5, "lanes": 4}
"""Number of parameters of each form of a map, in the order of `na_map`."""


def c_struct(*members: ArrayLike) -> np.ndarray:
    """Return a struct of C whose members are addresses, counts and other such structs."""
    # Addresses and counts are of one length.
    return np.concatenate([np.atleast_1d(member) for member in members], dtype=np.intp)


@dataclass(frozen=True, eq=False)
class CMap:
    """One map of a loaded program with its numbers. Arrays are float32 in C's order, lanes last; threads may share it."""

    program: LoadedProgram
    name: str
    numbers: Float[np.ndarray, " P"]

    def size(self, what: str) -> int:
        """Return the length of x ("inputs") or of y ("outputs"), or the floats on the "tape" that derivatives need."""
        return self.program.sizes[f"{self.name} {what}"]

    def forward(
        self, x: Float[np.ndarray, " X"]
    ) -> tuple[Float[np.ndarray, " Y"], Float[np.ndarray, " T"]]:
        """Return (y, the tape that the derivatives need)."""
        tape = aligned_zeros(self.size("tape") + WIDTH)
        y = np.empty(self.size("outputs"), np.float32)
        return self._call("forward", y, self.numbers, x, tape, NOTHING), tape

    def backward(self, tape: Float[np.ndarray, " T"], of_y: Lanes) -> Lanes:
        """Return the cotangents of x for sixteen cotangents of y."""
        return self._call("backward", lanes(self.size("inputs")), tape, NOTHING, of_y)

    def slope(
        self, tape: Float[np.ndarray, " T"], of_y: Float[np.ndarray, " Y"]
    ) -> Float[np.ndarray, " X"]:
        """Return the cotangent of x for one cotangent of y."""
        of_x = np.empty(self.size("inputs"), np.float32)
        return self._call("slope", of_x, tape, NOTHING, of_y)

    def push(self, tape: Float[np.ndarray, " T"], tangents: Lanes) -> Lanes:
        """Return the tangents of y for sixteen tangents of x."""
        return self._call("push", lanes(self.size("outputs")), tape, NOTHING, tangents)

    def of_rows(self, xs: Float[np.ndarray, "N X"]) -> Float[np.ndarray, "N Y"]:
        """Return y for each x, sixteen at a time."""
        ys = np.empty((len(xs), self.size("outputs")), np.float32)
        for first in range(0, len(xs), WIDTH):
            some = xs[first : first + WIDTH]
            wide = lanes(self.size("inputs"))
            wide[:, : len(some)] = some.T
            of_wide = self._call("lanes", lanes(self.size("outputs")), self.numbers, wide)
            ys[first : first + WIDTH] = of_wide[:, : len(some)].T
        return ys

    def struct(self) -> np.ndarray:
        """Return `na_map` of `map.c`; it points into this map, which must outlive it."""
        functions = []
        for form in FORMS:
            functions.append(ctypes.cast(self._function(form), ctypes.c_void_p).value or 0)
        sizes = [self.size(what) for what in ("inputs", "outputs", "tape")]
        return c_struct(address(self.program.constants), address(self.numbers), functions, sizes)

    def check(self, reference: MapReference) -> None:
        """Raise WrongProgramError unless y and the cotangents of x at the points of `reference` are JAX's.

        Tangents are checked against the cotangents, as push is the transpose of backward, and lanes against the values.
        """
        tangents = random_lanes(np.random.default_rng(0), self.size("inputs"))
        of_y = reference.of_y
        one_of_y = np.ascontiguousarray(of_y[:, 0])
        rows = zip(reference.points, reference.values, reference.pulled, strict=True)
        for point, value, expected in rows:
            y, tape = self.forward(point)
            of_x = self.backward(tape, of_y)
            self._compare(y, value)
            self._compare(of_x, expected)
            self._compare(self.slope(tape, one_of_y), of_x[:, 0])
            pushed = self.push(tape, tangents)
            self._compare(_products(of_y, pushed), _products(of_x, tangents))
        self._compare(self.of_rows(reference.points), reference.values)

    def _compare(self, found: np.ndarray, expected: np.ndarray) -> None:
        size = float(np.abs(expected).max(initial=1e-6))
        off = np.abs(found - expected).max(initial=0)
        if not off <= TOLERANCE * size:
            raise WrongProgramError(
                f"Generated C disagrees with JAX on '{self.name}', or on its derivatives."
            )

    def _function(self, form: str) -> Any:
        return declared(self.program.library, f"{self.name}_{form}", FORMS[form])

    def _call(self, form: str, result: np.ndarray, *arrays: np.ndarray) -> np.ndarray:
        """Return `result`, filled by a form of the map."""
        self._function(form)(*map(address, (self.program.constants, *arrays, result)))
        return result


@dataclass(frozen=True, eq=False)
class MapReference:
    """Values and cotangents of a map at some points, as JAX computes them."""

    points: Float[np.ndarray, "N X"]
    of_y: Lanes
    """Sixteen cotangents of y."""
    values: Float[np.ndarray, "N Y"]
    """y at each point."""
    pulled: Float[np.ndarray, "N X 16"]
    """Cotangents of x at each point."""


def map_references(
    functions: Sequence[Callable[[Array], Array]], points: Sequence[Float[np.ndarray, "N _"]]
) -> list[MapReference]:
    """Return the references of maps that are `functions` of x, each at its `points`; one JAX program computes all."""
    rng = np.random.default_rng(0)
    cotangents = []
    for function, some in zip(functions, points, strict=True):
        (outputs,) = jax.eval_shape(function, some[0]).shape
        cotangents.append(random_lanes(rng, outputs))

    def compute(points: list[Array], cotangents: list[Array]) -> list[tuple[Array, Array]]:
        cases = zip(functions, points, cotangents, strict=True)
        return [_values_and_pulled(*case) for case in cases]

    computed = compiled_quickly(compute)(points, cotangents)
    references = []
    for some, of_y, (values, pulled) in zip(points, cotangents, computed, strict=True):
        references.append(MapReference(some, of_y, np.asarray(values), np.asarray(pulled)))
    return references


def _values_and_pulled(
    function: Callable[[Array], Array], points: Float[Array, "N X"], of_y: Float[Array, "Y 16"]
) -> tuple[Float[Array, "N Y"], Float[Array, "N X 16"]]:
    # Each point is repeated sixteen times, so that JAX transforms the function once: forward is cheap, tracing is not.
    count, size = points.shape
    values, pull = jax.vjp(jax.vmap(function), jnp.repeat(points, WIDTH, axis=0))
    (pulled,) = pull(jnp.tile(of_y.T, (count, 1)))
    return values[::WIDTH], pulled.reshape(count, WIDTH, size).transpose(0, 2, 1)


def _products(left: Lanes, right: Lanes) -> Float[np.ndarray, "16 16"]:
    """Return the scalar product of each lane of `left` with each lane of `right`."""
    return left.T.astype(float) @ right


def lanes(count: int) -> Lanes:
    """Return zeros with sixteen lanes."""
    return aligned_zeros(count * WIDTH).reshape(count, WIDTH)


def random_lanes(rng: np.random.Generator, count: int) -> Lanes:
    """Return random numbers with sixteen lanes."""
    result = lanes(count)
    result[:] = rng.normal(size=result.shape)
    return result


NOTHING = aligned_zeros(WIDTH)
"""Stand-in for an absent tape of lanes."""


class Caller:
    """Functions of C that call maps, with a struct of these, and with working memory of their own; threads may share it."""

    def __init__(self, library: ctypes.CDLL, struct: np.ndarray, room: str):
        """`room` is the function that tells how many floats of working memory the others take with `struct`."""
        self._library = library
        self._struct = struct
        self._address = address(struct)
        self._size = getattr(library, room)(self._address)
        self._free: list[Float[np.ndarray, " N"]] = []

    def __call__(self, name: str, *arguments: np.ndarray | int) -> Any:
        """Return what a function returns of arrays in C's order and counts; it writes into arrays, too."""
        numbers = [some if isinstance(some, int) else address(some) for some in arguments]
        try:
            workspace = self._free.pop()
        except IndexError:
            workspace = aligned_zeros(self._size)
        try:
            return getattr(self._library, name)(self._address, *numbers, address(workspace))
        finally:
            self._free.append(workspace)
