"""The opponent of an emulator of a Python function: that function, timed in Python as its author runs it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import redirect_stdout

import numpy as np

from neuroanimator.errors import BadFileError
from neuroanimator.learn.evaluation.accuracy import scheme_error
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
    count = test.controls.shape[0] * test.controls.shape[1]
    rows = np.random.default_rng(0).integers(0, count, FUNCTION_STEPS)
    whole = test.states[:, :-1].reshape(-1, system.state.size)[rows]
    states = whole[:, : system.parameter_entries.start]
    bodies = [system.arguments_of(state) for state in whole]
    controls = test.controls.reshape(-1, system.control.size)[rows]
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
    """Return the ways to step the function through `dt` [s]; the reference is among them, as it has no error.

    A function is never called with a smaller dt than its reference: it may not support that.
    """
    schemes = {Scheme(FUNCTION, dt / parts) for parts in divisions}
    schemes |= {system.scheme, system.truth, system.fine}
    smallest = system.fine.dt * (1 - ROUNDING)
    return {scheme for scheme in schemes if scheme.dt >= smallest}
