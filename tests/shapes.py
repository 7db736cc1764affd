"""Shapes checked at run time: in the tests, every call of the package is held against its annotations.

`jaxtyping` gives every function of `neuroanimator` the decorator `checked`; `conftest.py` asks for it before
anything of the package is imported.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import update_wrapper, wraps
from types import FunctionType
from typing import Any, ForwardRef, get_args, get_origin

import jaxtyping
from beartype import BeartypeConf, FrozenDict, beartype
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


def checked(function: Any) -> Callable[..., Any]:
    """Return `function`, checking what it is given and what it returns.

    What jaxtyping makes of a function binds every call's arguments by name and checks them twice, for a better
    message; a quarter of the tests' time went there. Only axes computed from arguments, such as "{rows}", need it.
    A scope of their own is needed by names of axes alone: most functions have none, and those are called most.
    """
    if any("{" in str(annotation) for annotation in function.__annotations__.values()):
        return jaxtyped(typechecker=guarded)(function)
    known = with_known_annotations(function)
    quick: Callable[..., Any] | None = None
    names_axes = True

    @wraps(function)
    def in_its_own_scope(*arguments: Any, **named: Any) -> Any:
        nonlocal quick, names_axes
        if quick is None:  # made when it is called first: of what a process imports it calls a part
            names_axes = any(has_axes(annotation) for annotation in known.__annotations__.values())
            quick = guarded(known)
        if not names_axes:
            return quick(*arguments, **named)
        with jaxtyped("context"):  # where names of axes begin anew
            return quick(*arguments, **named)

    return in_its_own_scope


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
