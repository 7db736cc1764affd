"""The interface of executors: tasks in, outcomes out, as each is ready or in the order of the tasks."""

from __future__ import annotations

import os
import sys
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Generic, TypeVar

from neuroanimator.errors import ArgumentError, NeuroAnimatorError
from neuroanimator.executor.worker import Answer, pack

Result = TypeVar("Result")


class LostTaskError(NeuroAnimatorError):
    """A task's worker died."""


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """The outcome of one task."""

    index: int
    """Index of the task among all."""
    result: Result | None = None
    error: NeuroAnimatorError | None = None
    """The reason for a missing result: its message names the task."""

    def value(self) -> Result:
        """Return the result; raise the error if there is none."""
        if self.error is not None:
            raise self.error
        return self.result  # pyright: ignore[reportReturnType]


class Executor(ABC):
    """Computes tasks; a context manager, which ends its workers.

    A task is a frozen dataclass that can be pickled and has a `label`, such as `shard 12`. The function can be imported
    by name, and its result depends on the task alone: any worker may compute it, any number of times.
    """

    workers: int
    """Number of tasks computed at a time."""
    threads: int
    """Number of threads each task may use."""
    ahead: int = 1
    """Number of tasks under way for each worker."""
    shares_disk: bool
    """Whether every worker sees the files of this process."""

    def outcomes(
        self, function: Callable[[Any], Result], tasks: Sequence[Any]
    ) -> Iterator[Outcome[Result]]:
        """Yield the outcome of each task once it has ended; closing the iterator ends the tasks under way."""
        check_function(function)
        waiting = deque(range(len(tasks)))
        under_way: dict[Any, int] = {}
        ended: list[Outcome[Result]] = []
        try:
            while waiting or under_way:
                while waiting and len(under_way) < self.ahead * self.workers:
                    index = waiting.popleft()
                    under_way[self.begin(pack(function, tasks[index]))] = index
                # The workers compute meanwhile: the caller may write a shard.
                yield from ended
                ended = []
                for call in self.wait(list(under_way)):
                    index = under_way.pop(call)
                    ended.append(self._outcome(index, tasks[index], call))
            yield from ended
        finally:
            for call in under_way:
                self.cancel(call)

    def _outcome(self, index: int, task: Any, call: Any) -> Outcome[Any]:
        """Return the outcome of a call that has ended; its error names the task."""
        try:
            answer = self.answer(call)
        except NeuroAnimatorError as error:
            return failed_outcome(index, task, error)
        if answer.error is None:
            return Outcome(index, answer.result)
        if answer.trace and os.environ.get("NEUROANIMATOR_DEBUG"):
            sys.stderr.write(answer.trace)
        return failed_outcome(index, task, answer.error)

    @abstractmethod
    def begin(self, packed_call: bytes) -> Any:
        """Start computing a packed call; return its hashable handle."""

    @abstractmethod
    def wait(self, calls: list[Any]) -> list[Any]:
        """Return those of `calls` that have ended, within a limited time."""

    @abstractmethod
    def answer(self, call: Any) -> Answer:
        """Return the answer to a call that has ended; NeuroAnimatorError if it has none."""

    @abstractmethod
    def cancel(self, call: Any) -> None:
        """End a call that is under way."""

    @abstractmethod
    def close(self) -> None:
        """End the workers."""

    def map(
        self,
        function: Callable[[Any], Result],
        tasks: Sequence[Any],
        *,
        on_done: Callable[[Outcome[Result]], None] = lambda outcome: None,
    ) -> list[Result]:
        """Return the results in the order of the tasks; `on_done` is called with each outcome as it ends.

        Every task is tried before the errors of those that failed are raised, as one.
        """
        results: dict[int, Result] = {}
        failed: dict[int, NeuroAnimatorError] = {}
        for outcome in self.outcomes(function, tasks):
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
    """Raise the error of the first of `count` tasks that `failed`, with the number that did; nothing if none did."""
    if not failed:
        return
    first = failed[min(failed)]
    if len(failed) == 1:
        raise first
    raise same_kind(first, f"{first} {len(failed)} of {count} tasks failed.") from first


def same_kind(error: NeuroAnimatorError, message: str) -> NeuroAnimatorError:
    """Return an error of the same kind, and so of the same exit code, that says `message`."""
    return type(error)(message)


def failed_outcome(index: int, task: Any, error: NeuroAnimatorError) -> Outcome[Any]:
    """Return the outcome of a task that failed: its error names the task."""
    return Outcome(index, error=same_kind(error, f"{task.label}: {error}"))


def check_function(function: Callable[..., Any]) -> None:
    """Raise ArgumentError for a function that a worker could not import."""
    module = getattr(function, "__module__", None)
    name = getattr(function, "__qualname__", "")
    if module in (None, "__main__") or "<" in name:
        raise ArgumentError(
            f"function: wanted one that workers can import, got {name} of {module}. Put it into a module."
        )
