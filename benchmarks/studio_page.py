"""Costs of the studio's page: its size, the time to the first picture, the emulator's work per frame, and memory.

python benchmarks/studio_page.py                   ten minutes; results/studio_page.csv
python benchmarks/studio_page.py --minutes 0.5     a shorter test of memory; writes no file
python benchmarks/studio_page.py --soft cape.emulator.safetensors    one soft body, and 100 more; results/studio_soft.csv

Needs Chromium and Playwright. The CPU draws the pictures, as without a graphics card; work is the time that the page
measures around its own calls of WebAssembly, and shows on its panel. The server is started from the shell. For soft
bodies drawing, which a graphics card does, is left out: all of the page's script for a frame counts, including the
emulator's super steps and the transfer to the card.
"""

from __future__ import annotations

import argparse
import gzip
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from playwright.sync_api import Page, sync_playwright

from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.terminal import print_table, progress_bar
from neuroanimator_studio.bundle import make_bundle
from neuroanimator_studio.catalogue import BUNDLE
from neuroanimator_studio.run import page_folder
from neuroanimator_studio.single_file import single_page
from neuroanimator_studio.studio import page_files

SOFT_RESULTS = Path(__file__).parent / "results" / "studio_soft.csv"

COUNTED = """
for (const name of ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"]) {
    WebGL2RenderingContext.prototype[name] = () => undefined;
}
const request = window.requestAnimationFrame.bind(window);
window.images = 0;
window.milliseconds = 0;
window.requestAnimationFrame = (draw) => request((time) => {
    const began = performance.now();
    draw(time);
    window.milliseconds += performance.now() - began;
    window.images += 1;
});
"""
"""Nothing is drawn, and the time that the page's script takes for images is counted."""

RESULTS = Path(__file__).parent / "results" / "studio_page.csv"

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
    command = [str(Path(sys.executable).with_name("neuroanimator")), "studio", "--no-open"]
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


def measure_soft(file: Path) -> list[dict[str, Any]]:
    """Return the rows of the table of an emulator of a soft body, alone and with 100 more."""
    with tempfile.TemporaryDirectory() as folder:
        bundle = make_bundle(str(file), Path(folder) / "bundle")
        facts = json.loads((bundle / BUNDLE).read_text(encoding="ascii"))
        page_file = Path(folder) / "page.html"
        content = single_page(page_files(page_folder()), bundle, facts["default_motion"])
        page_file.write_bytes(content)
        rows = [
            {"what": "one file with page, emulator and surface [MB]", "value": len(content) / 1e6}
        ]
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium_path(), args=ARGUMENTS)
            page = browser.new_page(viewport=WINDOW)
            page.set_default_timeout(PATIENCE_MS)
            page.add_init_script(COUNTED)
            page.goto(page_file.as_uri())
            page.locator("html[data-frames]").wait_for(state="attached")
            page.locator("button.live").click()
            for label, who in (("alone", "one"), ("with 100 more", "101")):
                page.get_by_label("How many more of them").select_option(label=label)
                page.wait_for_timeout(3000)
                rows += script_rows(page, who)
            browser.close()
    return rows


def script_rows(page: Page, who: str) -> list[dict[str, Any]]:
    """Return what the page's script takes for an image if there were 60 a second, and of that the emulator's work [ms]."""
    page.evaluate("window.images = window.milliseconds = 0")
    began = time.perf_counter()
    work = work_at_60(page)
    seconds = time.perf_counter() - began
    spent = page.evaluate("window.milliseconds") / seconds / 60
    pace = page.evaluate("window.images") / seconds
    return [
        {"what": f"script an image at 60 a second, {who} [ms]", "value": round(spent, 3)},
        {"what": f"of that the emulator and its amplitudes, {who} [ms]", "value": round(work, 3)},
        {"what": f"images a second that nothing is drawn of, {who}", "value": round(pace, 1)},
    ]


def chromium_path() -> str:
    """Return where Chromium is."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        sys.exit("Chromium is missing: apt-get install chromium")
    return chromium


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--minutes",
        type=float,
        default=10.0,
        help="how long to watch; other than 10 writes no file",
    )
    parser.add_argument("--soft", type=Path, help="emulator of a soft body: only that is looked at")
    options = parser.parse_args()
    print(describe_machine())
    if options.soft is not None:
        soft_rows = measure_soft(options.soft)
        print_table(soft_rows)
        write_csv(SOFT_RESULTS, soft_rows)
        return
    rows = measure(options.minutes)
    print_table(rows)
    if options.minutes == parser.get_default("minutes"):
        write_csv(RESULTS, rows)


if __name__ == "__main__":
    main()
