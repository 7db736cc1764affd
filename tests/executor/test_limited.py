"""A call in a process with limits gives its result or one line, whatever the process does."""

from __future__ import annotations

import os
import signal

import pytest

from neuroanimator.errors import BadFileError
from neuroanimator.executor.limited import LimitError, ProcessLimits, call_limited

LIMITS = ProcessLimits(memory=2**29, seconds=3)


def double(number: int) -> int:
    return 2 * number


def complain(what: str) -> None:
    raise BadFileError(what)


def take(size: int) -> int:
    return len(bytes(size))


def work_for_ever(number: int) -> None:
    while True:
        number += 1


def crash(number: int) -> None:
    print("on its way out", flush=True)
    os.kill(os.getpid(), number)


def test_a_call_gives_its_result_or_raises_its_error():
    assert call_limited(double, 21, LIMITS) == 42
    with pytest.raises(BadFileError, match="^it is damaged.$"):
        call_limited(complain, "it is damaged.", LIMITS)


def test_f21_too_much_memory_too_long_a_time_and_a_crash_are_one_line(capfd):
    assert call_limited(take, 2**28, LIMITS) == 2**28
    with pytest.raises(LimitError, match="^takes more than 0.5 GB of memory$"):
        call_limited(take, 2**30, LIMITS)
    with pytest.raises(LimitError, match="^takes more than 3 s$"):
        call_limited(work_for_ever, 0, LIMITS)
    with pytest.raises(LimitError, match="^crashes, or takes more than 0.5 GB of memory$"):
        call_limited(crash, signal.SIGSEGV, LIMITS)
    assert capfd.readouterr() == ("", "")
