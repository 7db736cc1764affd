"""Modules: frozen dataclasses of arrays and of settled facts, which JAX takes apart as pytrees once it is imported.

As equinox has them, but without JAX: their arrays may be those of NumPy, and whoever never asks for JAX need not import it.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, fields
from functools import cache, partial
from typing import Any, dataclass_transform

from neuroanimator.jax_later import jax, when_imported

STATIC = "static"
"""Metadata of a field that is a settled fact: part of the structure JAX compiles for, no array."""


def static(**options: Any) -> Any:
    """Return a field that is a settled fact, which can be hashed and compared; `options` are those of `field`."""
    return field(metadata={STATIC: True}, **options)


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field, static))
class Module(abc.ABC):  # noqa: B024 (what derives from it may be abstract)
    """What derives from it is a frozen dataclass, equal to nothing but itself, and a pytree of its fields.

    Fields are arrays, modules and tuples of these, or settled facts: see `static`.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        dataclass(frozen=True, eq=False)(cls)
        when_imported(partial(_register, cls))


@cache
def _field_names(kind: type[Module]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of (what JAX sees, settled facts) of a kind of module."""
    seen = []
    settled = []
    for one in fields(kind):  # pyright: ignore[reportArgumentType]
        names = settled if one.metadata.get(STATIC) else seen
        names.append(one.name)
    return tuple(seen), tuple(settled)


def _values(module: Module, names: tuple[str, ...]) -> tuple[Any, ...]:
    return tuple([getattr(module, name) for name in names])


def _put_together(kind: type[Module], settled: tuple[Any, ...], seen: Iterable[Any]) -> Module:
    """Return the module with these values, whatever they are: JAX puts all kinds of things in an array's place."""
    module = object.__new__(kind)
    seen_names, settled_names = _field_names(kind)
    for name, value in zip(seen_names, seen, strict=True):
        object.__setattr__(module, name, value)
    for name, value in zip(settled_names, settled, strict=True):
        object.__setattr__(module, name, value)
    return module


def _register(kind: type[Module]) -> None:
    """Tell JAX how to take a kind of module apart."""
    seen, settled = _field_names(kind)
    keys = [jax.tree_util.GetAttrKey(name) for name in seen]

    def flatten(module: Module) -> tuple[Any, Any]:
        return _values(module, seen), _values(module, settled)

    def flatten_with_keys(module: Module) -> tuple[Any, Any]:
        return list(zip(keys, _values(module, seen), strict=True)), _values(module, settled)

    jax.tree_util.register_pytree_with_keys(
        kind, flatten_with_keys, partial(_put_together, kind), flatten
    )


def leaves(tree: Any) -> list[Any]:
    """Return the arrays of modules, tuples, lists and dictionaries, in the order of `jax.tree.leaves`."""
    return list(_leaves(tree))


def _leaves(tree: Any) -> Iterator[Any]:
    children = _children(tree)
    if children is None:
        yield tree
        return
    for child in children:
        yield from _leaves(child)


def map_leaves(function: Callable[[Any], Any], tree: Any) -> Any:
    """Return `tree` with `function` of each array in its place."""
    children = _children(tree)
    if children is None:
        return function(tree)
    mapped = [map_leaves(function, child) for child in children]
    if isinstance(tree, Module):
        settled = _values(tree, _field_names(type(tree))[1])
        return _put_together(type(tree), settled, tuple(mapped))
    if isinstance(tree, dict):
        return dict(zip(sorted(tree), mapped, strict=True))
    if hasattr(tree, "_fields"):  # a named tuple
        return type(tree)(*mapped)
    return None if tree is None else type(tree)(mapped)


def structure_in_words(tree: Any) -> str:
    """Return all that `tree` is but for its arrays: the kinds of modules, how they are nested, and settled facts."""
    children = _children(tree)
    if children is None:
        return "*"
    kind = type(tree)
    told = [structure_in_words(child) for child in children]
    if isinstance(tree, Module):
        told += [repr(value) for value in _values(tree, _field_names(kind)[1])]
    elif isinstance(tree, dict):
        told = [f"{key!r}: {value}" for key, value in zip(sorted(tree), told, strict=True)]
    return f"{kind.__module__}.{kind.__qualname__}({', '.join(told)})"


def _children(tree: Any) -> tuple[Any, ...] | list[Any] | None:
    """Return what `tree` is made of, in JAX's order; None for an array, or whatever else JAX would not take apart."""
    if isinstance(tree, Module):
        return _values(tree, _field_names(type(tree))[0])
    if isinstance(tree, tuple | list):
        return tree
    if isinstance(tree, dict):
        return [tree[key] for key in sorted(tree)]
    return () if tree is None else None
