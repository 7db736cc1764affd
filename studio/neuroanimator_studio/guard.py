"""Who may ask the server anything: its own page, in the browser of somebody who was told the token, and nobody else.

Other users of this machine can reach a server on it, and a page of another site can, by a form, an image or a name that
it makes mean 127.0.0.1. So every request must say the token in a header, which the page alone knows: a cookie would go to
every other server of this machine, whatever its port. What changes anything must come from a page of the very address that
is asked; and no answer may be read by, shown in, or run with anything of another site. The page's own files, which
anybody can install, need no token, and a download needs none but its own name, which nobody can guess.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Collection
from dataclasses import dataclass, field

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK = ["127.0.0.1", "localhost", "[::1]"]
"""The names of this machine that only this machine can mean."""

EVERYWHERE = ("0.0.0.0", "::")
"""What `--host` says to listen on every network."""

TOKEN_BYTES = 16
"""Random bytes of a token: 128 bits."""

SAFE_METHODS = ("GET", "HEAD")
"""Requests that change nothing."""

DOWNLOADS = "/api/downloads/"
"""Beginning of the paths of downloads, whose names are secrets of their own."""

HEADER = "x-token"
"""Header that says the token."""

SUBPROTOCOL = "token."
"""Beginning of the subprotocol that says it of a WebSocket, to which browsers give no headers."""

POLICY = (
    "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; media-src 'self' blob:; connect-src 'self' blob:; worker-src 'self' blob:; "
    "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""What the page may load and run: its own files, and WebAssembly. Styles of elements are no programs."""

HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
}
"""What every answer says; nothing of CORS, so that no other site may read any."""


def new_token() -> str:
    """Return a token nobody can guess."""
    return secrets.token_hex(TOKEN_BYTES)


@dataclass(frozen=True)
class Gate:
    """Where the server listens, and the token of its page."""

    host: str
    port: int
    token: str = field(default_factory=new_token, repr=False)

    @property
    def url(self) -> str:
        """What to open in a browser, which tells no server what stands behind the `#`: the page reads it."""
        shown = "127.0.0.1" if self.host in EVERYWHERE else self._name
        return f"http://{shown}:{self.port}/#token={self.token}"

    @property
    def names(self) -> list[str]:
        """Names by which the server may be asked: any, where it listens on networks that give it names of their own."""
        if self.host in EVERYWHERE:
            return ["*"]
        return LOOPBACK if self.is_loopback else [self._name]

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the server."""
        return self.host in ("127.0.0.1", "localhost", "::1")

    @property
    def _name(self) -> str:
        """The host as addresses have it."""
        return f"[{self.host}]" if ":" in self.host else self.host

    def is_token(self, said: str | None) -> bool:
        """Return whether `said` is the token, in a time that says nothing about it."""
        if said is None:
            return False
        return hmac.compare_digest(said.encode("utf-8", "replace"), self.token.encode())


class Guard:
    """Refuses requests before anything looks at them, and adds `HEADERS` to every answer."""

    def __init__(self, app: ASGIApp, gate: Gate, public: Collection[str]):
        self.app = app
        self.gate = gate
        self.public = public
        """Paths of the page's own files."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is asked by this server's own page."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
            await send(message)

        answer = self._answer(HTTPConnection(scope))
        if answer is not None:
            await answer(scope, receive, send_with_headers)
            return
        # One part of a file is never wanted, and a thousand parts take long to sort.
        scope["headers"] = [pair for pair in scope["headers"] if pair[0] != b"range"]
        await self.app(scope, receive, send_with_headers)

    def _answer(self, asked: HTTPConnection) -> Response | None:
        """Return the answer to what goes no further; None for what this server's own page asks."""
        is_reading = asked.scope["type"] == "http" and asked.scope["method"] in SAFE_METHODS
        path = asked.scope["path"]
        if is_reading and (path in self.public or path.startswith(DOWNLOADS)):
            return None
        if not self.gate.is_token(said_token(asked)):
            return refused(403, "Wrong or missing token. Open the address the server printed.")
        if not is_reading and not is_own_page(asked.headers):
            return refused(403, "Only this server's own page may ask that.")
        return None


def is_own_page(headers: Headers) -> bool:
    """Return whether a page of the address that is asked asks: browsers say the origin of what may change anything."""
    return headers.getlist("origin") == [f"http://{headers.get('host')}"]


def said_token(asked: HTTPConnection) -> str | None:
    """Return the token that a request says; None if it says none."""
    if asked.scope["type"] == "websocket":
        said = [name for name in asked.scope["subprotocols"] if name.startswith(SUBPROTOCOL)]
        return said[0].removeprefix(SUBPROTOCOL) if said else None
    return asked.headers.get(HEADER)


def refused(code: int, why: str) -> JSONResponse:
    """Return an answer that says why not, after which the connection is closed."""
    return JSONResponse({"error": why}, code, headers={"Connection": "close"})
