"""What lets a short command start at once: imports are most of its time."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from neuroanimator.jax_later import import_within

if TYPE_CHECKING:
    from importlib.metadata import Distribution

OBJECTS_BETWEEN_COLLECTIONS = 50_000
"""Number of new objects after which Python looks for garbage; usually 700, and imports make half a million that stay."""

AMD_PLUGINS = "jax_rocm"
"""The folders of JAX's plugins for the graphics processors of AMD begin so."""


def collect_garbage_seldom() -> None:
    """Spare the process a seventh of its start, for some megabytes."""
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)


def import_jax_quickly() -> None:
    """Let JAX, if anything needs it, be imported without its reading what every package says about itself.

    It looks for plugins so, by name (jax/_src/numpy/array_constructors.py): a quarter of a second and more. The folders
    of packages have names, too.
    """
    import_within(fewer_packages)


@contextmanager
def fewer_packages() -> Iterator[None]:
    """Hide all packages but JAX's plugins for the processors of AMD while the block lasts."""
    from importlib import metadata

    every = metadata.distributions
    metadata.distributions = partial(amd_plugins, every)
    try:
        yield
    finally:
        metadata.distributions = every


def amd_plugins(
    every: Callable[..., Iterable[Distribution]], **context: str
) -> Iterator[Distribution]:
    """Yield those of all packages that may be JAX's plugins for AMD's processors."""
    for package in every(**context):
        folder = getattr(package, "_path", None)
        if folder is None or folder.name.lower().startswith(AMD_PLUGINS):
            yield package
