"""Options of the verbs that work in several processes or on a cluster."""

from __future__ import annotations

from typing import Annotated

import typer

from neuroanimator.cores import core_count
from neuroanimator.executor.choose import open_executor
from neuroanimator.executor.executor import Executor

Where = Annotated[
    str,
    typer.Option(
        "--executor", help="Where: local; ray starts Ray here; ray://HOST:PORT joins a cluster."
    ),
]
"""The option `--executor`."""

Workers = Annotated[
    int | None,
    typer.Option(help="Processes that work at a time; the results do not depend on it."),
]
"""The option `--workers`."""


def chosen_executor(where: str, workers: int | None, threads: int | None = None) -> Executor:
    """Return the executor these options choose."""
    return open_executor(where, workers, threads, core_count())
