"""The command every child Python process begins with."""

from __future__ import annotations

import sys


def python_command(*arguments: str) -> list[str]:
    """Return the command that runs this Python with `arguments`, such as `-m` and a module.

    -P keeps the current folder off the child's `sys.path`: `-m` and `-c` put it first, so that a `numpy.py` in a
    stranger's archive, or a `queue.py` of the user's own, would run instead of the module of that name.
    """
    return [sys.executable, "-P", *arguments]
