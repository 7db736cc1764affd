"""The user's own `step(state, control, dt)`: how it is run and called, with its errors in one line.

A step file looks like this; declarations after CONTROL may be left out:

    import numpy as np

    STEP = 0.01                                       # [s] one physics step
    STATE = {"angle": "rad", "speed": "rad/s"}        # name: unit, or name: (unit, size)
    CONTROL = {"torque": ("N·m", -2.0, 2.0)}          # name: (unit, least, largest); lists for several
    ANGLES = ["angle"]                                # parts that may turn all the way round
    RATES = {"angle": "speed"}                        # the part that is another's rate of change
    REST = {"angle": 0.0}                             # the state of rest; zeros if left out
    SPREAD = {"angle": 3.14, "speed": 4.0}            # random starts are rest ± spread
    BATCHED = True                                    # step takes (S, B) and (C, B) arrays too: much faster
    ODE = True                                        # step integrates an equation: finer dt are its reference
    PARAMETERS = {"length": ("m", 0.5, 2.0)}          # further arguments of step, which vary from body to body

    def step(state, control, dt):
        speed = state[1] + dt * (control[0] - 9.81 * np.sin(state[0]))
        return np.array([state[0] + dt * speed, speed])
"""

from __future__ import annotations

import signal
import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from functools import lru_cache
from types import MappingProxyType, ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.errors import BadFileError
from neuroanimator.systems.trusted_files import trusted_file
from neuroanimator.text import printable

StepFunction = Callable[..., np.ndarray]
"""The user's function: (state, control, dt [s]), and parameters by name, to the next state."""

DIGEST_SHOWN = 16
"""Number of digits of a file's sha256 that distinguish its module in a process."""

NO_REAL_NUMBERS = "cOSUVmM"
"""NumPy's kinds of complex numbers, objects, texts, records and times."""

MAX_PARTS = 5
"""Maximum number of parts of a function's result named in an error."""

MAX_SHOWN = 200
"""Maximum number of characters shown of an error of the user's function."""


@lru_cache(maxsize=16)
def run_file(digest: str, name: str) -> ModuleType:
    """Return the module in the file with this sha256, running it.

    Only files that the user has allowed are ever run; see `loading.trust_files`.
    """
    source = trusted_file(
        digest,
        f"It was made from {printable(name)}, Python code that is run only if you say so: give the TOML file beside "
        "it, --system PATH, or in Python trust_files(PATH). If you did, the code has changed since: generate and "
        "train again.",
    )
    module = ModuleType(f"neuroanimator_step_{digest[:DIGEST_SHOWN]}")
    module.__file__ = name
    sys.modules[module.__name__] = module  # dataclasses look up their module there
    try:
        with redirect_stdout(sys.stderr):  # results alone go to stdout
            exec(compile(source, name, "exec"), module.__dict__)
    except SyntaxError as error:
        raise BadFileError(f"{name}, line {error.lineno}: {error.msg}.") from error
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and _raises_on_ctrl_c():
            raise
        raise fault(error, name) from error
    if not callable(getattr(module, "step", None)):
        raise BadFileError(
            f"{name}: wanted a function `def step(state, control, dt): return next_state`. Add one."
        )
    return module


def call_step(
    function: StepFunction,
    name: str,
    state: Float[np.ndarray, " S *B"],
    control: Float[np.ndarray, " C *B"],
    dt: float,
    arguments: Mapping[str, Any] = MappingProxyType({}),
) -> Float[np.ndarray, " S *B"]:
    """Return the user's next state, given further `arguments` by name.

    Any exception of the function becomes a BadFileError of one line.
    """
    try:
        with np.errstate(all="ignore"), redirect_stdout(sys.stderr):
            answer = function(state.copy(), control.copy(), dt, **arguments)
            following = _as_numbers(answer)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and _raises_on_ctrl_c():
            raise
        raise fault(error, name) from error
    if following is None or following.shape != state.shape:
        raise BadFileError(
            f"{name}: step returned {_form(answer)}; wanted numbers of shape {state.shape}, like the state."
        )
    return following


def _raises_on_ctrl_c() -> bool:
    """Return whether Ctrl-C is a KeyboardInterrupt here, as in Python; to the command line and to workers it is a signal."""
    return signal.getsignal(signal.SIGINT) is signal.default_int_handler


def _as_numbers(answer: object) -> Float[np.ndarray, " ..."] | None:
    """Return a function's result as real numbers; None if it is anything else."""
    try:
        array = np.asarray(answer)
        if array.dtype.kind in NO_REAL_NUMBERS:
            return None
        return array.astype(float, copy=False)
    except (TypeError, ValueError):
        return None


def _form(answer: object) -> str:
    """Return a short description of a function's result."""
    if answer is None:
        return "nothing"
    numbers = _as_numbers(answer)
    if numbers is not None:
        return f"shape {numbers.shape}"
    if isinstance(answer, np.ndarray):
        return f"an array of {answer.dtype}"
    if isinstance(answer, tuple | list):
        kinds = ", ".join(type(part).__name__ for part in answer[:MAX_PARTS])
        return f"a {type(answer).__name__} of {kinds}"
    return f"a {type(answer).__name__}"


def fault(error: BaseException, name: str) -> BadFileError:
    """Return a BadFileError of one line that says where in the user's file `error` arose."""
    where = name
    for frame in traceback.extract_tb(error.__traceback__):
        if frame.filename == name:
            where = f"{name}, line {frame.lineno}"  # the innermost comes last
    text = " ".join(str(error).split())[:MAX_SHOWN]
    return BadFileError(
        f"{where}: {type(error).__name__}: {text}. Correct the function; states come as float arrays."
    )
