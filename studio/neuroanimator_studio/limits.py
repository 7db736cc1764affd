"""How much, how fast and how long the server lets anybody ask: a stranger's request must not cost the user's machine."""

from __future__ import annotations

from dataclasses import dataclass

from neuroanimator.authoring import SIZE_LIMIT


@dataclass(frozen=True)
class Limits:
    """All of them; tests shorten the times."""

    upload_bytes: int = SIZE_LIMIT
    """The largest emulator file taken [bytes]: the loader reads no larger one."""
    body_bytes: int = 8 << 20
    """The largest other body of a request [bytes]: controls of an hour."""
    body_seconds: float = 60.0
    """Time for a whole body [s]."""
    chunk_seconds: float = 10.0
    """Time for the next piece of a body [s]."""
    header_seconds: float = 10.0
    """Time for the head of a request [s]."""
    connections: int = 100
    """Connections held open at once; a browser opens six."""
    sockets: int = 8
    """Pages that are connected at once."""
    message_bytes: int = 1 << 20
    """The longest message of a page [bytes]."""
    messages_a_second: float = 60.0
    """How many messages a page may send in the long run [1/s]."""
    messages_at_once: int = 240
    """How many it may send in a burst."""
    requests_at_once: int = 4
    """How many of a page's requests are worked on at a time."""
    waiting_messages: int = 64
    """How many messages may wait for a slow page; further events are dropped."""
    send_seconds: float = 10.0
    """Time for a page to take one message [s]; one that does not is left."""
    steps: int = 20_000
    """The most super steps replayed or exported at once."""
    physics_steps: int = 2_000_000
    """The most physics steps replayed at once."""
    downloads: int = 20
    """How many exported files are kept."""


USUAL = Limits()
"""What the server goes by."""
