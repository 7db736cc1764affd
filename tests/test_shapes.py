"""Every call of the package is held against its annotations: what `shapes.py` switches on cannot silently stop."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from types import FunctionType, ModuleType

import numpy as np
import pytest
from jaxtyping import Float, TypeCheckError
from shapes import has_axes

import neuroanimator.cli.train  # noqa: F401  with most of the package
from neuroanimator import load_system
from neuroanimator.control.objective.goals import goal_state
from neuroanimator.state.layout import Bounds
from neuroanimator.state.rotation import heading_of, rotate
from neuroanimator.systems.goal import Goal

UNIT = np.array([1.0, 0.0, 0.0, 0.0])


def test_a_wrong_shape_is_refused():
    with pytest.raises(TypeError, match="size 3 does not equal 4"):
        rotate(UNIT[:3], np.zeros(3))


def test_a_wrong_kind_of_number_is_refused():
    with pytest.raises(TypeError, match="has dtype int64"):
        heading_of(UNIT.astype(int))


def test_what_does_not_fit_a_dataclass_is_refused():
    with pytest.raises(TypeCheckError, match="parameter 'low'"):
        Bounds("low", (1.0,))  # pyright: ignore[reportArgumentType]


def test_a_result_of_a_wrong_shape_is_refused():
    system = load_system("pendulum")
    system.rest = np.zeros((1, system.state.size))
    with pytest.raises(TypeError, match="2 dimensions, not the 1"):
        goal_state(system, Goal((), ()))


def test_scopes_are_for_what_names_axes():
    array = Float[np.ndarray, "N 3"]
    for kind in (
        array,
        array | None,
        list[array],
        Callable[[array], None],
        dict[str, tuple[array]],
    ):
        assert has_axes(kind)
    for kind in (str, int | None, list[Path], Callable[[str], None], np.ndarray, None):
        assert not has_axes(kind)


def package_functions() -> list[FunctionType]:
    """Return the functions of every module of the package that was imported so far."""
    functions = []
    for name, module in sorted(sys.modules.items()):
        if isinstance(module, ModuleType) and name.startswith("neuroanimator."):
            own = inspect.getmembers(module, inspect.isfunction)
            functions += [function for _, function in own if function.__module__ == name]
    # jaxtyping's hook leaves coroutines as they are; what they call is checked.
    return [function for function in functions if not is_asynchronous(function)]


def is_asynchronous(function: FunctionType) -> bool:
    return inspect.iscoroutinefunction(function) or inspect.isasyncgenfunction(function)


def test_no_module_was_imported_before_the_checks():
    functions = package_functions()
    assert len(functions) > 200
    unchecked = [f.__qualname__ for f in functions if inspect.unwrap(f) is f]
    assert unchecked == []
