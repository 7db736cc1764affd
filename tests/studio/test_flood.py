"""Attacks on the local server by size, number and slowness: uploads, sockets, messages, who takes nothing in (S6, S7, S13)."""

from __future__ import annotations

import json
import socket
import time
import tracemalloc
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from io import BytesIO
from pathlib import Path

import pytest
from pydantic import ValidationError
from serving import Serving, ask_page, each, serving, status_of
from tally import Tally
from waiting import PATIENCE, wait_until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

from neuroanimator.errors import ArgumentError
from neuroanimator.files.tables import first_fault
from neuroanimator_studio.limits import Limits
from neuroanimator_studio.requests import Export, read_export

MASK = b"\1\2\3\4"
"""What a browser hides its bytes with, so that no proxy takes them for something else."""

HURRIED = Limits(
    body_seconds=1.0,
    chunk_seconds=0.3,
    header_seconds=0.3,
    connections=20,
    messages_a_second=20,
    messages_at_once=50,
    send_seconds=0.5,
    waiting_messages=8,
)


@pytest.fixture(scope="module")
def hurried(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serving]:
    """A studio that waits for nothing long."""
    with serving(tmp_path_factory.mktemp("hurried"), HURRIED) as running:
        yield running


def head_of_upload(studio: Serving, *lines: str) -> bytes:
    own = [
        "POST /api/emulators HTTP/1.1",
        f"Host: 127.0.0.1:{studio.gate.port}",
        f"Origin: {studio.origin}",
        f"X-Token: {studio.gate.token}",
        "Content-Type: application/octet-stream",
        *lines,
    ]
    return "\r\n".join([*own, "", ""]).encode()


def test_s06_a_body_of_a_gigabyte_is_refused_by_what_it_says_of_itself(studio: Serving):
    with studio.raw(head_of_upload(studio, f"Content-Length: {1 << 30}")) as connection:
        assert status_of(connection) == 413


def test_s06_a_body_that_does_not_say_its_size_is_refused_as_it_grows(tmp_path: Path):
    with serving(tmp_path, Limits(upload_bytes=1 << 20)) as studio:
        connection = studio.raw(head_of_upload(studio, "Transfer-Encoding: chunked"))
        with connection:
            piece = b"10000\r\n" + b"x" * 0x10000 + b"\r\n"
            for _ in range(17):
                connection.sendall(piece)
            assert status_of(connection) == 413
        assert not list(studio.studio.library.folder.iterdir())


def test_s06_a_dripping_body_is_not_waited_for(hurried: Serving, tally: Tally):
    connection = hurried.raw(head_of_upload(hurried, "Content-Length: 1000"))
    with connection:
        connection.sendall(b"x")
        assert status_of(connection) == 408
    connection = hurried.raw(head_of_upload(hurried, "Transfer-Encoding: chunked"))
    with connection:
        for _ in range(int(PATIENCE / 0.1)):  # each in time, all together not
            try:
                connection.sendall(b"1\r\nx\r\n")
            except ConnectionError:
                break
            time.sleep(0.1)
        else:
            pytest.fail("the server waits for a body that drips for ever")
        assert status_of(connection) in (408, 0)
    tally.tried = 2


def test_s06_a_piece_of_a_body_ends_where_it_says(studio: Serving):
    """What a proxy takes for one request must not be two (CVE-2025-43859)."""
    with studio.raw(head_of_upload(studio, "Transfer-Encoding: chunked")) as connection:
        connection.sendall(b"3\r\nabcXX0\r\n\r\n")
        with connection.makefile("rb") as answer:  # head and body may come apart
            assert b"Invalid HTTP request" in answer.read()


def test_s06_a_dripping_head_is_not_waited_for(hurried: Serving):
    with hurried.raw(b"GET / HTTP/1.1\r\nHost: ") as connection:
        assert status_of(connection) == 0
    with hurried.raw() as connection:
        assert status_of(connection) == 0


def test_s06_what_is_no_emulator_is_refused_in_one_line(studio: Serving, tally: Tally):
    bomb = BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb", b"\0" * (8 << 20))
    header = b'{"na":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}'
    files = {
        "nothing": b"",
        "a few bytes": b"1234567",
        "text": b"hello " * 100,
        "a zip bomb": bomb.getvalue(),
        "a header larger than the file": (1 << 40).to_bytes(8, "little") + b"{}",
        "no metadata": len(header).to_bytes(8, "little") + header + b"\0" * 4,
        "a picture": b"\x89PNG\r\n\x1a\n" + b"\0" * 1000,
        "a program": b"\x7fELF" + b"\0" * 1000,
    }
    for name, content in each(tally, list(files.items())):
        reply = studio.post("/api/emulators", content, "application/octet-stream")
        assert reply.status == 400, name
        assert reply.json["error"].startswith("The file "), (name, reply.json)
    wrong = studio.post("/api/emulators", b"x", "model/gltf-binary")
    assert wrong.status == 415
    assert not list(studio.studio.library.folder.iterdir())


def closed_with(page: ClientConnection) -> int | None:
    """Read until the socket is closed; return with which code."""
    with suppress(ConnectionClosed):
        while True:
            page.recv(PATIENCE)
    return page.close_code


def raw_page(studio: Serving) -> socket.socket:
    """Open a page byte by byte."""
    connection = studio.raw_socket()
    came = b""
    while b"ready" not in came:
        came += connection.recv(1000)
        assert b" 101 " in came
    return connection


def test_s07_a_message_of_sixteen_megabytes_closes_the_socket(studio: Serving):
    with raw_page(studio) as page:
        # What it says of itself is enough; nobody waits for the rest.
        page.sendall(b"\x81\xff" + (16 << 20).to_bytes(8, "big") + MASK)
        closing = page.recv(1000)
    assert closing[0] == 0x88
    assert int.from_bytes(closing[2:4], "big") == 1009


def test_s07_a_flood_of_messages_closes_the_socket(hurried: Serving):
    with hurried.page() as page:
        with suppress(ConnectionClosed):
            for number in range(10_000):
                page.send(f'{{"id": {number}, "do": "nothing"}}')
        assert closed_with(page) == 1008
    with hurried.page() as page:  # and the next one is welcome
        assert "error" in ask_page(page, do="nothing")


def test_s07_no_more_than_eight_sockets_open(tmp_path: Path, tally: Tally):
    with serving(tmp_path) as studio, ExitStack() as stack:
        for _ in range(8):
            stack.enter_context(studio.page())
        for _ in each(tally, range(192)):
            with pytest.raises(InvalidStatus) as refusal:
                studio.socket().close()
            assert refusal.value.response.status_code == 503
        assert studio.ask("/").status == 200


ROWS = {
    "texts": (b"[" + b'"",' * 129 + b'""]', 19_000),
    "nothing": (b"[" + b"null," * 79 + b"null]", 19_000),
}
"""What controls are made of that are not wanted, and how many fit in a request."""


def large_request(filling: str) -> bytes:
    """Return a request of 8 MB, about, that takes long to read."""
    if filling == "names":
        return b"{" + b",".join(b'"%d":0' % number for number in range(700_000)) + b"}"
    row, count = ROWS[filling]
    controls = b",".join([row] * count)
    return b'{"bundle":"fish-50","format":"csv","start":[0],"controls":[%s]}' % controls


@pytest.mark.parametrize("filling", ["names", *ROWS])
def test_s07_while_a_large_request_is_read_others_are_answered(filling: str, studio: Serving):
    request = large_request(filling)
    longest = 0.0
    with ThreadPoolExecutor(1) as pool:
        reply = pool.submit(studio.post, "/api/exports", request, "application/json")
        while not reply.done():
            began = time.perf_counter()
            assert studio.ask("/").status == 200
            longest = max(longest, time.perf_counter() - began)
            time.sleep(0.02)
    assert reply.result().status == 400
    assert len(reply.result().json["error"]) < 200
    began = time.perf_counter()
    json.loads(request)
    # Python's threads wait for each other while JSON is parsed, but for nothing that takes longer.
    assert longest < 30 * (time.perf_counter() - began)


def test_s07_of_a_million_faults_the_first_is_enough():
    """All of them took half a minute and 3 GB."""
    with pytest.raises(ArgumentError, match=r"^controls\.0\.0: .* got 'None'") as refusal:
        read_export(large_request("nothing"), 8 << 20)
    assert isinstance(refusal.value.__cause__, ValidationError)
    assert refusal.value.__cause__.error_count() == 1


def test_s07_what_is_too_long_is_not_written_out_to_show_its_beginning():
    motion = {"bundle": "fish-50", "format": "csv", "start": [0.0]}
    with pytest.raises(ValidationError) as refusal:
        Export.model_validate({**motion, "controls": [[0.5]] * 1_000_000})
    tracemalloc.start()
    try:
        assert "got '[[0.5], [0.5], " in first_fault(refusal.value)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 100_000


def test_s07_what_is_no_json_closes_the_socket(studio: Serving, tally: Tally):
    request = '{"id": 1, "do": "replay", "bundle": "lander-50", "start": [%s], "controls": [[0]]}'
    messages = [
        "", "nothing", "[1]", "1", "null", "{", '{"id": 1, "id": 2}', "[" * 100_000, '{"a":' * 10_000,
        request % "NaN", request % "Infinity", request % "-Infinity", request % "1e999", request % ("9" * 5_000),
        '{"id": 1, "do": "\\ud800"}',
    ]  # fmt: skip
    for message in each(tally, messages):
        with studio.page() as page:
            page.send(message)
            assert closed_with(page) == 1008, message[:60]
    with studio.page() as page:
        page.send(b"\x00\x01")
        assert closed_with(page) == 1008


def test_s07_json_that_asks_nothing_known_is_answered_with_one_line(studio: Serving, tally: Tally):
    lander = {"do": "replay", "bundle": "lander-50"}
    requests = [
        {},
        {"do": None},
        {"do": "__init__"},
        {**lander},
        {**lander, "start": [], "controls": []},
        {**lander, "start": [0] * 13, "controls": [[0, 0, 0, 0]], "more": 1},
        {**lander, "start": [0] * 12, "controls": [[0, 0, 0, 0]]},
        {**lander, "start": [0] * 13, "controls": [[0, 0, 0]]},
        {**lander, "start": [0] * 13, "controls": [[0, 0, 0, 1e6]]},
        {**lander, "start": "0" * 13, "controls": [[0, 0, 0, 0]]},
        {**lander, "start": [[0]], "controls": [[0, 0, 0, 0]]},
        {**lander, "bundle": "../../secret", "start": [0] * 13, "controls": [[0, 0, 0, 0]]},
        {
            "do": "judge",
            "bundle": "lander-50",
            "goal": "<img onerror=alert(1)>",
            "states": [[0] * 13],
        },
        {"do": "judge", "bundle": "lander-50", "goal": "pad", "states": "!!!"},
        {"do": "judge", "bundle": "lander-50", "goal": "pad", "states": "AAAA"},
    ]
    with studio.page() as page:
        for request in each(tally, requests):
            answer = ask_page(page, **request)
            assert answer.keys() == {"id", "error"}, (request, answer)
            assert answer["id"] == 1, request
            assert len(answer["error"].splitlines()) == 1, request
            assert "secret" not in answer["error"], answer


def test_s13_who_takes_nothing_in_is_left_and_nobody_waits(hurried: Serving):
    fish = {"do": "judge", "bundle": "fish-50", "goal": "target", "target": [0, 0, 0]}
    with raw_page(hurried) as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        wait_until(lambda: hurried.studio.pages)
        # More events than all buffers between here and there hold, and the page reads none of them.
        for _ in range(200):
            hurried.studio.tell_pages({"event": "filler", "text": "x" * 500_000})
            time.sleep(0.005)
        assert hurried.ask("/").status == 200
        with hurried.page() as page:
            assert "gap" in ask_page(page, **fish, states=[[0.0] * 138 + [0.0] * 12])
        wait_until(lambda: not hurried.studio.pages)


def test_s13_half_a_download_holds_up_nobody(studio: Serving):
    request = (
        f"GET /bundles/fish-50/emulator.wasm HTTP/1.1\r\nHost: 127.0.0.1:{studio.gate.port}\r\n"
        f"X-Token: {studio.gate.token}\r\n\r\n"
    )
    with ExitStack() as stack:
        for _ in range(10):
            stack.enter_context(studio.raw(request.encode()))
        assert studio.ask("/bundles/dolphin-50/emulator.wasm").status == 200
