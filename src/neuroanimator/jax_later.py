"""JAX, imported when something of it is first asked for.

Half a second and more goes into importing JAX and equinox. Whoever uses an emulator whose programs are compiled needs
neither; modules that define things in JAX take `jax`, `jnp` and `eqx` from here, and cost nothing until they are asked.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from functools import cache, wraps
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar, cast

JAX = "jax"
"""What the package is called."""


def is_imported() -> bool:
    """Return whether anybody has imported JAX: if not, nothing can be an array of it."""
    return sys.modules.get(JAX) is not None


class _Later(ModuleType):
    """Stands for a module, which is imported when a name of it is first asked for."""

    def __getattr__(self, name: str) -> Any:
        value = getattr(import_module(self.__name__), name)
        setattr(self, name, value)
        return value


if TYPE_CHECKING:
    from importlib.abc import Loader

    import equinox as eqx
    import jax
    import jax.extend.core as jaxprs
    import jax.numpy as jnp
    from jaxtyping import Array, PRNGKeyArray
else:
    eqx = _Later("equinox")
    jax = _Later(JAX)
    jaxprs = _Later("jax.extend.core")
    jnp = _Later("jax.numpy")
    Array = Any
    PRNGKeyArray = Any
    if is_imported():  # as in the tests, which hold every call against its annotations
        from jaxtyping import Array, PRNGKeyArray

__all__ = [
    "Array",
    "PRNGKeyArray",
    "eqx",
    "filter_jit",
    "import_within",
    "is_imported",
    "is_jax_array",
    "is_traced_array",
    "jax",
    "jaxprs",
    "jnp",
    "when_imported",
]

Function = TypeVar("Function", bound=Callable[..., Any])


def filter_jit(function: Function) -> Function:
    """Return `function` as `equinox.filter_jit` makes it, which is asked when it is first called."""

    @cache
    def compiled() -> Callable[..., Any]:
        return eqx.filter_jit(function)

    @wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        return compiled()(*arguments, **named)

    return call  # pyright: ignore[reportReturnType]


def is_jax_array(thing: object) -> bool:
    """Return whether `thing` is an array of JAX, traced ones included."""
    return is_imported() and isinstance(thing, jax.Array)


def is_traced_array(thing: object) -> bool:
    """Return whether `thing` is an array that JAX is transforming: its numbers are not known."""
    return is_imported() and isinstance(thing, jax.core.Tracer)


def when_imported(action: Callable[[], object]) -> None:
    """Do `action` as soon as anybody imports JAX; at once if that has happened."""
    if is_imported():
        action()
        return
    _listen()
    if action not in _actions:
        _actions.append(action)


def import_within(context: Callable[[], AbstractContextManager[object]]) -> None:
    """Let JAX be imported within `context`, by whomever."""
    _listen()
    _contexts.append(context)


_actions: list[Callable[[], object]] = []
_contexts: list[Callable[[], AbstractContextManager[object]]] = []


# Both keep to the protocols of `importlib.abc` without deriving from its classes, which take long to import.


class _Finder:
    """Finds JAX as the other finders do, and hears when it is imported."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != JAX:
            return None
        for finder in sys.meta_path:
            if finder is self:
                continue
            spec = finder.find_spec(fullname, path, target)
            if spec is not None and spec.loader is not None:
                spec.loader = cast("Loader", _HeardLoader(spec.loader))
            if spec is not None:
                return spec
        return None


class _HeardLoader:
    """Loads JAX as `loader` does, within the contexts asked for, and does then what waits for it."""

    def __init__(self, loader: Loader):
        self._loader = loader

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loader, name)

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        assert module.__spec__ is not None
        module.__spec__.loader = self._loader
        module.__loader__ = self._loader
        with ExitStack() as stack:
            for context in _contexts:
                stack.enter_context(context())
            self._loader.exec_module(module)
        sys.meta_path.remove(_finder)
        while _actions:
            _actions.pop(0)()


_finder = _Finder()


def _listen() -> None:
    if _finder not in sys.meta_path and not is_imported():
        sys.meta_path.insert(0, _finder)


GPU_PLUGINS = "jax_plugins"
"""The package in which JAX finds what drives GPUs; there is none where it was installed for processors alone."""


def _keep_float32() -> None:
    """Let products of matrices on a GPU be those of float32, unless the user has said something else.

    JAX rounds their factors to ten bits there by default (TF32), by up to a two-thousandth; no processor does.
    """
    from importlib.util import find_spec

    if find_spec(GPU_PLUGINS) is None:
        return  # and so programs that are kept on disk stay what they are
    if jax.config.jax_default_matmul_precision is None:
        jax.config.update("jax_default_matmul_precision", "highest")


when_imported(_keep_float32)
