"""What may be wrong with a step function that answers, what it can do beyond need, and how long it takes."""

from __future__ import annotations

import time

import numpy as np
from jaxtyping import Float

from neuroanimator.data.config import RUN_STEPS, RUNS_PER_SHARD, SAMPLES_PER_RUN
from neuroanimator.errors import BadFileError
from neuroanimator.systems.functions.function_system import PythonSystem, are_too_large
from neuroanimator.systems.functions.step_file import call_step

TOLERANCE_RELATIVE = 1e-9
"""Share by which an answer may differ: the same sums, perhaps in another order."""

TOLERANCE_ABSOLUTE = 1e-12
"""Amount by which an answer may differ, where the number itself is about zero."""

REPEATED = 20
"""Number of states asked about twice."""

TIMED = 5
"""Number of calls timed; the quickest counts."""

MAX_PLAIN = 1e6
"""From states of no larger numbers a step does not overflow: NaN then comes of the function itself."""

USUAL_TRANSITIONS = 100_000
"""`generate` makes this many transitions if nothing else is said."""

SLOW_CALL = 1e-3
"""A function that takes longer [s] is worth a word."""


def refuse_memory(
    system: PythonSystem, states: Float[np.ndarray, "N S"], controls: Float[np.ndarray, "N C"]
) -> None:
    """Raise BadFileError for a function that answers the same question in two ways: it remembers, or draws lots."""
    asked = list(zip(states[:REPEATED], controls[:REPEATED], strict=True))
    first = [_answer(system, state, control) for state, control in asked]
    again = [_answer(system, state, control) for state, control in reversed(asked)]
    for one, other in zip(first, reversed(again), strict=True):
        if not _is_same(one, other):
            entry = int(np.argmax(np.abs(one - other)))
            raise BadFileError(
                f"{system.file}: step answers the same state and control with {one[entry]:.6g} and with "
                f"{other[entry]:.6g} for {system.state.names[entry]}. It must keep nothing between calls and draw no lots."
            )


def takes_batches(
    system: PythonSystem, states: Float[np.ndarray, "N S"], controls: Float[np.ndarray, "N C"]
) -> bool:
    """Return whether the function answers (S, B) states and (C, B) controls as it answers one state after the other."""
    try:
        together = call_step(system.function, system.file, states.T, controls.T, system.physics_dt)
    except BadFileError:
        return False
    for state, control, expected in zip(states, controls, together.T, strict=True):
        if not _is_same(_answer(system, state, control), expected):
            return False
    return True


def _answer(
    system: PythonSystem, state: Float[np.ndarray, " S"], control: Float[np.ndarray, " C"]
) -> Float[np.ndarray, " S"]:
    return call_step(system.function, system.file, state, control, system.physics_dt)


def _is_same(one: Float[np.ndarray, " S"], other: Float[np.ndarray, " S"]) -> bool:
    return np.allclose(one, other, rtol=TOLERANCE_RELATIVE, atol=TOLERANCE_ABSOLUTE, equal_nan=True)


def refuse_nan(
    system: PythonSystem,
    starts: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B T C"],
    substeps: int,
) -> None:
    """Raise BadFileError if the function answers a plain state with NaN on the way from one of `starts`."""
    for start, held in zip(starts, controls, strict=True):
        state = start
        for control in np.repeat(held, substeps, axis=0):
            if are_too_large(state) or np.abs(state).max() > MAX_PLAIN:
                break
            following = _answer(system, state, control)
            if np.isnan(following).any():
                entry = int(np.argmax(np.isnan(following)))
                raise BadFileError(
                    f"{system.file}: step returns NaN for {system.state.names[entry]} in the state "
                    f"{_in_words(system, state)}. Correct the function, or use a smaller SPREAD."
                )
            state = following


def _in_words(system: PythonSystem, state: Float[np.ndarray, " S"]) -> str:
    """Return the first few numbers of a state, as Python would write the array."""
    return np.array2string(state, precision=4, threshold=8, edgeitems=4, separator=", ")


def seconds_per_call(system: PythonSystem) -> float:
    """Return how long one call of the function for one state takes [s]."""
    best = float("inf")
    for _ in range(TIMED):
        began = time.perf_counter()
        _answer(system, system.rest, system.bounds.middle)
        best = min(best, time.perf_counter() - began)
    return best


def seconds_of_data(system: PythonSystem, substeps: int) -> float:
    """Return about how long the usual dataset takes [s], in super steps of `substeps` calls."""
    runs = -(-USUAL_TRANSITIONS // SAMPLES_PER_RUN)
    calls = RUN_STEPS * substeps * round(system.physics_dt / system.truth.dt)
    if not system.batched:
        return runs * calls * seconds_per_call(system)
    states = np.repeat(system.rest[:, None], RUNS_PER_SHARD, axis=1)
    controls = np.repeat(system.bounds.middle[:, None], RUNS_PER_SHARD, axis=1)
    began = time.perf_counter()
    call_step(system.function, system.file, states, controls, system.physics_dt)
    return -(-runs // RUNS_PER_SHARD) * calls * (time.perf_counter() - began)
