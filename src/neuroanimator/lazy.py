"""Names of a package, imported on first use, so that `neuroanimator --help` does not wait for JAX and MuJoCo."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import cache
from importlib import import_module, resources
from typing import Any

EVERYTHING = "*"
"""Stands for all names of a module that are in its `__all__`."""


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
        return getattr(import_module(home), name)

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
