"""Names of a package, imported on first use, so that `neuroanimator --help` does not wait for JAX and MuJoCo."""

from __future__ import annotations

import ast
import inspect
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, wraps
from importlib import import_module, resources
from types import FunctionType, UnionType
from typing import Any, get_args, get_origin

from neuroanimator.errors import ArgumentError
from neuroanimator.text import quoted

EVERYTHING = "*"
"""Stands for all names of a module that are in its `__all__`."""

LOADERS = {
    "Dataset": "open_transitions",
    "Emulator": "load_emulator",
    "Policy": "load_policy",
    "System": "load_system",
    "Transitions": "read_transitions",
}
"""Public functions that load an object by its name or its file, by its class."""

MAKERS = {
    **LOADERS,
    "Clip": "make_clip",
    "Evaluation": "evaluate",
    "Inspection": "inspect",
    "Objective": "Objective.of",
    "Replay": "replay",
    "Structure": "load_system",
    "Synthesis": "synthesise",
}
"""What makes an object, for errors, by its class."""

MOVED = {
    "options=na.SearchOptions({}=...)": "corrections is_enough measures_trust refinements restarts",
    "options=na.SearchOptions(refine=na.Refinement({}=...))": "data minutes on_refine",
    "the system, with its goals, as the second argument": "goals_from",
}
"""What to write now instead of arguments that searches had until 0.3, by their keywords."""


def lazy_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the `__getattr__` and the `__dir__` of a package whose names are defined in its modules.

    Its `__init__.pyi` imports them, for type checkers.
    """

    def load(name: str) -> Any:
        if name == "__all__":
            return list_names()
        home = None
        if not name.startswith("_"):
            home = _imports(package).get(name) or _homes(package).get(name)
        if home is None:
            raise AttributeError(f"{package} has no '{name}'")
        thing = getattr(import_module(home), name)
        return at_border(package, thing) if isinstance(thing, FunctionType) else thing

    def list_names() -> list[str]:
        return sorted(_homes(package))

    return load, list_names


@cache
def _imports(package: str) -> dict[str, str]:
    """Return the module of each name imported in the stub of a package."""
    stub = (resources.files(package) / "__init__.pyi").read_text(encoding="utf-8")
    found = {}
    for node in ast.parse(stub).body:
        if isinstance(node, ast.ImportFrom):
            found |= {alias.name: str(node.module) for alias in node.names}
    return found


@cache
def _homes(package: str) -> dict[str, str]:
    """Return the module of each name, without importing anything."""
    found = dict(_imports(package))
    generous = found.pop(EVERYTHING, None)
    if generous is not None:
        found |= dict.fromkeys(_all_of(generous), generous)
    return found


def _all_of(module: str) -> list[str]:
    """Return the `__all__` of a module, from its source."""
    package, _, name = module.rpartition(".")
    source = (resources.files(package) / f"{name}.py").read_text(encoding="utf-8")
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return ast.literal_eval(node.value)
    raise AssertionError(f"{module} has no __all__")


@cache
def at_border(package: str, function: FunctionType) -> Callable[..., Any]:
    """Return a function of `package` such that it takes names for objects, and refuses other kinds at once.

    A name or a file stands for what one of `LOADERS` makes of it, cost terms for the objective of them, and options of descents
    for those of a search, which is handed what refines. Whatever else is no object of the annotated class is refused by an
    ArgumentError.
    """
    written = inspect.unwrap(function)
    wanted = _wanted_classes(written)
    if not wanted:
        return function

    is_search = "SearchOptions" in [kind.__name__ for kind in wanted.get("options", ())]

    def taken(parameter: str, value: Any) -> Any:
        if parameter not in wanted or _is_any_of(value, wanted[parameter]):
            return value
        return _made(parameter, value, wanted[parameter])

    @wraps(function)
    def checked(*arguments: Any, **named: Any) -> Any:
        if is_search:
            named["options"] = _search_options(named)
        given = zip(written.__code__.co_varnames, arguments, strict=False)
        return function(
            *(taken(parameter, value) for parameter, value in given),
            **{parameter: taken(parameter, value) for parameter, value in named.items()},
        )

    # Processes that are sent the function find it by its public name.
    checked.__module__ = package
    checked.__qualname__ = function.__name__
    return checked


def _search_options(named: dict[str, Any]) -> Any:
    """Return the options among the arguments of a search such that it refines: what trains is no part of the search itself."""
    for place, keywords in MOVED.items():
        for keyword in named.keys() & keywords.split():
            raise ArgumentError(f"{keyword}: write {place.format(keyword)}.")
    public = import_module("neuroanimator")
    options = named.get("options", public.SearchOptions())
    if isinstance(options, public.DescentOptions):
        options = public.SearchOptions(options)
    if getattr(options, "refine", options) is None:
        options = replace(options, refine=public.Refinement())
    return options


def _wanted_classes(function: Any) -> dict[str, tuple[type, ...]]:
    """Return the classes of the objects that a function takes, by parameter; none where it also takes what has no class."""
    wanted = {}
    for parameter, annotation in function.__annotations__.items():
        # What is imported for type checkers alone is not there.
        with suppress(NameError):
            classes = _classes_of(eval(annotation, function.__globals__))
            if any(_is_ours(kind) for kind in classes):
                wanted[parameter] = classes
    wanted.pop("return", None)
    return wanted


def _classes_of(annotation: Any) -> tuple[type, ...]:
    parts = get_args(annotation) if isinstance(annotation, UnionType) else (annotation,)
    classes: list[type] = []
    for part in parts:
        items = get_args(part) if get_origin(part) is Sequence else (part,)
        classes += items
    is_plain = all(isinstance(kind, type) and get_origin(kind) is None for kind in classes)
    return tuple(classes) if is_plain else ()


def _is_ours(kind: type) -> bool:
    return kind.__module__.startswith("neuroanimator.")


def _is_any_of(value: Any, classes: tuple[type, ...]) -> bool:
    """Return whether `value`, or all that is in it, is of one of the classes."""
    if isinstance(value, classes):
        return True
    is_row = isinstance(value, Sequence) and not isinstance(value, str)
    return is_row and all(isinstance(item, classes) for item in value)


def _made(parameter: str, value: Any, classes: tuple[type, ...]) -> Any:
    """Return what a name loads, or the objective of cost terms; ArgumentError for anything else."""
    kind: Any = next(kind for kind in classes if _is_ours(kind))
    name = kind.__name__
    public = import_module("neuroanimator")
    is_name = isinstance(value, (str, os.PathLike))
    if is_name and name in LOADERS:
        return getattr(public, LOADERS[name])(str(value))
    if name == "Objective" and _is_any_of(value, (public.CostTerm,)):
        return kind.of(*(value if isinstance(value, Sequence) else (value,)))
    made = f", as {MAKERS[name]} returns" if name in MAKERS else ""
    got = f"the text {quoted(value)}" if is_name else type(value).__name__
    raise ArgumentError(f"{parameter}: wanted {name}{made}, got {got}.")
