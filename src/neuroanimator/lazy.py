"""Names of a package that are imported on first use, so that `neuroanimator --help` does not wait for JAX and MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(
    package: str, homes: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the `__getattr__` and the `__dir__` of a package whose names live in modules of it.

    `homes` says in which module, relative to `package`, each name is.
    """

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"{package} has no '{name}'")
        return getattr(import_module(f"{package}.{homes[name]}"), name)

    def list_names() -> list[str]:
        return sorted(homes)

    return load, list_names
