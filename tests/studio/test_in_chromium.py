"""In a real browser: hostile names, one file without a server, and a server that goes; `test_page.py` uses it as people do."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from chromium import PATIENCE_MS, browsing, hosting, looking, next_frame
from playwright.sync_api import Browser, Download, Page, ViewportSize, expect
from serving import Serving, serving

from neuroanimator_studio.catalogue import shipped_folder
from neuroanimator_studio.run import page_folder, write_entry
from neuroanimator_studio.static_site import export_site

PENDULUM = shipped_folder() / "pendulum-50"

WITH_PANELS: ViewportSize = {"width": 1000, "height": 320}
"""Wide enough for the panels beside the stage."""

EVIL = "<img src=x onerror=document.title='owned'>"
"""What would run if a name were taken for markup."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with browsing() as opened:
        yield opened


def is_something_drawn(page: Page) -> bool:
    """Whether the stage shows more than one colour before our patience is over: a name is there before its picture."""
    deadline = time.monotonic() + PATIENCE_MS / 1_000
    page.locator("html[data-frames]").wait_for(state="attached", timeout=PATIENCE_MS)
    while time.monotonic() < deadline:
        picture = page.locator("canvas").first.screenshot(timeout=PATIENCE_MS)
        if len(picture) > 4_000:  # of one colour it is a few hundred bytes
            return True
    return False


def with_pendulum_alone(studio: Serving) -> Serving:
    """Return the studio with one bundle on show, the one that is drawn soonest: a sea takes a processor seconds."""
    studio.studio.library.bundles = lambda: [PENDULUM]
    return studio


def test_one_file_shows_a_motion_without_any_server(browser: Browser, tmp_path: Path):
    drive = json.loads((PENDULUM / "bundle.json").read_text())["default_motion"]
    request = {"bundle": PENDULUM.name, "format": "html", **drive}
    with serving(tmp_path, page=page_folder()) as studio:
        reply = studio.post_json("/api/exports", request)
        assert reply.status == 200, reply.body
        content = studio.ask(f"/api/downloads/{reply.json['download']}").body
    file = tmp_path / "motion.html"
    file.write_bytes(content)
    with looking(browser) as look:
        look.page.goto(file.as_uri())
        shown = look.page.locator('nav button[aria-current="true"]')
        expect(shown).to_have_text("Pendulum", timeout=PATIENCE_MS)
        assert is_something_drawn(look.page)
        assert look.complaints == []
        assert all(url == file.as_uri() or url.startswith(("blob:", "data:")) for url in look.asked)


def test_a_private_file_leads_a_browser_in_and_leaves_no_token_in_its_reach(
    browser: Browser, tmp_path: Path
):
    with serving(tmp_path, page=page_folder()) as studio, looking(browser) as look:
        gate = with_pendulum_alone(studio).gate
        page = look.page
        page.goto(write_entry(gate).as_uri())
        shown = page.locator('nav button[aria-current="true"]')
        expect(shown).to_have_text("Pendulum", timeout=PATIENCE_MS)
        expect(page.locator(".banner.error")).to_have_count(0)
        assert gate.token not in page.url
        within_reach = "document.cookie + document.referrer + JSON.stringify({...localStorage})"
        assert gate.token not in page.evaluate(within_reach)
        assert page.context.cookies() == []
        page.reload()
        expect(shown).to_have_text("Pendulum", timeout=PATIENCE_MS)
        assert look.complaints == []


def test_s04_a_page_of_another_port_reads_and_changes_nothing(browser: Browser, tmp_path: Path):
    """To a browser all ports of a machine are one site, which has the cookies of all: so there are none."""
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "index.html").write_text("<!doctype html>")
    ask = """async ([address, options]) => {
        try { return (await (await fetch(address, options)).text()) } catch { return "refused" }
    }"""
    open_socket = """([address, said]) => new Promise((resolve) => {
        const socket = new WebSocket(address, said);
        socket.onmessage = () => resolve("open");
        socket.onerror = () => resolve("refused");
    })"""
    with (
        serving(tmp_path) as studio,
        hosting(tmp_path / "other") as other,
        looking(browser) as look,
    ):
        told = {"headers": studio.token}
        own = [f"token.{studio.gate.token}"]
        look.page.goto(f"{studio.origin}/")
        assert "entries" in look.page.evaluate(ask, ["/catalogue.json", told])
        assert look.page.evaluate(open_socket, ["/live", own]) == "open"
        look.page.goto(other)
        assert look.page.evaluate("document.cookie + sessionStorage.length") == "0"
        for path, options in (
            ("/catalogue.json", told),
            ("/catalogue.json", {"mode": "no-cors"}),
            ("/api/exports", {"mode": "no-cors", "method": "POST"}),
        ):
            said = look.page.evaluate(ask, [studio.origin + path, options])
            assert said in ("refused", ""), (path, options)
        address = studio.origin.replace("http", "ws", 1) + "/live"
        assert look.page.evaluate(open_socket, [address, own]) == "refused"
        assert look.page.evaluate(open_socket, [address, []]) == "refused"


def take(page: Page, label: str) -> bytes:
    """Press a button of "Export" and return the file that comes."""
    with page.expect_download(timeout=PATIENCE_MS) as download:
        page.locator("button", has_text=re.compile(f"^{label}$")).click()
    return download.value.path().read_bytes()


def test_a_person_leaves_with_a_file_of_every_kind(browser: Browser, tmp_path: Path):
    with serving(tmp_path, page=page_folder()) as studio, looking(browser) as look:
        page = look.page
        page.set_viewport_size(WITH_PANELS)
        page.goto(with_pendulum_alone(studio).gate.url)
        expect(page.locator('nav button[aria-current="true"]')).to_be_visible(timeout=PATIENCE_MS)
        for key in (".", ".", ".", ".", "l", "Space"):
            page.keyboard.press(key)
        page.locator("summary", has_text="Export").click()
        assert take(page, "CSV").startswith(b"time s,angle[0] rad,")
        assert take(page, "Controls").startswith(b"time s,torque[0] ")
        assert take(page, "GLB").startswith(b"glTF")
        assert take(page, "USDA").startswith(b"#usda 1.0")
        assert b"<!doctype html>" in take(page, "HTML")[:100].lower()
        assert page.locator(".banner.error").count() == 0
        assert look.complaints == []


def pictures_of(film: Path) -> np.ndarray:
    """Return all pictures (F, H, W, 3) of a film of 1280 x 720."""
    decode = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(film)]
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    content = subprocess.run([*decode, *raw], capture_output=True, check=True).stdout
    return np.frombuffer(content, np.uint8).reshape(-1, 720, 1280, 3).astype(np.float32)


def said_of(film: Path) -> bytes:
    """Return what ffmpeg says of a film."""
    ask = [imageio_ffmpeg.get_ffmpeg_exe(), "-hide_banner", "-i", str(film)]
    return subprocess.run(ask, capture_output=True).stderr


WITHOUT_H264 = """
const ask = VideoEncoder.isConfigSupported;
VideoEncoder.isConfigSupported = (config) =>
    config.codec.startsWith("avc") ? Promise.resolve({ supported: false, config }) : ask.call(VideoEncoder, config);
"""
"""Makes the browser one that has no licence for H.264."""


@pytest.mark.parametrize(
    ("prelude", "start"),
    [
        ("", b"ftyp"),
        pytest.param(WITHOUT_H264, b"\x1aE\xdf\xa3", marks=pytest.mark.endurance),
    ],
)
def test_the_page_films_what_it_shows_itself_at_an_even_rate(
    prelude: str, start: bytes, browser: Browser, tmp_path: Path
):
    facts = json.loads((PENDULUM / "bundle.json").read_text())
    steps = 5
    film = tmp_path / "film"
    export_site(page_folder(), [PENDULUM], tmp_path / "site")
    with hosting(tmp_path / "site") as site, looking(browser) as look:
        page = look.page
        page.add_init_script(prelude)
        page.set_viewport_size(WITH_PANELS)
        page.goto(site)
        assert is_something_drawn(page)
        page.keyboard.press("Home")
        for key in (*("." * steps), "l", "Space"):
            page.keyboard.press(key)
        next_frame(page, PATIENCE_MS)
        # Live, it may have gone on for a super step before it was paused.
        seconds = float(page.locator(".timeline .scrub").get_attribute("max") or 0)
        assert seconds >= steps * facts["dt"]
        page.locator("summary", has_text="Export").click()
        film.write_bytes(take(page, "Film"))
        expect(page.locator("dialog progress")).to_have_count(0)
        assert page.locator(".banner.error").count() == 0
        assert look.complaints == []
    assert start in film.read_bytes()[:8]
    pictures = pictures_of(film)
    assert len(pictures) == 1 + int(30 * seconds + 1e-6)
    assert b" 1280x720" in said_of(film)
    assert pictures[0].std() > 10
    changes = np.abs(np.diff(pictures, axis=0)).max(axis=(1, 2, 3))
    assert changes.min() > 30


@pytest.mark.endurance
def test_a_film_is_cancelled_by_a_key_and_leaves_nothing(browser: Browser, tmp_path: Path):
    export_site(page_folder(), [PENDULUM], tmp_path / "site")
    with hosting(tmp_path / "site") as site, looking(browser) as look:
        page = look.page
        page.set_viewport_size(WITH_PANELS)
        page.goto(site)
        assert is_something_drawn(page)
        page.locator("summary", has_text="Export").click()
        downloads: list[Download] = []
        page.on("download", lambda download: downloads.append(download))
        page.locator("button", has_text=re.compile("^Film$")).click()
        expect(page.locator("dialog progress")).to_be_visible()
        page.keyboard.press("Escape")
        expect(page.locator("dialog progress")).to_have_count(0, timeout=PATIENCE_MS)
        assert downloads == []
        assert page.locator(".banner").count() == 0
        assert is_something_drawn(page)
        assert look.complaints == []


def test_s08_a_name_that_is_markup_is_shown_as_text(browser: Browser, tmp_path: Path):
    """The loader of emulators refuses such names; the page must not depend on that."""
    folder = tmp_path / "bundles" / ("0" * 16)
    shutil.copytree(PENDULUM, folder)
    facts = json.loads((folder / "bundle.json").read_text())
    facts |= {"id": folder.name, "system": EVIL, "title": EVIL, "about": EVIL}
    for part in (*facts["state"], *facts["control"]):
        part[0] = EVIL
    for bone in facts["skeleton"]:
        bone["name"] = EVIL
    for goal in facts["goals"]:
        goal["name"] = EVIL
    for descent in facts["descents"]:
        descent |= {"name": EVIL, "about": EVIL, "goal": EVIL}
    (folder / "bundle.json").write_text(json.dumps(facts))
    with serving(tmp_path, page=page_folder()) as studio, looking(browser) as look:
        studio.studio.library.bundles = lambda: [folder]
        look.page.goto(studio.gate.url)
        shown = look.page.locator('nav button[aria-current="true"]')
        expect(shown).to_have_text(EVIL, timeout=PATIENCE_MS, ignore_case=True)
        assert is_something_drawn(look.page)
        assert look.page.title() != "owned"
        assert look.page.locator("img[src=x]").count() == 0
        assert not [url for url in look.asked if url.endswith("/x")]
        assert not [line for line in look.complaints if "dialog" in line or "onerror" in line]


def test_when_the_server_goes_the_page_says_so_and_goes_on(browser: Browser, tmp_path: Path):
    with looking(browser) as look:
        with serving(tmp_path, page=page_folder()) as studio:
            look.page.goto(with_pendulum_alone(studio).gate.url)
            assert is_something_drawn(look.page)
        expect(look.page.get_by_text("The server does not answer")).to_be_visible(
            timeout=PATIENCE_MS
        )
        assert is_something_drawn(look.page)
        assert not [line for line in look.complaints if line.startswith("uncaught")]
