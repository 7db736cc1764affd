"""Who may ask the server anything: its own page on this machine, and nobody whom a foreign page sends.

A page of another site can reach a server on this machine, by a form, an image or a name that it makes mean 127.0.0.1.
So every request must name this server as its host, what changes anything must come from this server's page
and say the token, and no answer may be read by, shown in, or run with anything of another site.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
"""The names of this machine that only this machine can mean."""

EVERYWHERE = ("0.0.0.0", "::")
"""What `--host` says to listen on every network."""

TOKEN_BYTES = 16
"""Random bytes of a token: 128 bits."""

SAFE_METHODS = ("GET", "HEAD")
"""Requests that change nothing."""

TOKEN_HEADER = "x-token"
"""Where a request says the token."""

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
        """What to open in a browser: the token is in the fragment, which no request carries."""
        shown = "127.0.0.1" if self.host in EVERYWHERE else self.host
        if ":" in shown:
            shown = f"[{shown}]"
        return f"http://{shown}:{self.port}/#{self.token}"

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the server."""
        return self.host in ("127.0.0.1", "localhost", "::1")

    def is_token(self, said: object) -> bool:
        """Return whether `said` is the token, in a time that says nothing about it."""
        if not isinstance(said, str):
            return False
        return hmac.compare_digest(said.encode("utf-8", "replace"), self.token.encode())

    def is_own_host(self, said: str) -> bool:
        """Return whether a Host header means this server: by a name nobody else can make mean it, and its port."""
        name, _, port = said.rpartition(":")
        if not port.isdecimal() or name == "":  # without a port a browser means 80
            name, port = said, "80"
        if int(port) != self.port:
            return False
        return name.lower() in LOOPBACK or self._is_named_host(name.lower())

    def is_own_origin(self, said: str) -> bool:
        """Return whether an Origin header means a page of this server."""
        scheme, separator, host = said.partition("://")
        return scheme == "http" and separator != "" and self.is_own_host(host)

    def _is_named_host(self, name: str) -> bool:
        """Return whether `name` is what `--host` said; where that is everywhere, an address or this machine's name."""
        if self.is_loopback:
            return False
        if self.host not in EVERYWHERE:
            return name.strip("[]") == self.host.lower()
        return is_address(name.strip("[]")) or name == socket.gethostname().lower()


def is_address(name: str) -> bool:
    """Return whether `name` is an address in numbers, which no foreign name server can make mean another machine."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class Guard:
    """Refuses requests before anything looks at them, and adds `HEADERS` to every answer."""

    def __init__(self, app: ASGIApp, gate: Gate):
        self.app = app
        self.gate = gate

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

        refusal = self._refusal(scope)
        if refusal is not None:
            await refusal(scope, receive, send_with_headers)
            return
        # One part of a file is never wanted, and a thousand parts take long to sort.
        scope["headers"] = [pair for pair in scope["headers"] if pair[0] != b"range"]
        await self.app(scope, receive, send_with_headers)

    def _refusal(self, scope: Scope) -> JSONResponse | None:
        headers = Headers(scope=scope)
        hosts = headers.getlist("host")
        if len(hosts) != 1 or not self.gate.is_own_host(hosts[0]):
            return refused(
                400, "This server answers to its own address only. Open the address it printed."
            )
        is_socket = scope["type"] == "websocket"
        if not is_socket and scope["method"] in SAFE_METHODS:
            return None
        origins = headers.getlist("origin")
        is_own_page = len(origins) == 1 and self.gate.is_own_origin(origins[0])
        if is_socket:
            return None if is_own_page else refused(403, "Only this server's own page may connect.")
        return self._refusal_of_change(headers, is_own_page=is_own_page or not origins)

    def _refusal_of_change(self, headers: Headers, *, is_own_page: bool) -> JSONResponse | None:
        """Return why a request that may change something is refused; a browser always says the origin of one."""
        site = headers.get("sec-fetch-site", "same-origin")
        if not is_own_page or site != "same-origin":
            return refused(403, "Only this server's own page may ask that.")
        if not self.gate.is_token(headers.get(TOKEN_HEADER)):
            return refused(403, "Wrong or missing token. Open the address the server printed.")
        return None


def refused(code: int, why: str) -> JSONResponse:
    """Return an answer that says why not, after which the connection is closed."""
    return JSONResponse({"error": why}, code, headers={"Connection": "close"})


def own_origin(url: str) -> str:
    """Return the origin of `url`, as a browser says it."""
    parts = urlsplit(url)
    return f"{parts.scheme}://{parts.netloc}"
