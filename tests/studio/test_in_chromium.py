"""The studio as a person meets it: in a browser, with a server, without one, and when the server goes."""

from __future__ import annotations

import functools
import json
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from chromium import browsing, looking
from playwright.sync_api import Browser, Page, expect
from serving import Serving, serving

from neuroanimator.studio.catalogue import SHIPPED_BUNDLES, shipped_folder
from neuroanimator.studio.run import page_folder
from neuroanimator.studio.static_site import export_site

PENDULUM = shipped_folder() / "pendulum-50"

PATIENCE = 120_000
"""Time a picture may take on a busy machine without a graphics card [ms]."""

EVIL = "<img src=x onerror=document.title='owned'>"
"""What would run if a name were taken for markup."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with browsing() as opened:
        yield opened


def is_something_drawn(page: Page) -> bool:
    """Whether the stage shows more than one colour."""
    picture = page.locator("canvas").first.screenshot(timeout=PATIENCE)
    return len(picture) > 4_000  # of one colour it is a few hundred bytes


def with_pendulum_alone(studio: Serving) -> Serving:
    """Return the studio with one bundle on show, the one that is drawn soonest: a sea takes a processor seconds."""
    studio.studio.library.bundles = lambda: [PENDULUM]
    return studio


def test_every_system_is_drawn_without_a_complaint(browser: Browser, tmp_path: Path):
    with serving(tmp_path, page=page_folder()) as studio, looking(browser) as look:
        page = look.page
        page.goto(studio.gate.url)
        for bundle_id in SHIPPED_BUNDLES:
            button = page.locator(f'nav button[data-id="{bundle_id}"]')
            button.click(timeout=PATIENCE)
            expect(button).to_have_attribute("aria-current", "true", timeout=PATIENCE)
        assert is_something_drawn(page)
        assert look.complaints == []
        assert all(url.startswith((studio.origin, "blob:", "data:")) for url in look.asked)
        assert studio.studio.pages  # it has said its token


def test_a_site_in_a_folder_of_a_web_host_needs_no_server_and_no_other_host(
    browser: Browser, tmp_path: Path
):
    site = tmp_path / "some" / "folder"
    export_site(page_folder(), [PENDULUM], site)
    with hosting(tmp_path) as origin, looking(browser) as look:
        look.page.goto(f"{origin}/some/folder/")
        expect(look.page.locator('nav button[aria-current="true"]')).to_be_visible(timeout=PATIENCE)
        assert is_something_drawn(look.page)
        assert look.complaints == []
        assert all(
            url.startswith((f"{origin}/some/folder/", "blob:", "data:")) for url in look.asked
        )


@contextmanager
def hosting(folder: Path) -> Iterator[str]:
    """Serve a folder as any web host does."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *arguments: object) -> None:  # noqa: A002
            pass

    handler = functools.partial(Quiet, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as host:
        thread = threading.Thread(target=host.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{host.server_address[1]}"
        finally:
            host.shutdown()
            thread.join()


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
        expect(shown).to_have_text(EVIL, timeout=PATIENCE, ignore_case=True)
        assert is_something_drawn(look.page)
        assert look.page.title() != "owned"
        assert look.page.locator("img[src=x]").count() == 0
        assert not [url for url in look.asked if url.endswith("/x")]
        assert not [line for line in look.complaints if "dialog" in line or "onerror" in line]


def test_when_the_server_goes_the_page_says_so_and_goes_on(browser: Browser, tmp_path: Path):
    with looking(browser) as look:
        with serving(tmp_path, page=page_folder()) as studio:
            look.page.goto(with_pendulum_alone(studio).gate.url)
            expect(look.page.locator('nav button[aria-current="true"]')).to_be_visible(
                timeout=PATIENCE
            )
        expect(look.page.get_by_text("The server does not answer")).to_be_visible(timeout=PATIENCE)
        assert is_something_drawn(look.page)
        assert not [line for line in look.complaints if line.startswith("uncaught")]
