"""Shapes checked at run time: in the tests, every call of the package is held against its annotations.

`jaxtyping` gives every function of `neuroanimator` the decorator `checked`; `conftest.py` asks for it before
anything of the package is imported.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import update_wrapper, wraps
from types import CodeType, FunctionType
from typing import Any, ForwardRef, get_args, get_origin

import jaxtyping
from beartype import BeartypeConf, FrozenDict, beartype
from beartype.door import die_if_unbearable
from jaxtyping import install_import_hook, jaxtyped
from numpy.typing import ArrayLike

NESTED = [part for part in get_args(ArrayLike) if "NestedSequence" in str(get_origin(part))]
"""What NumPy calls a list of lists in `ArrayLike`, a protocol that a tuple does not fulfil at run time."""

ANYTHING = NESTED or [ArrayLike]
"""Hints that anything fulfils; since NumPy 2.5 `ArrayLike` is a name of its own, and no longer its parts."""

RULES = BeartypeConf(
    is_pep484_tower=True,
    violation_type=TypeError,
    hint_overrides=FrozenDict(dict.fromkeys(ANYTHING, object)),
)
"""A whole number may stand where a `float` is asked for, and anything where an `ArrayLike` is: what users give
is checked by the function itself, whose message they read. A violation is a TypeError, which readers of strangers' files
expect of a number in the place of a name."""


def guarded(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function`, held against its annotations."""
    return beartype(conf=RULES)(function)


@dataclass
class Checks:
    """What is known of the functions that are made of one piece of code: of one, or of what another makes in every call."""

    names_axes: bool = True
    """Whether its annotations name axes of arrays."""
    fitting: dict[Hashable, set[Hashable]] = field(default_factory=dict)
    """Kinds of results that fit, by the kinds of arguments with which they came."""


CHECKS: dict[tuple[str, str, CodeType], Checks] = {}
"""Those of the package's own functions. What jaxtyping makes for a dataclass is all of one code, with other annotations."""


def checked(function: Any) -> Callable[..., Any]:
    """Return `function`, checking what it is given and what it returns.

    What jaxtyping makes of a function binds every call's arguments by name and checks them twice, for a better
    message; a quarter of the tests' time went there. Only axes computed from arguments, such as "{rows}", need it.
    A scope of their own is needed by names of axes alone: most functions have none, and those are called most.

    Whether a call fits depends on the `kind_of` what it is given and returns: of calls that are alike in that, one is
    checked. Checking all of them took a third of the tests' time.
    """
    if any("{" in str(annotation) for annotation in function.__annotations__.values()):
        return jaxtyped(typechecker=guarded)(function)
    checks = Checks()
    if all(isinstance(annotation, str) for annotation in function.__annotations__.values()):
        source = (function.__module__, function.__qualname__, function.__code__)
        checks = CHECKS.setdefault(source, checks)
    quick: Callable[..., Any] | None = None

    @wraps(function)
    def in_its_own_scope(*arguments: Any, **named: Any) -> Any:
        nonlocal quick
        if quick is not None and not checks.names_axes:
            return quick(*arguments, **named)
        given = (kind_of_parts(arguments), kind_of_pairs(named) if named else None)
        results = checks.fitting.get(given)
        if results is not None:
            result = function(*arguments, **named)
            kind = kind_of(result)
            if kind not in results:
                check_result(with_known_annotations(function), arguments, named, result)
                results.add(kind)
            return result
        if quick is None:  # made when it is called first: of what a process imports it calls a part
            known = with_known_annotations(function)
            checks.names_axes = any(map(has_axes, known.__annotations__.values()))
            quick = guarded(known)
        with jaxtyped("context"):  # where names of axes begin anew
            result = quick(*arguments, **named)
        if len(checks.fitting) > MAX_KINDS:
            checks.fitting.clear()
        checks.fitting[given] = {kind_of(result)}
        return result

    return in_its_own_scope


MAX_KINDS = 500
"""Maximum number of kinds of arguments of a function that are remembered."""

MAX_LETTERS = 40
"""Maximum length of a text that an annotation may ask for to the letter, as `Literal` does."""

MAX_PARTS = 64
"""Maximum number of parts of a collection that are looked at one by one; of longer ones the first."""


def kind_of(value: Any) -> Hashable:
    """Return all of `value` that an annotation may speak of: its type, of arrays and collections more than that."""
    kind = type(value)
    reader = READERS.get(kind)
    if reader is None:
        reader = READERS[kind] = reader_for(value)
    return reader(value)


def reader_for(value: Any) -> Callable[[Any], Hashable]:
    """Return what tells the kinds of values of its type, of which `value` is the first to come."""
    if isinstance(value, type):
        return with_type
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return kind_of_array
    return type


def with_type(value: Any) -> Hashable:
    return type(value), value


def kind_of_array(value: Any) -> Hashable:
    return type(value), value.shape, value.dtype


def kind_of_text(value: str) -> Hashable:
    return value if len(value) <= MAX_LETTERS else str


def kind_of_parts(value: tuple[Any, ...] | list[Any]) -> Hashable:
    return type(value), *map(kind_of, value if len(value) <= MAX_PARTS else value[:1])


def kind_of_pairs(value: dict[Any, Any]) -> Hashable:
    return dict, kind_of_parts(list(value.items()))


READERS: dict[type, Callable[[Any], Hashable]] = {
    int: with_type,
    str: kind_of_text,
    tuple: kind_of_parts,
    list: kind_of_parts,
    dict: kind_of_pairs,
}
"""What tells the kinds of values, by their type."""


def check_result(
    known: Any, arguments: tuple[Any, ...], named: dict[str, Any], result: Any
) -> None:
    """Raise TypeError if a function with `known` annotations may not return `result` where it is given these arguments."""
    given = inspect.signature(known).bind(*arguments, **named).arguments
    hints = known.__annotations__
    with jaxtyped("context"):
        for name, value in given.items():
            if name in hints and has_axes(hints[name]):
                die_if_unbearable(value, hints[name], conf=RULES)
        hint = hints.get("return", object)
        die_if_unbearable(result, hint, conf=RULES, exception_prefix=f"{known.__qualname__}: ")


def has_axes(annotation: Any) -> bool:
    """Return whether something in a type may be an array with named axes: one of jaxtyping's types, or a text."""
    if isinstance(annotation, str | ForwardRef):
        return True
    if isinstance(annotation, list):  # what a function takes
        return any(has_axes(part) for part in annotation)
    if type(annotation).__module__.startswith("jaxtyping"):
        return True
    return any(has_axes(part) for part in get_args(annotation))


def with_known_annotations(function: FunctionType) -> Any:
    """Return `function` without the annotations whose names are not there yet, or only for type checkers."""
    same: Any = FunctionType(
        function.__code__,
        function.__globals__,
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    update_wrapper(same, function)
    del same.__wrapped__
    same.__kwdefaults__ = function.__kwdefaults__
    same.__annotations__ = {}
    for name, annotation in function.__annotations__.items():
        known = annotation
        if isinstance(annotation, str):
            try:
                known = eval(annotation, function.__globals__)
            except NameError:
                continue
        same.__annotations__[name] = known
    return same


def decorated(*, typechecker: object) -> Callable[[Any], Any]:
    """Return the decorator the import hook gives everything: classes get jaxtyping's own, functions `checked`."""

    def decorate(thing: Any) -> Any:
        if inspect.isfunction(thing):
            return checked(thing)
        return jaxtyped(typechecker=typechecker)(thing)

    return decorate


def unchecked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function` as users have it, for tests of what it says to those who give it something else."""
    return inspect.unwrap(function)


def check_shapes() -> None:
    """Check every function of the package that is imported from now on."""
    jaxtyping.jaxtyped = decorated
    install_import_hook(["neuroanimator", "neuroanimator_studio"], "shapes.checked")
