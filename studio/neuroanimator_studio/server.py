"""The server of the page: on this machine alone, unless somebody asks for more."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from pathlib import Path
from typing import BinaryIO
from urllib.parse import unquote

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from neuroanimator import ArgumentError, NeuroAnimatorError, ResourceError
from neuroanimator.authoring import temporary_folder
from neuroanimator_studio.catalogue import BUNDLE, PROGRAMS, catalogue
from neuroanimator_studio.exports import described_drive
from neuroanimator_studio.guard import Guard, refused
from neuroanimator_studio.live import serve_page
from neuroanimator_studio.requests import read_export
from neuroanimator_studio.single_file import single_page
from neuroanimator_studio.studio import Studio
from neuroanimator_studio.words import public_words, say_unexpected

INDEX = "/index.html"
"""The file of the page that is shown at first."""

DESCENT = "descent"
"""How the names of a bundle's descents begin."""

OTHER_TYPES = {".wasm": "application/wasm", ".js": "text/javascript", ".mjs": "text/javascript"}
"""What browsers insist on, whatever the machine's own table says."""

BYTES = "application/octet-stream"
JSON = "application/json"

BACKLOG = 64
"""Connections that may wait to be taken."""

LAST_WORDS_SECONDS = 5.0
"""Time for a page to take in that its socket is closed [s]."""

Endpoint = Callable[[Request], Awaitable[Response]]


def make_app(studio: Studio) -> ASGIApp:
    """Return the application: everything behind the guard."""
    routes = [
        Route("/catalogue.json", _answering(_catalogue)),
        Route("/bundles/{bundle_id}/{name}", _answering(_bundle_file)),
        Route("/api/downloads/{download_id}", _answering(_download)),
        Route("/api/emulators", _answering(_take_emulator), methods=["POST"]),
        Route("/api/models", _answering(_take_model), methods=["POST"]),
        Route("/api/exports", _answering(_export), methods=["POST"]),
        WebSocketRoute("/live", serve_page),
        Route("/{path:path}", _answering(_page_file)),
    ]
    own_names = Middleware(TrustedHostMiddleware, allowed_hosts=studio.gate.names)
    app = Starlette(routes=routes, middleware=[own_names])
    app.state.studio = studio
    return Guard(app, studio.gate, {"/", *studio.page_files})


def _answering(endpoint: Endpoint) -> Endpoint:
    """Return `endpoint` with whatever goes wrong in it said in one line, without folders and traces."""

    async def answer(request: Request) -> Response:
        try:
            return await endpoint(request)
        except HTTPException as error:
            return refused(error.status_code, error.detail)
        except NeuroAnimatorError as error:
            code = 503 if isinstance(error, ResourceError) else 400
            return refused(code, public_words(str(error)))
        except ClientDisconnect:
            return refused(400, "The connection was closed.")
        except Exception as error:
            return refused(500, say_unexpected(error))

    return answer


def _studio(request: Request) -> Studio:
    return request.app.state.studio


async def _page_file(request: Request) -> Response:
    """Return a file of the page, by its exact path and no other way."""
    path = request.scope["path"]
    if path == "/":
        path = INDEX
    file = _studio(request).page_files.get(path)
    if file is None:
        raise HTTPException(404, "There is nothing here.")
    return _file(file)


async def _catalogue(request: Request) -> Response:
    return JSONResponse(catalogue(_studio(request).library.bundles(), has_server=True))


async def _bundle_file(request: Request) -> Response:
    name = request.path_params["name"]
    folder = _studio(request).library.folder_of(request.path_params["bundle_id"])
    if folder is None or name not in served_files(folder):
        raise HTTPException(404, "There is nothing here.")
    return _file(folder / name)


def served_files(folder: Path) -> list[str]:
    """Return the names of the files of a bundle that the page may want."""
    descents = [path.name for path in sorted(folder.glob(f"{DESCENT}*.wasm"))]
    return [name for name in (BUNDLE, *PROGRAMS, *descents) if (folder / name).is_file()]


async def _download(request: Request) -> Response:
    download = _studio(request).downloads.find(request.path_params["download_id"])
    if download is None:
        raise HTTPException(404, "This file is gone. Export it again.")
    return FileResponse(download.path, media_type=download.media_type, filename=download.name)


def _file(path: Path) -> Response:
    return FileResponse(path, media_type=OTHER_TYPES.get(path.suffix))


async def _take_emulator(request: Request) -> Response:
    """Take an emulator's file, look hard at it, and put it on show."""
    studio = _studio(request)
    _check_type(request, BYTES)
    loop = asyncio.get_running_loop()

    def say(phase: str) -> None:
        loop.call_soon_threadsafe(studio.tell_pages, {"event": "emulator", "phase": phase})

    with temporary_folder() as folder:
        file = folder / "dropped.emulator.safetensors"
        with open(file, "wb") as target:
            await _receive(request, studio.limits.upload_bytes, target)
        bundle_id = await studio.in_making(lambda: studio.library.add(file, say))
    studio.tell_pages({"event": "catalogue"})
    return JSONResponse({"id": bundle_id})


async def _take_model(request: Request) -> Response:
    """Take a MuJoCo model, look at it, and say what a training of it would be."""
    studio = _studio(request)
    _check_type(request, BYTES)
    content = await _body(request)
    name = unquote(request.headers.get("x-name", ""))
    return JSONResponse(await studio.in_making(lambda: studio.models.add(content, name)))


async def _export(request: Request) -> Response:
    studio = _studio(request)
    _check_type(request, JSON)
    content = await _body(request)
    try:
        wanted = await asyncio.to_thread(read_export, content, studio.limits.body_bytes)
    except ArgumentError:
        raise
    except (ValueError, RecursionError) as error:
        raise HTTPException(400, f"The request cannot be read: {error}.") from None

    def write() -> str:
        shown = studio.library.load(wanted.bundle)
        folder = studio.library.folder_of(wanted.bundle)
        if wanted.format == "html" and folder is not None:
            drive = described_drive(shown, wanted, studio.limits)
            return studio.downloads.keep(single_page(studio.page_files, folder, drive), wanted)
        return studio.downloads.write(shown, wanted, studio.limits)

    return JSONResponse({"download": await studio.in_exporting(write)})


async def _body(request: Request) -> bytes:
    """Return a body of a size that memory bears."""
    with tempfile.TemporaryFile() as file:
        await _receive(request, _studio(request).limits.body_bytes, file)
        file.seek(0)
        return file.read()


def _check_type(request: Request, wanted: str) -> None:
    """Refuse a body that says it is something else: a form of a foreign page cannot say what we want."""
    given = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if given != wanted:
        raise HTTPException(415, f"Wanted {wanted}.")


async def _receive(request: Request, most: int, target: BinaryIO) -> None:
    """Write the body to `target` piece by piece; refuse what is too large or comes too slowly."""
    limits = _studio(request).limits
    too_large = HTTPException(413, f"Wanted at most {most:,} bytes.")
    declared = request.headers.get("content-length", "0")
    if not declared.isdecimal() or int(declared) > most:
        raise too_large
    size = 0
    try:
        async for chunk in _patiently(request.stream(), limits.chunk_seconds, limits.body_seconds):
            size += len(chunk)
            if size > most:
                raise too_large
            target.write(chunk)
    except TimeoutError:
        raise HTTPException(408, "The file came too slowly. Try again.") from None


async def _patiently(
    stream: AsyncIterator[bytes], chunk_seconds: float, body_seconds: float
) -> AsyncIterator[bytes]:
    """Yield the pieces of a body; TimeoutError if one of them, or all together, do not come in time.

    No `asyncio.timeout` around it: before Python 3.12 `wait_for` swallows a cancellation that comes with its result.
    """
    clock = asyncio.get_running_loop().time
    end = clock() + body_seconds
    while True:
        try:
            yield await asyncio.wait_for(anext(stream), min(chunk_seconds, end - clock()))
        except StopAsyncIteration:
            return


class PatientProtocol(H11Protocol):
    """HTTP, but for those who take for ever to say what they want, and for too many at once."""

    header_seconds = 10.0
    most = 100

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection; close it again if nothing whole is asked in time."""
        super().connection_made(transport)
        if len(self.connections) > self.most:
            transport.abort()
            return
        self._wait_for_head()

    def on_response_complete(self) -> None:
        """Wait for the next request no longer than for the first."""
        super().on_response_complete()
        self._wait_for_head()

    def _wait_for_head(self) -> None:
        self.loop.call_later(self.header_seconds, self._check_head, self.cycle)

    def _check_head(self, cycle: object) -> None:
        """Close the connection if nothing was asked since `cycle`, what was asked last."""
        is_here = self.transport.get_protocol() is self
        if is_here and self.cycle is cycle and not self.transport.is_closing():
            self.transport.close()


class PatientSocket(WebSocketsSansIOProtocol):
    """A WebSocket, but that it is cut where nobody takes in its last words."""

    async def run_asgi(self) -> None:
        """Talk, and see to it that the connection ends."""
        await super().run_asgi()
        self.loop.call_later(LAST_WORDS_SECONDS, self.transport.abort)


class Server(uvicorn.Server):
    """uvicorn's, but that it leaves signals to the command line: Ctrl-C ends it as it ends every verb."""

    def __init__(self, config: uvicorn.Config, studio: Studio):
        super().__init__(config)
        self._studio = studio

    async def serve(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve, and watch the trainings."""
        watching = asyncio.create_task(self._studio.watch_jobs())
        try:
            await super().serve(sockets)
        finally:
            watching.cancel()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none."""
        yield


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens; ResourceError where that cannot be, such as at a port in use."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except OSError as error:
        raise ArgumentError(
            f"host: there is no '{host}' on this machine. Leave --host out."
        ) from error
    listener = socket.socket(family, kind, protocol)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(address)
        listener.listen(BACKLOG)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            raise ResourceError(
                f"Port {port} is in use. Leave --port out for one that is free, or name another."
            ) from error
        raise ResourceError(
            f"Could not listen on {host}, port {port}: {error.strerror}."
        ) from error
    return listener


def make_server(studio: Studio) -> Server:
    """Return the server of `studio`, which `serve` on a socket that listens."""
    limits = studio.limits
    attributes = {"header_seconds": limits.header_seconds, "most": limits.connections}
    protocol = type("Protocol", (PatientProtocol,), attributes)
    config = uvicorn.Config(
        make_app(studio),
        http=protocol,
        ws=PatientSocket,
        ws_max_size=limits.message_bytes,
        ws_per_message_deflate=False,
        lifespan="off",
        loop="asyncio",
        log_config=None,
        log_level="critical",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=1,
        h11_max_incomplete_event_size=1 << 16,
    )
    return Server(config, studio)
