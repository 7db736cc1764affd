"""What the server does for its own page: files, bundles, replays, verdicts, exports, emulators dropped on it."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from serving import Serving, ask_page, serving, write_page
from waiting import PATIENCE, wait_until
from websockets import Subprotocol
from websockets.sync.client import connect
from websockets.typing import Origin

import neuroanimator as na
from neuroanimator.cli import studio as studio_verb
from neuroanimator.export.csv_file import read_clip
from neuroanimator.files.zoo import find_emulator, shipped_policy
from neuroanimator_studio import run
from neuroanimator_studio.bundle import load_models
from neuroanimator_studio.catalogue import (
    EXAMPLE_BUNDLES,
    PHYSICS_BUNDLES,
    SHIPPED_BUNDLES,
    shipped_bundles,
    shipped_folder,
)
from neuroanimator_studio.description import packed, unpacked
from neuroanimator_studio.library import Library
from neuroanimator_studio.static_site import export_site
from neuroanimator_studio.studio import page_files


def bundle(name: str) -> dict[str, Any]:
    return json.loads((shipped_folder() / name / "bundle.json").read_text())


def test_the_page_and_the_bundles_are_served_as_what_they_are(studio: Serving):
    assert studio.ask("/").headers["content-type"].startswith("text/html")
    assert studio.ask("/index.html").body == studio.ask("/").body
    assert studio.ask("/assets/main.js").headers["content-type"].startswith("text/javascript")
    described = studio.ask("/catalogue.json").json
    assert described["has_server"]
    bundles = [*SHIPPED_BUNDLES, *PHYSICS_BUNDLES, *EXAMPLE_BUNDLES]
    assert [row["id"] for row in described["entries"]][: len(bundles)] == bundles
    for row in described["entries"][:2]:
        facts = studio.ask(f"/{row['bundle']}bundle.json")
        assert facts.json["system"] == row["system"]
        program = studio.ask(f"/{row['bundle']}{facts.json['emulator']}")
        assert program.headers["content-type"] == "application/wasm"
        assert program.body[:4] == b"\0asm"


def test_a_replay_is_what_the_physics_does(studio: Serving):
    facts = bundle("lander-50")
    motion = facts["default_motion"]
    with studio.page() as page:
        answer = ask_page(page, do="replay", bundle="lander-50", **motion)
    states = unpacked(answer["states"], "<f4").reshape(-1, 13)
    system = na.load_system("lander")
    held = system.bounds.clip(np.array(motion["controls"]))
    wanted = system.simulate(np.array(motion["start"])[None], held[None], facts["dt"])
    np.testing.assert_allclose(states, wanted.states[0], atol=1e-4)
    assert answer["wall_s"] > 0
    assert answer["physics_steps"] == len(held) * facts["substeps"]


def test_what_reaches_the_goal_on_the_physics_is_judged_a_success(studio: Serving):
    motion = bundle("lander-50")["default_motion"]
    with studio.page() as page:
        replayed = ask_page(page, do="replay", bundle="lander-50", **motion)
        judged = ask_page(
            page, do="judge", bundle="lander-50", goal="pad", states=replayed["states"]
        )
        assert judged["is_success"]
        assert judged["gap"] < 0.3
        moved = ask_page(
            page,
            do="judge",
            bundle="lander-50",
            goal="pad",
            states=replayed["states"],
            target=[2, 0, 1.95],
        )
    assert not moved["is_success"]
    assert moved["gap"] == pytest.approx(2, abs=0.3)
    assert "root.position is off by" in moved["words"]


def test_a_swimmer_is_judged_by_where_it_is(studio: Serving):
    facts = bundle("fish-50")
    at = np.array(facts["goals"][0]["movable"]["at"])
    emulator = na.load_emulator("fish-50")
    state = np.array(facts["goals"][0]["start"])
    position = np.asarray(na.read_pose(emulator.state_structure, state).position)
    with studio.page() as page:
        answer = ask_page(
            page,
            do="judge",
            bundle="fish-50",
            goal="target",
            target=at.tolist(),
            states=packed(state, "<f4"),
        )
        there = ask_page(
            page,
            do="judge",
            bundle="fish-50",
            goal="target",
            target=position.tolist(),
            states=[state.tolist()],
        )
    assert answer["gap"] == pytest.approx(np.linalg.norm(at - position), abs=1e-4)
    assert not answer["is_success"]
    assert there["is_success"]


def exported(studio: Serving, name: str, kind: str, **options: Any) -> bytes:
    motion = bundle(name)["default_motion"]
    request = {"bundle": name, "format": kind, **motion, **options}
    reply = studio.post_json("/api/exports", request)
    assert reply.status == 200, reply.body
    fetched = studio.ask(f"/api/downloads/{reply.json['download']}")
    assert f'filename="{name}.{kind}"' in fetched.headers["content-disposition"]
    return fetched.body


def test_a_motion_is_taken_along_as_glb_with_the_physics_as_its_ghost(studio: Serving):
    content = exported(studio, "lander-50", "glb", ghost=True, rate=24)
    assert content[:4] == b"glTF"
    assert b"ghost" in content


def test_a_motion_is_taken_along_as_usd(studio: Serving):
    assert exported(studio, "pendulum-50", "usda", ghost=True)[:5] == b"#usda"


def test_a_motion_is_taken_along_as_a_table(studio: Serving, tmp_path: Path):
    file = tmp_path / "motion.csv"
    file.write_bytes(exported(studio, "pendulum-50", "csv", rate=60))
    clip = read_clip(file, na.load_emulator("pendulum-50"))
    assert clip.rate == pytest.approx(60)
    np.testing.assert_allclose(
        clip.states[0], bundle("pendulum-50")["default_motion"]["start"], atol=1e-6
    )


def test_a_dropped_emulator_is_there_after_a_restart(tmp_path: Path):
    pytest.importorskip("ziglang")
    pytest.importorskip("wasmtime")
    content = find_emulator("pendulum-passive-50").read_bytes()
    with serving(tmp_path) as studio, studio.page() as page:
        reply = studio.post("/api/emulators", content, "application/octet-stream")
        assert reply.status == 200, reply.body
        events = [json.loads(page.recv(PATIENCE)) for _ in range(4)]
        assert [event.get("phase") for event in events[:2]] == ["reading", "compiling"]
        assert events[-1] == {"event": "catalogue"}
        again = studio.post("/api/emulators", content, "application/octet-stream")
        assert again.json == reply.json
    with serving(tmp_path) as studio:
        last = studio.ask("/catalogue.json").json["entries"][-1]
        assert last["id"] == reply.json["id"]
        facts = studio.ask(f"/{last['bundle']}bundle.json").json
        assert facts["system"] == "pendulum-passive"
        with studio.page() as page:
            answer = ask_page(page, do="replay", bundle=last["id"], **facts["default_motion"])
        assert len(unpacked(answer["states"], "<f4")) == 6 * (
            1 + len(facts["default_motion"]["controls"])
        )


def test_a_policys_file_is_its_emulator_and_what_steers_it(tmp_path: Path):
    emulator, policy = load_models(shipped_policy("fish"))
    assert policy is not None
    assert emulator.system == "fish"
    library = Library(tmp_path)
    (tmp_path / ("0" * 16)).mkdir()
    shutil.copy(shipped_policy("fish"), tmp_path / ("0" * 16) / "emulator.safetensors")
    (tmp_path / ("0" * 16) / "bundle.json").write_text("{}")
    assert library.load("0" * 16).system.name == "fish"


def test_a_walk_is_exported_as_the_page_has_it(studio: Serving):
    facts = bundle("human")
    start = np.array(facts["default_motion"]["start"], np.float32)
    states = np.tile(start, (3, 1))
    states[:, 0] = [0.0, 0.1, 0.2]
    request = {
        "bundle": "human",
        "format": "csv",
        "start": start.tolist(),
        "controls": [[0.0] * 23] * 2,
        "states": packed(states, "<f4"),
    }
    reply = studio.post_json("/api/exports", request)
    assert reply.status == 200, reply.body
    rows = studio.ask(f"/api/downloads/{reply.json['download']}").body.decode().splitlines()
    assert float(rows[-1].split(",")[1]) == pytest.approx(0.2, abs=1e-3)
    nothing = states * 0
    for wrong in (
        "?",
        packed(states[0, :5], "<f4"),
        packed(states * np.nan, "<f4"),
        packed(nothing, "<f4"),
    ):
        for kind in ("csv", "glb"):
            status = studio.post_json(
                "/api/exports", request | {"states": wrong, "format": kind}
            ).status
            assert status < 500, (wrong[:10], kind)


def test_a_site_is_the_same_files_without_a_server(tmp_path: Path):
    page = write_page(tmp_path / "page")
    bundles = shipped_bundles()
    site = tmp_path / "site"
    export_site(page, bundles, site)
    for name, source in page_files(page).items():
        assert (site / name[1:]).read_bytes() == source.read_bytes()
    described = json.loads((site / "catalogue.json").read_text())
    assert not described["has_server"]
    for row in described["entries"]:
        folder = site / row["bundle"]
        facts = json.loads((folder / "bundle.json").read_text())
        assert (folder / facts["emulator"]).is_file()
    export_site(page, bundles, site)  # again: an earlier site is replaced
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine")
    with pytest.raises(na.NeuroAnimatorError, match="is not a site"):
        export_site(page, bundles, tmp_path / "full")
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["thesis.txt"]


PROGRAM = """
import sys
from pathlib import Path
from neuroanimator.cli import studio
from neuroanimator.cli.main import main
from neuroanimator_studio import run
from neuroanimator_studio.bundle import load_models
page = Path(sys.argv.pop())
run.page_folder = lambda: page
main()
"""
"""The command line, with a page of the tests' own: the real one may not be built."""


@contextmanager
def command(
    tmp_path: Path, *arguments: str, browser: Path | None = None
) -> Iterator[subprocess.Popen[str]]:
    """Run the studio, which opens `browser` if there is one."""
    environment = dict(os.environ)
    opening = ["--no-open"]
    if browser is not None:
        environment |= {"BROWSER": f"{browser} %s", "DISPLAY": ":0"}
        opening = []
    page = tmp_path / "page"
    if not page.exists():
        write_page(page)
    with subprocess.Popen(
        # A job in the background inherits 'ignore Ctrl-C', which a terminal's does not.
        [
            "env",
            "--default-signal=INT",
            sys.executable,
            "-c",
            PROGRAM,
            "studio",
            *opening,
            *arguments,
            str(page),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def test_the_command_line_prints_the_address_listens_on_this_machine_alone_and_stops(
    tmp_path: Path,
):
    with command(tmp_path) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        line = process.stdout.readline().strip()
        match = re.fullmatch(r"http://127\.0\.0\.1:(\d+)/#token=[0-9a-f]{32}", line)
        assert match, line + process.stderr.read()
        port = int(match[1])
        with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as connection:
            connection.sendall(f"GET / HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n".encode())
            assert b" 200 " in connection.recv(100)
        table = Path("/proc/net/tcp").read_text() + Path("/proc/net/tcp6").read_text()
        listening = re.findall(rf" ([0-9A-F]+):{port:04X} [0-9A-F:]+ 0A ", table)
        assert listening == ["0100007F"]
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 130
        assert process.stderr.read().strip().endswith("Stopped. No file was left half-written.")


def test_the_browser_is_led_in_by_a_file_that_only_this_user_can_read(tmp_path: Path):
    said = tmp_path / "said"
    browser = tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$@" > {said}.part\nmv {said}.part {said}\n')
    browser.chmod(0o700)
    with command(tmp_path, browser=browser) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        wait_until(said.exists)
        words = said.read_text().strip()
        assert "token" not in words
        assert address.partition("token=")[2] not in words
        entry = Path(words.removeprefix("file://"))
        assert stat.S_IMODE(entry.stat().st_mode) == 0o600
        assert f'content="0; url={address}"' in entry.read_text()
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE)
    assert not entry.exists()


def test_f18_a_hundred_pages_come_and_go_and_leave_no_memory_behind(tmp_path: Path):
    with command(tmp_path) as process:
        assert process.stdout is not None
        address, _, token = process.stdout.readline().strip().partition("/#token=")

        def come_and_go(times: int) -> None:
            socket_address = address.replace("http", "ws", 1) + "/live"
            for _ in range(times):
                with connect(
                    socket_address,
                    origin=Origin(address),
                    compression=None,
                    subprotocols=[Subprotocol(f"token.{token}")],
                ) as page:
                    assert "ready" in str(page.recv(PATIENCE))
                    assert "jobs" in ask_page(page, do="jobs")

        come_and_go(20)
        before = resident_bytes(process.pid)
        come_and_go(100)
        assert resident_bytes(process.pid) < 1.05 * before


def resident_bytes(process: int) -> int:
    """Return how much memory a process holds."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def test_a_port_in_use_is_one_line_and_exit_code_4(tmp_path: Path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with command(tmp_path, "--port", str(port)) as process:
            out, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 4
    assert out == ""
    assert (
        errors
        == f"neuroanimator: Port {port} is in use. Leave --port out for one that is free, or name another.\n"
    )


def test_without_its_page_the_studio_says_how_to_build_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setattr(run, "__file__", str(tmp_path / "run.py"))
    with pytest.raises(na.NeuroAnimatorError, match="make page"):
        studio_verb.run(export=tmp_path / "site")
