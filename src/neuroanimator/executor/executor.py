"""The interface of executors: tasks in, outcomes out, as each is ready or in the order of the tasks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Generic, TypeVar

from neuroanimator.errors import ArgumentError, NeuroAnimatorError

TRAINING_SECONDS = 24 * 3600.0
"""A worker that takes longer for a training counts as hung [s]."""

MAX_RETRIES = 3
"""Number of times a task is computed again whose worker died or hung."""

Result = TypeVar("Result")


class LostTaskError(NeuroAnimatorError):
    """A task's worker died or hung each time it was tried."""


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """The outcome of one task."""

    index: int
    """Index of the task among all."""
    result: Result | None = None
    error: NeuroAnimatorError | None = None
    """Why there is no result: its message names the task."""

    def value(self) -> Result:
        """Return the result; raise the error if there is none."""
        if self.error is not None:
            raise self.error
        return self.result  # pyright: ignore[reportReturnType]


class Executor(ABC):
    """Computes tasks somewhere; a context manager, for its workers end with it.

    A task is a frozen dataclass that can be pickled and has a `label`, such as `shard 12`. The function can be imported
    by name, and its result depends on the task alone: so it does not matter who computes it, nor how often.
    """

    workers: int
    """Number of tasks computed at a time."""
    threads: int
    """Number of threads each of them may use."""
    shares_disk: bool
    """Whether every worker sees the files of this process."""

    @abstractmethod
    def outcomes(
        self, function: Callable[[Any], Result], tasks: Sequence[Any], *, longest: float
    ) -> Iterator[Outcome[Result]]:
        """Yield the outcome of each task as soon as it has ended; closing the iterator ends the tasks in flight.

        A worker that takes more than `longest` [s] for a task counts as hung.
        """

    @abstractmethod
    def close(self) -> None:
        """End the workers."""

    def map(
        self,
        function: Callable[[Any], Result],
        tasks: Sequence[Any],
        *,
        longest: float,
        on_done: Callable[[Outcome[Result]], None] = lambda outcome: None,
    ) -> list[Result]:
        """Return the results in the order of the tasks; `on_done` is told of each as it ends.

        Every task is tried before the errors of those that failed are raised, as one.
        """
        results: dict[int, Result] = {}
        failed: dict[int, NeuroAnimatorError] = {}
        for outcome in self.outcomes(function, tasks, longest=longest):
            if outcome.error is None:
                results[outcome.index] = outcome.value()
            else:
                failed[outcome.index] = outcome.error
            on_done(outcome)
        raise_first(failed, len(tasks))
        return [results[index] for index in range(len(tasks))]

    def __enter__(self) -> Executor:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def raise_first(failed: dict[int, NeuroAnimatorError], count: int) -> None:
    """Raise the error of the first of `count` tasks that `failed`, which says how many did; nothing if none did."""
    if not failed:
        return
    first = failed[min(failed)]
    if len(failed) == 1:
        raise first
    raise same_kind(first, f"{first} So failed {len(failed)} of {count} tasks.") from first


def same_kind(error: NeuroAnimatorError, message: str) -> NeuroAnimatorError:
    """Return an error of the same kind, and so of the same exit code, that says `message`."""
    try:
        return type(error)(message)
    except TypeError:  # its kind is made from something else than a message
        other = NeuroAnimatorError(message)
        other.exit_code = error.exit_code
        return other


def check_function(function: Callable[..., Any]) -> None:
    """Raise ArgumentError for a function that a worker could not import."""
    module = getattr(function, "__module__", None)
    name = getattr(function, "__qualname__", "")
    if module in (None, "__main__") or "<" in name:
        raise ArgumentError(
            f"function: wanted one that workers can import, came {name} of {module}. Put it into a module."
        )


def lost(label: str, why: str) -> LostTaskError:
    """Return the error of a task that was given up."""
    return LostTaskError(
        f"{label}: {why}, {MAX_RETRIES + 1} times. Give it fewer workers or more memory, or start it again."
    )
