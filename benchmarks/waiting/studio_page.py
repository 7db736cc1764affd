"""Costs of the studio's page: its size, the time to the first picture, the emulator's work per frame, and memory.

python -m benchmarks.waiting.studio_page                ten minutes; studio_page.csv
python -m benchmarks.waiting.studio_page --minutes 0.5  a shorter test of memory; writes no file

Needs Chromium and Playwright. The CPU draws the pictures, as without a graphics card; work is the time that the page
measures around its own calls of WebAssembly, and shows on its panel. The server is started from the shell.
"""

from __future__ import annotations

import gzip
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from playwright.sync_api import Page, sync_playwright

from benchmarks.harness import PROGRAM, keep_rows, parser_of, show_rows
from neuroanimator.terminal import progress_bar
from neuroanimator_studio.run import page_folder

RESULTS = Path(__file__).with_name("studio_page.csv")

ARGUMENTS = [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--enable-precise-memory-info",
    "--js-flags=--expose-gc",
]  # fmt: skip

WINDOW = {"width": 1280, "height": 720}

PATIENCE_MS = 120_000

WATCHED_SECONDS = 8.0
"""Time over which the mean work an image is taken [s], a second at a time."""


def page_size() -> int:
    """Return the bytes of the page as a web host sends them, gzipped, without emulators."""
    files = [path for path in page_folder().rglob("*") if path.is_file()]
    return sum(len(gzip.compress(path.read_bytes(), 9)) for path in files)


def start_server() -> tuple[subprocess.Popen[str], str, float]:
    """Return the studio's process, its address, and the seconds until it printed that."""
    command = [str(PROGRAM), "studio", "--no-open"]
    began = time.perf_counter()
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    for line in server.stdout:
        found = re.search(r"http://\S+", line)
        if found:
            return server, found[0], time.perf_counter() - began
    sys.exit("the studio did not start")


def first_picture(page: Page, address: str) -> float:
    """Return the seconds from asking for the page until its first image is drawn."""
    began = time.perf_counter()
    page.goto(address)
    page.locator("html[data-frames]").wait_for(state="attached", timeout=PATIENCE_MS)
    return time.perf_counter() - began


def work_at_60(page: Page) -> float:
    """Return the emulator's work an image [ms] if there were 60 images a second.

    The panel says what it is at the pace at which pictures are drawn here, which is slower, so that one image has more
    super steps to do: that times the images drawn in a second is the work for a second of motion.
    """
    row = page.locator("dt", has_text="emulator's time per frame").locator(
        "xpath=following-sibling::dd"
    )
    before = images(page)
    began = time.perf_counter()
    values = []
    for _ in range(round(WATCHED_SECONDS)):
        page.wait_for_timeout(1000)
        values.append(float(row.first.inner_text().split()[0]))
    pace = (images(page) - before) / (time.perf_counter() - began)
    return sum(values) / len(values) * pace / 60


def images(page: Page) -> int:
    """Return how many images the page has drawn."""
    return int(page.locator("html").get_attribute("data-frames") or 0)


def kept(page: Page) -> float:
    """Return what the page keeps after collecting garbage [MB]."""
    page.evaluate("gc()")
    return page.evaluate("performance.memory.usedJSHeapSize") / 1e6


def growth(page: Page, minutes: float) -> tuple[float, float]:
    """Return what the page keeps at first and at last [MB], playing in between."""
    first = kept(page)
    with progress_bar("watching", round(60 * minutes)) as bar:
        for second in range(round(60 * minutes)):
            page.wait_for_timeout(1000)
            bar.advance_to(second + 1)
    return first, kept(page)


def measure(minutes: float) -> list[dict[str, Any]]:
    """Return the rows of the table."""
    chromium = chromium_path()
    rows = [{"what": "page, gzipped [MB]", "value": page_size() / 1e6, "wanted": "1.5 at most"}]

    def add(what: str, value: float, wanted: str = "") -> None:
        rows.append({"what": what, "value": round(value, 3), "wanted": wanted})

    server, address, seconds = start_server()
    add("from the shell to the address [s]", seconds)
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS)
            page = browser.new_page(viewport=WINDOW)
            page.set_default_timeout(PATIENCE_MS)
            add("first picture, first time [s]", first_picture(page, address), "2 at most")
            page.goto("about:blank")
            add("first picture, again [s]", first_picture(page, address), "2 at most")
            page.evaluate(
                "[...document.querySelectorAll('button')].find(b => b.textContent === 'Fish').click()"
            )
            page.wait_for_timeout(3000)
            page.evaluate(
                "[...document.querySelectorAll('button')].find(b => b.textContent === 'Live').click()"
            )
            page.wait_for_timeout(2000)
            add(
                "emulator's work an image at 60 a second, one fish [ms]",
                work_at_60(page),
                "4 at most",
            )
            page.select_option("select", label="with 1,000 more")
            page.wait_for_timeout(5000)
            add("the same, 1,001 fish [ms]", work_at_60(page), "4 at most")
            first, last = growth(page, minutes)
            add("kept at first [MB]", first)
            add(f"kept {minutes:g} minutes later [MB]", last, "no growth")
            browser.close()
    finally:
        server.terminate()
        server.wait()
    return rows


def chromium_path() -> str:
    """Return where Chromium is."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        sys.exit("Chromium is missing: apt-get install chromium")
    return chromium


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument(
        "--minutes",
        type=float,
        default=10.0,
        help="how long to watch; other than 10 writes no file",
    )
    options = parser.parse_args()
    rows = measure(options.minutes)
    show_rows(rows)
    if options.minutes == parser.get_default("minutes"):
        keep_rows(RESULTS, rows, options)


if __name__ == "__main__":
    main()
