"""Prefetch: a thread makes the next item while this process uses the last one."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from queue import SimpleQueue
from typing import Generic, NamedTuple, TypeVar

Item = TypeVar("Item")


class _Failure(NamedTuple):
    """Error the iterator raised instead of an item, also at its end."""

    error: BaseException


class Prefetched(Generic[Item]):
    """The items of an iterator, with the next `depth` of them made ahead in a thread.

    Besides the one in use, at most `depth` items are ever made or being made, which bounds memory. `next` raises the
    iterator's errors. Must be closed.
    """

    def __init__(self, items: Iterator[Item], depth: int):
        self._items = items
        self._may_make = threading.Semaphore(depth)
        self._made: SimpleQueue[Item | _Failure] = SimpleQueue()
        self._is_closed = False
        # Daemonic: an interrupted process does not wait for a shard to be read.
        self._thread = threading.Thread(target=self._make, name="prefetch", daemon=True)
        self._thread.start()

    def __iter__(self) -> Prefetched[Item]:
        return self

    def __next__(self) -> Item:
        made = self._made.get()
        if isinstance(made, _Failure):
            self._made.put(made)
            raise made.error
        self._may_make.release()
        return made

    def close(self) -> None:
        """End the thread, once its current item is made."""
        self._is_closed = True
        self._may_make.release()
        self._thread.join()

    def _make(self) -> None:
        try:
            while True:
                self._may_make.acquire()
                if self._is_closed:
                    return
                self._made.put(next(self._items))
        except BaseException as error:  # raised where the item is requested
            self._made.put(_Failure(error))
