"""Attacks on the local server: other sites' pages, guessed tokens, paths out of the folder, leaks (S1 to S5, S8 to S12)."""

from __future__ import annotations

import os
import socket
import time
from pathlib import Path

import pytest
from serving import Serving, each, serving, status_of
from tally import Tally
from websockets.exceptions import InvalidStatus

from neuroanimator_studio.guard import Gate
from neuroanimator_studio.server import listen
from neuroanimator_studio.words import public_words


def test_s01_another_host_is_refused_on_http_and_on_websocket(studio: Serving, tally: Tally):
    port = studio.gate.port
    hosts = (
        "evil.example",
        f"evil.example:{port}",
        f"127.0.0.1.evil.example:{port}",
        "",
        f"0.0.0.0:{port}",
        f"127.0.0.1@evil.example:{port}",
        f"evil.example:{'9' * 5000}",
    )
    for host in each(tally, hosts):
        reply = studio.ask("/", headers={"Host": host})
        assert reply.status == 400, host
        assert b"title" not in reply.body
        with studio.raw_socket(host, f"http://{host}") as connection:
            assert status_of(connection) == 400, host


def test_s01_its_own_names_are_welcome(studio: Serving):
    for name in ("127.0.0.1", "localhost", "LOCALHOST", "[::1]"):
        assert studio.ask("/", headers={"Host": f"{name}:{studio.gate.port}"}).status == 200


def test_s01_two_hosts_are_none(studio: Serving):
    own = f"127.0.0.1:{studio.gate.port}"
    with studio.raw(f"GET / HTTP/1.1\r\nHost: {own}\r\nHost: {own}\r\n\r\n".encode()) as connection:
        assert b" 400 " in connection.recv(100)


def test_s02_a_socket_of_another_origin_is_refused_before_it_opens(studio: Serving, tally: Tally):
    port = studio.gate.port
    origins = (
        "http://evil.example",
        f"http://evil.example:{port}",
        "null",
        None,
        "http://127.0.0.1:1",
        f"https://127.0.0.1:{port}",
        f"http://localhost.evil.example:{port}",
    )
    for origin in each(tally, origins):
        with pytest.raises(InvalidStatus) as refusal:
            studio.socket(origin).close()
        assert refusal.value.response.status_code == 403, origin


def wrong_tokens(studio: Serving) -> list[str]:
    token = studio.gate.token
    return [token[:-1], token + "0", token.upper() + "x", "", "0" * 32]


def test_s03_without_the_token_no_socket_opens(studio: Serving, tally: Tally):
    for token in each(tally, wrong_tokens(studio)):
        with pytest.raises(InvalidStatus) as refusal:
            studio.socket(token=token).close()
        assert refusal.value.response.status_code == 403, token


def test_s03_without_the_token_nothing_can_be_read_but_the_page_itself(
    studio: Serving, tally: Tally
):
    token = studio.gate.token
    paths = (
        "/nothing",
        "/catalogue.json",
        "/bundles/fish-50/bundle.json",
        "/bundles/fish-50/emulator.wasm",
        "/api/exports",
        f"/catalogue.json?token={token}",
    )
    for path in each(tally, paths):
        for wrong in wrong_tokens(studio):
            reply = studio.ask(path, headers={"X-Token": wrong})
            assert reply.status == 403, (path, wrong)
            assert "set-cookie" not in reply.headers
            assert reply.json == {
                "error": "Wrong or missing token. Open the address the server printed."
            }
    for path in each(tally, ("/", "/index.html", "/assets/main.js")):
        assert studio.ask(path, headers={"X-Token": ""}).status == 200
    assert studio.ask("/api/downloads/x", headers={"X-Token": ""}).status == 404


def test_s03_a_cookie_opens_nothing_so_that_no_other_port_is_told_the_token(
    studio: Serving, tally: Tally
):
    port = studio.gate.port
    for name in each(tally, ("token", "x-token", f"neuroanimator-{port}")):
        said = {"X-Token": "", "Cookie": f"{name}={studio.gate.token}"}
        assert studio.ask("/catalogue.json", headers=said).status == 403


def test_s03_the_address_has_a_token_of_128_bits_where_browsers_keep_it_to_themselves(
    studio: Serving,
):
    address = studio.gate.url.removeprefix(studio.origin)
    assert address == f"/#token={studio.gate.token}"
    assert len(bytes.fromhex(studio.gate.token)) == 16
    assert Gate("127.0.0.1", 1).token != Gate("127.0.0.1", 1).token


@pytest.mark.parametrize("path", ["/api/emulators", "/api/exports"])
def test_s04_what_another_site_can_send_changes_nothing(path: str, studio: Serving, tally: Tally):
    own = {"Origin": studio.origin, "Content-Type": "application/json"}
    attacks = {
        "form": own | {"Content-Type": "application/x-www-form-urlencoded"},
        "plain text": own | {"Content-Type": "text/plain"},
        "no type": own | {"Content-Type": ""},
        "other site": own | {"Origin": "http://evil.example"},
        "no origin": {"Content-Type": "application/json"},
        "no origin to say": own | {"Origin": "null"},
        "another port": own | {"Origin": "http://127.0.0.1:1"},
        "another of its names": own | {"Origin": f"http://localhost:{studio.gate.port}"},
        "a port of 5,000 digits": own | {"Origin": f"http://127.0.0.1:{'1' * 5000}"},
        "no token": own | {"X-Token": ""},
        "wrong token": own | {"X-Token": "0" * 32},
    }
    before = studio.ask("/catalogue.json").body
    for name, headers in each(tally, list(attacks.items())):
        assert studio.ask(path, "POST", b"{}", headers).status in (403, 415), name
    for method in each(tally, ["GET", "PUT", "DELETE", "PATCH", "OPTIONS"]):
        assert studio.ask(path, method, headers=own).status in (403, 404, 405), method
    assert studio.ask("/catalogue.json").body == before


OUTSIDE = (
    "/../secret", "/%2e%2e/secret", "/..%2fsecret", "/%252e%252e/secret", "/assets/../../secret", "/..\\secret",
    "/%5c..%5csecret", "/assets/main.js%00.html", "/%00", "//etc/passwd", "/etc/passwd", "/C:/secret", "/C:%5csecret",
    "/%5c%5chost%5cshare", "/link.txt", "/folder/secret", "/bundles/..%2f..%2fsecret/bundle.json", "/bundles/../secret",
    "/bundles/fish-50/..%2f..%2fsecret", "/bundles/fish-50/__init__.py", "/bundles/%2e%2e/catalogue.py",
    "/api/downloads/..%2f..%2fsecret", "/api/downloads/secret", "/.", "/index.html/", "/assets", "/assets/",
    "/bundles/fish-50/emulator.safetensors", "http://127.0.0.1/etc/passwd",
)  # fmt: skip


def test_s05_no_path_leads_out_of_the_page(tmp_path: Path, tally: Tally):
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "page").mkdir()
    outside = tmp_path / "elsewhere"
    outside.mkdir()
    (outside / "secret").write_text("secret")
    os.symlink(tmp_path / "secret", tmp_path / "page" / "link.txt")
    os.symlink(outside, tmp_path / "page" / "folder")
    with serving(tmp_path) as studio:
        for path in each(tally, OUTSIDE):
            reply = studio.ask(path)
            assert reply.status == 404, path
            assert b"secret" not in reply.body, path
        assert studio.ask("/assets/main.js").status == 200


def test_s08_nothing_on_the_page_runs_that_is_not_its_own(studio: Serving):
    policy = studio.ask("/").headers["content-security-policy"]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'self'"
    assert rules["script-src"] == "'self' 'wasm-unsafe-eval'"
    assert rules["frame-ancestors"] == "'none'"
    assert rules["object-src"] == "'none'"
    assert "http" not in policy


def test_s09_every_answer_has_the_headers_and_none_lets_other_sites_in(
    studio: Serving, tally: Tally
):
    paths = (
        "/",
        "/assets/main.js",
        "/catalogue.json",
        "/bundles/fish-50/emulator.wasm",
        "/nothing",
        "/api/exports",
    )
    for path in each(tally, paths):
        for host in (f"127.0.0.1:{studio.gate.port}", "evil.example"):
            headers = studio.ask(
                path, headers={"Host": host, "Origin": "http://evil.example"}
            ).headers
            assert headers["cross-origin-opener-policy"] == "same-origin", path
            assert headers["cross-origin-embedder-policy"] == "require-corp"
            assert headers["cross-origin-resource-policy"] == "same-origin"
            assert headers["referrer-policy"] == "no-referrer"
            assert headers["x-content-type-options"] == "nosniff"
            assert "content-security-policy" in headers
            assert not [name for name in headers if name.startswith("access-control")]
            assert "server" not in headers
            assert "set-cookie" not in headers


def test_s10_a_hundred_thousand_ranges_take_no_time(studio: Serving):
    ranges = "bytes=" + ",".join(f"{start}-" for start in range(8_000))
    assert studio.ask("/bundles/fish-50/emulator.wasm").status == 200
    seconds: dict[str, list[float]] = {ranges: [], "bytes=0-": []}
    for _ in range(5):
        for asked, spans in seconds.items():
            began = time.perf_counter()
            reply = studio.ask("/bundles/fish-50/emulator.wasm", headers={"Range": asked})
            spans.append(time.perf_counter() - began)
            assert reply.status == 200
    # Sorted, thousands of ranges would take hundreds of times as long as one.
    assert min(seconds[ranges]) < 30 * min(seconds["bytes=0-"])
    head = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{studio.gate.port}\r\nRange: bytes="
    with studio.raw(head.encode() + b"0-," * 100_000 + b"\r\n\r\n") as connection:
        assert b" 200 " not in first_line(connection)  # a head that large is none


def first_line(connection: socket.socket) -> bytes:
    """Return how the answer begins; nothing if the connection was cut."""
    try:
        return connection.recv(100)
    except ConnectionError:
        return b""


def test_s11_errors_say_no_paths_no_traces_and_nothing_of_the_surroundings(
    studio: Serving, tally: Tally
):
    own = studio.studio.library.folder
    replies = [
        studio.ask("/nothing"),
        studio.post("/api/emulators", b"junk", "application/octet-stream"),
        studio.post("/api/exports", b"junk", "application/json"),
        studio.post_json("/api/exports", {"bundle": "nothing"}),
        studio.post_json(
            "/api/exports", {"bundle": "nothing", "format": "glb", "start": [1], "controls": [[1]]}
        ),
    ]
    for reply in each(tally, replies):
        assert reply.status in (400, 404)
        text = reply.body.decode()
        assert "Traceback" not in text
        assert ".py" not in text
        assert str(own) not in text
        assert str(Path.home()) not in text
        assert "/tmp" not in text
        assert len(reply.json["error"].splitlines()) == 1
        assert "/" not in reply.json["error"].replace("application/octet-stream", "")


def test_s11_folders_are_cut_out_of_messages():
    said = "Could not write /home/anna/.cache/x y/bundle.json: no space; see https://a/b and 3 m/s."
    assert (
        public_words("Could not write /home/anna/cache/bundle.json: full")
        == "Could not write bundle.json: full"
    )
    assert "anna" not in public_words(said)
    assert "m/s" in public_words(said)


def test_s12_only_this_machine_is_listened_to(studio: Serving):
    listener = listen("127.0.0.1", 0)
    with listener:
        assert listener.getsockname()[0] == "127.0.0.1"
        hexadecimal = f"0100007F:{listener.getsockname()[1]:04X}"
        assert hexadecimal in Path("/proc/net/tcp").read_text()
    with pytest.raises(OSError, match="refused|unreachable"):
        socket.create_connection(("127.0.0.2", studio.gate.port), timeout=5)


def test_s12_on_all_networks_the_token_and_the_pages_own_address_are_still_asked_for(
    tmp_path: Path, tally: Tally
):
    with serving(tmp_path, host="0.0.0.0") as studio:
        port = studio.gate.port
        assert not studio.gate.is_loopback
        for host in each(tally, ["192.168.1.7", "127.0.0.1", "workshop.example", "[::1]"]):
            asked = {"Host": f"{host}:{port}"}
            assert studio.ask("/catalogue.json", headers=asked).status == 200
            assert studio.ask("/catalogue.json", headers=asked | {"X-Token": ""}).status == 403
            for origin in (host, "6.6.6.6", "evil.example"):  # all at the same port
                with studio.raw_socket(asked["Host"], f"http://{origin}:{port}") as connection:
                    wanted = 101 if origin == host else 403
                    assert status_of(connection) == wanted, (host, origin)


def test_s12_a_network_of_its_own_is_asked_by_its_own_name():
    assert Gate("192.168.1.7", 81).names == ["192.168.1.7"]
    assert Gate("fe80::1", 81).names == ["[fe80::1]"]
    assert Gate("fe80::1", 81).url.startswith("http://[fe80::1]:81/#token=")
    assert Gate("0.0.0.0", 81).url.startswith("http://127.0.0.1:81/#token=")
