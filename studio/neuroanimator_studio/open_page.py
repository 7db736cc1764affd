"""One open page: what it sends, how much of that it may send, and what waits to be sent to it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from neuroanimator_studio.limits import Limits

Message = dict[str, Any]
"""What is sent as JSON: an answer or an event."""


class RefusedError(Exception):
    """The page did what it may not."""


class Budget:
    """How many more messages a page may send: so many at once, and so many a second in the long run."""

    def __init__(self, limits: Limits):
        self._most = float(limits.messages_at_once)
        self._rate = limits.messages_a_second
        self._left = self._most
        self._then = time.monotonic()

    def spend(self) -> None:
        """Count a message; raise RefusedError if there were too many."""
        now = time.monotonic()
        self._left = min(self._most, self._left + (now - self._then) * self._rate)
        self._then = now
        if self._left < 1:
            raise RefusedError("too many messages")
        self._left -= 1


class Page:
    """One open page."""

    def __init__(self, socket: WebSocket, limits: Limits):
        self._socket = socket
        self._limits = limits
        self._waiting: asyncio.Queue[str] = asyncio.Queue(limits.waiting_messages)

    def tell(self, event: Message) -> None:
        """Send an event soon; a page that does not keep up misses it."""
        with contextlib.suppress(asyncio.QueueFull):
            self._waiting.put_nowait(_as_text(event))

    async def answer(self, answer: Message) -> None:
        """Send an answer soon; wait while too many wait already."""
        await self._waiting.put(_as_text(answer))

    async def send_all(self) -> None:
        """Send what waits, until the page is gone or takes nothing in."""
        while True:
            text = await self._waiting.get()
            try:
                async with asyncio.timeout(self._limits.send_seconds):
                    await self._socket.send_text(text)
            except TimeoutError:
                raise RefusedError("takes nothing in") from None

    async def receive(self) -> str:
        """Return the page's next message; RefusedError for one that is no text."""
        message = await self._socket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1000))
        text = message.get("text")
        if text is None:
            raise RefusedError("bytes instead of text")
        return text


def _as_text(message: Message) -> str:
    return json.dumps(message, allow_nan=False, separators=(",", ":"))
