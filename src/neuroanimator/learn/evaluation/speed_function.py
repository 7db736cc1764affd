"""The opponent of an emulator of a Python function: that function, timed in Python as its author runs it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import redirect_stdout

from neuroanimator.errors import BadFileError
from neuroanimator.learn.evaluation.accuracy import scheme_error, schemes_of
from neuroanimator.learn.evaluation.held_out import HeldOut
from neuroanimator.physics.functions.function_system import FUNCTION, PythonSystem
from neuroanimator.physics.functions.step_file import call_step
from neuroanimator.systems.system import Scheme

PYTHON_FUNCTION = "Python function"
"""Name in reports of this physics."""

ROUNDING = 1e-9
"""Relative difference up to which two steps are the same."""

FUNCTION_STEPS = 500
"""Number of calls in one timed run: milliseconds, so that the clock's resolution does not count."""


def function_player(system: PythonSystem, test: HeldOut) -> Callable[[], None]:
    """Return a function that takes `FUNCTION_STEPS` steps, each from an unseen state under its control."""
    starts, controls = test.moments(FUNCTION_STEPS)
    states = starts[:, : system.parameter_entries.start]
    bodies = [system.arguments_of(start) for start in starts]
    function = system.function
    dt = system.physics_dt

    def play() -> None:
        with redirect_stdout(sys.stderr):
            for state, control, body in zip(states, controls, bodies, strict=True):
                function(state, control, dt, **body)

    # Errors are raised here, not while the clock runs.
    for state, control, body in zip(states, controls, bodies, strict=True):
        call_step(function, system.file, state, control, dt, body)
    return play


def function_error(test: HeldOut, scheme: Scheme) -> float:
    """Return the function's one-step error with another dt; infinite if it fails at that step."""
    try:
        return scheme_error(test, scheme)
    except BadFileError:
        if scheme.dt <= test.system.physics_dt:
            raise
        return float("inf")


def function_schemes(system: PythonSystem, dt: float, divisions: tuple[int, ...]) -> set[Scheme]:
    """Return the ways to step the function through `dt` [s]: never with a smaller one than its reference, which may fail."""
    smallest = system.fine.dt * (1 - ROUNDING)
    every = schemes_of(system, dt, [FUNCTION], divisions)
    return {scheme for scheme in every if scheme.dt >= smallest}
