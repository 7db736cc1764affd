"""Checks of an emulator's inputs and of the motions it computes."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.errors import ArgumentError, DivergedError
from neuroanimator.state.layout import Layout

MAX_MAGNITUDE = 1e6
"""Maximum magnitude of a state's numbers: beyond it a super step's change is lost in the rounding of float32."""

MAX_CONTROL = float(np.finfo(np.float32).max)
"""Maximum magnitude of a control's numbers: that of float32."""

MAX_LAYER = 4096
"""Maximum number of units in a hidden layer: it bounds what a hostile file can make us allocate, and holds in training."""


def check_numbers(
    vector: ArrayLike, layout: Layout, label: str, most: float, dtype: Any
) -> Float[np.ndarray, " ..."]:
    """Return `vector` (..., S) as numbers of the type `dtype`, in C order.

    Raises ArgumentError for a last axis of another length, and for entries that are not finite numbers of magnitude
    at most `most`.
    """
    numbers = layout.check(vector, label)
    too_large = np.abs(numbers) > most
    if too_large.any():
        index = tuple(np.argwhere(too_large)[0])
        raise ArgumentError(
            f"{label}: {layout.names[index[-1]]} is {numbers[index]:g}; wanted a magnitude of at most {most:g}. "
            "Give a smaller one."
        )
    return np.ascontiguousarray(numbers, dtype)


def check_motion(trajectory: Float[np.ndarray, "*B F S"], layout: Layout) -> None:
    """Refuse a trajectory (..., T+1, S) with states that no call accepts; the error names the first such number.

    Raises ArgumentError if it is in the first super step, and DivergedError if it is later.
    """
    broken = np.argwhere(~(np.abs(trajectory) <= MAX_MAGNITUDE))
    if not len(broken):
        return
    first = broken[np.argmin(broken[:, -2])]
    step = first[-2]
    name = layout.names[first[-1]]
    is_finite = np.isfinite(trajectory[tuple(first)])
    found = f"beyond {MAX_MAGNITUDE:g}" if is_finite else "not finite"
    if step <= 1:
        raise ArgumentError(
            f"state: after one super step from it {name} is {found}. Give a state that the "
            "system can be in, such as its rest; `covers` says which the emulator knows."
        )
    raise DivergedError(
        f"The motion diverged: {name} is {found} from super step {step} on. Start nearer to what the emulator "
        "was trained on (`covers` says what that is), or train it longer."
    )
