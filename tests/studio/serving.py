"""A running studio: uvicorn in a thread of this process, real sockets, and clients that say exactly what they are told."""

from __future__ import annotations

import asyncio
import http.client
import json
import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from tally import Tally
from waiting import PATIENCE
from websockets import Subprotocol
from websockets.sync.client import ClientConnection, connect

from neuroanimator_studio.guard import Gate
from neuroanimator_studio.jobs import Jobs
from neuroanimator_studio.library import Library
from neuroanimator_studio.limits import USUAL, Limits
from neuroanimator_studio.server import listen, make_server
from neuroanimator_studio.studio import Studio

Headers = dict[str, str]

Tried = TypeVar("Tried")


def each(tally: Tally, tried: Sequence[Tried]) -> Sequence[Tried]:
    """Count what a test tries."""
    tally.tried += len(tried)
    return tried


@dataclass(frozen=True)
class Reply:
    status: int
    headers: Headers
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


@dataclass(frozen=True)
class Serving:
    """A studio that runs, and its address."""

    studio: Studio

    @property
    def gate(self) -> Gate:
        return self.studio.gate

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.gate.port}"

    @property
    def token(self) -> Headers:
        """What the page says with every request."""
        return {"X-Token": self.gate.token}

    def ask(
        self, path: str, method: str = "GET", body: Any = None, headers: Headers | None = None
    ) -> Reply:
        """Send a request as the page would, but for `headers`; the path goes as it is."""
        connection = http.client.HTTPConnection("127.0.0.1", self.gate.port, timeout=PATIENCE)
        try:
            said = {"Host": f"127.0.0.1:{self.gate.port}"} | self.token | (headers or {})
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            for name, value in said.items():
                connection.putheader(name, value)
            if body is not None:
                connection.putheader("Content-Length", str(len(body)))
            connection.endheaders(body)
            reply = connection.getresponse()
            lower = {name.lower(): value for name, value in reply.getheaders()}
            return Reply(reply.status, lower, reply.read())
        finally:
            connection.close()

    def post(self, path: str, body: bytes, kind: str, headers: Headers | None = None) -> Reply:
        """Post as its own page would."""
        own = {"Origin": self.origin, "Content-Type": kind}
        return self.ask(path, "POST", body, own | (headers or {}))

    def post_json(self, path: str, value: Any) -> Reply:
        return self.post(path, json.dumps(value).encode(), "application/json")

    @contextmanager
    def page(self) -> Iterator[ClientConnection]:
        """Yield the socket of an open page."""
        with self.socket() as socket:
            assert json.loads(socket.recv(PATIENCE))["event"] == "ready"
            yield socket

    def socket(self, origin: str | None = "", token: str | None = None) -> ClientConnection:
        """Connect a WebSocket: of its own page if no origin is said, without any for None; with another `token`."""
        said = self.origin if origin == "" else origin
        return connect(
            f"ws://127.0.0.1:{self.gate.port}/live",
            origin=said,
            compression=None,
            subprotocols=[Subprotocol(f"token.{self.gate.token if token is None else token}")],
        )

    def raw_socket(self, host: str | None = None, origin: str | None = None) -> socket.socket:
        """Connect, and ask for a WebSocket byte by byte: nothing is read or sent that a test does not ask for."""
        host = f"127.0.0.1:{self.gate.port}" if host is None else host
        origin = self.origin if origin is None else origin
        return self.raw(
            f"GET /live HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\n"
            f"Sec-WebSocket-Protocol: token.{self.gate.token}\r\n"
            "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )

    def raw(self, content: bytes = b"") -> socket.socket:
        """Connect, and send bytes as they are."""
        connection = socket.create_connection(("127.0.0.1", self.gate.port), timeout=PATIENCE)
        connection.sendall(content)
        return connection


def status_of(connection: socket.socket) -> int:
    """Return the status of the answer; 0 if the connection was cut."""
    connection.settimeout(10)
    try:
        line = connection.recv(100)
    except ConnectionError:
        return 0
    return int(line.split()[1]) if line else 0


def ask_page(page: ClientConnection, **request: Any) -> Any:
    """Return the answer to a request, events left aside."""
    page.send(json.dumps({"id": 1, **request}))
    while True:
        answer = json.loads(page.recv(PATIENCE))
        if "event" not in answer:
            return answer


def write_page(folder: Path) -> Path:
    """Write a page of two files, as a build would."""
    (folder / "assets").mkdir(parents=True, exist_ok=True)
    (folder / "index.html").write_text("<!doctype html><title>Studio</title>")
    (folder / "assets" / "main.js").write_text("export {};")
    return folder


@contextmanager
def serving(
    folder: Path, limits: Limits = USUAL, page: Path | None = None, host: str = "127.0.0.1"
) -> Iterator[Serving]:
    """Run a studio whose own bundles and trainings are in `folder`; so is its page if none is given."""
    page = page or write_page(folder / "page")
    own = folder / "bundles"
    own.mkdir(exist_ok=True)
    listener = listen(host, 0)
    gate = Gate(host, listener.getsockname()[1])
    trainings = folder / "jobs"
    trainings.mkdir(exist_ok=True)
    studio = Studio(gate, page, Library(own), limits, Jobs(own, trainings))
    server = make_server(studio)
    thread = threading.Thread(target=lambda: asyncio.run(server.serve(sockets=[listener])))
    thread.start()
    try:
        yield Serving(studio)
    finally:
        server.should_exit = True
        thread.join(20)
        studio.close()
        listener.close()
