"""A real browser without a screen, as a person's: Debian's Chromium, driven by Playwright."""

from __future__ import annotations

import functools
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright
from waiting import PATIENCE

from neuroanimator.errors import ResourceError
from neuroanimator_studio.run import page_folder

ARGUMENTS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
"""Nothing is asked of the network, and pictures are drawn without a graphics card."""

PATIENCE_MS = 1000 * int(PATIENCE)
"""Time after which what the page should show is taken as lost [ms]."""

WINDOW: ViewportSize = {"width": 480, "height": 320}
"""Small, for every pixel is computed by the processor."""


STEPPED = """
let now = 0;
let waiting = [];
performance.now = () => now;
window.requestAnimationFrame = (draw) => waiting.push(draw);
window.nextImage = (milliseconds) => {
    now += milliseconds;
    const due = waiting;
    waiting = [];
    due.forEach((draw) => draw(now));
};
"""
"""Makes the page's time go on when it is told, by `nextImage(milliseconds)`: so a slow machine sees as much as a fast one."""


def chromium_path() -> str:
    """Return where Chromium is; skip the tests, with one line, where it is not."""
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        pytest.skip("no Chromium to look at the page with: apt-get install chromium")
    return found


def check_page() -> None:
    """Skip the tests, with one line, where the page is not built."""
    try:
        page_folder()
    except ResourceError:
        pytest.skip("the studio's page is not built: make page")


@contextmanager
def browsing() -> Iterator[Browser]:
    check_page()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium_path(), args=ARGUMENTS)
        try:
            yield browser
        finally:
            browser.close()


class Looking:
    """A page that is open, and all that it complained of and asked for."""

    def __init__(self, page: Page):
        self.page = page
        self.complaints: list[str] = []
        self.asked: list[str] = []
        page.on("console", self._on_console)
        page.on("pageerror", lambda error: self.complaints.append(f"uncaught: {error}"))
        page.on("request", lambda request: self.asked.append(request.url))
        page.on("dialog", lambda dialog: self.complaints.append(f"dialog: {dialog.message}"))

    def _on_console(self, message: object) -> None:
        kind = getattr(message, "type", "")
        text = getattr(message, "text", "")
        # Software drawing is slow, and Chromium says so of itself.
        if kind in ("error", "warning") and "GPU stall" not in text:
            self.complaints.append(f"{kind}: {text}")


@contextmanager
def looking(
    browser: Browser,
    window: ViewportSize = WINDOW,
    *,
    is_moving: bool = False,
    is_touched: bool = False,
) -> Iterator[Looking]:
    """Open a new window, as of a new person, who wants to see everything move or not, on a phone or not."""
    motion = "no-preference" if is_moving else "reduce"
    context = browser.new_context(
        viewport=window, reduced_motion=motion, has_touch=is_touched, is_mobile=is_touched
    )
    try:
        yield Looking(context.new_page())
    finally:
        context.close()


def enter(page: Page, address: str) -> None:
    """Open the address that the server prints, and wait until the page has the one without the token."""
    page.goto(address)
    page.wait_for_url(lambda url: "token=" not in url)


def next_frame(page: Page, patience: float) -> None:
    """Wait for another picture of the stage, at most `patience` [ms]: what was asked for before is in it."""
    frames = int(page.locator("html").get_attribute("data-frames") or 0)
    another = page.locator(f'html:not([data-frames="{frames}"])')
    another.wait_for(state="attached", timeout=patience)


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
