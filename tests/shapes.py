"""Shapes checked at run time: in the tests, every call of the package is held against its annotations.

`jaxtyping` gives every function of `neuroanimator` the decorator `checked`; `conftest.py` asks for it before
anything of the package is imported.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, get_args, get_origin

from beartype import BeartypeConf, FrozenDict, beartype
from jaxtyping import install_import_hook
from numpy.typing import ArrayLike

NESTED = [part for part in get_args(ArrayLike) if "NestedSequence" in str(get_origin(part))]
"""What NumPy calls a list of lists in `ArrayLike`, a protocol that a tuple does not fulfil at run time."""

RULES = BeartypeConf(
    is_pep484_tower=True,
    hint_overrides=FrozenDict(dict.fromkeys(NESTED, object)),
)
"""A whole number may stand where a `float` is asked for, and anything where an `ArrayLike` is: what users give
is checked by the function itself, whose message they read."""


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function`, checking what it is given and what it returns."""
    return beartype(function, conf=RULES)


def unchecked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function` as users have it, for tests of what it says to those who give it something else."""
    return inspect.unwrap(function)


def check_shapes() -> None:
    """Check every function of the package that is imported from now on."""
    install_import_hook("neuroanimator", "shapes.checked")
