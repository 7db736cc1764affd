"""Whether this process was forked from one in which JAX had started: its threads are missing here, and calls never end."""

from __future__ import annotations

import os

from jax._src import xla_bridge

from neuroanimator.errors import ResourceError

_forked: list[int] = []
"""This process, if it is such a one."""


def _note() -> None:
    if xla_bridge.backends_are_initialized():
        _forked[:] = [os.getpid()]


def refuse_forked() -> None:
    """Raise ResourceError in a process that was forked after JAX had started."""
    if _forked:
        raise ResourceError(
            "This process was forked from one in which JAX runs, and would wait for ever. Start workers anew: "
            "make_vec(..., 'async', vector_kwargs={'context': 'spawn'}). Or leave vectorization_mode out: all "
            "environments are then stepped at once in one process, which is faster."
        )


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note)
