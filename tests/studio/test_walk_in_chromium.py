"""In a real browser: a human walks on command at the first press, turns the way of the arrow keys, and does not fall."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
from chromium import PATIENCE_MS, STEPPED, browsing, hosting, looking
from playwright.sync_api import Page, ViewportSize, expect

from neuroanimator_studio.catalogue import shipped_folder
from neuroanimator_studio.run import page_folder
from neuroanimator_studio.static_site import export_site

WINDOW: ViewportSize = {"width": 1000, "height": 320}
"""With panels beside the stage."""

PHONE: ViewportSize = {"width": 390, "height": 760}

IMAGE = 0.25
"""Time between two pictures [s]: the longest that the page makes up for."""

LEAST_HEIGHT = 0.6
"""Height of the pelvis below which a body has fallen [m]."""


def let_time_go(page: Page, seconds: float) -> None:
    for _ in range(round(seconds / IMAGE)):
        page.evaluate(f"nextImage({1000 * IMAGE})")


def hold(page: Page, key: str, seconds: float) -> None:
    page.keyboard.down(key)
    let_time_go(page, seconds)
    page.keyboard.up(key)


def states_of(file: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (T,) [s], heights (T,) [m] and headings (T,) [rad] of the root in a table of the page."""
    head, *rows = csv.reader(file.read_text().splitlines())
    numbers = np.array(rows, float)

    def column(name: str) -> np.ndarray:
        (number,) = (place for place, title in enumerate(head) if title.startswith(name))
        return numbers[:, number]

    w, x, y, z = (column(f"root.orientation[{number}]") for number in range(4))
    headings = np.unwrap(np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)))
    return column("time"), column("root.position[2]"), headings


def test_a_human_goes_where_arrow_keys_say_and_ten_others_go_their_ways(tmp_path: Path):
    export_site(page_folder(), [shipped_folder() / "human"], tmp_path / "site")
    with (
        browsing() as browser,
        hosting(tmp_path / "site") as site,
        looking(browser, WINDOW, is_moving=True) as look,
    ):
        page = look.page
        page.add_init_script(STEPPED)
        page.goto(site)
        page.locator("html[data-frames]").wait_for(state="attached", timeout=PATIENCE_MS)
        let_time_go(page, 4)
        hold(page, "ArrowLeft", 6)
        let_time_go(page, 2)
        hold(page, "ArrowRight", 6)
        others = page.locator("button", has_text=re.compile("each going its own way"))
        others.click()
        expect(others).to_have_attribute("aria-pressed", "false")
        let_time_go(page, 2)
        expect(others).to_have_attribute("aria-pressed", "true", timeout=PATIENCE_MS)
        expect(page.locator(".chip.trust")).to_contain_text("covered by training")
        page.locator("summary", has_text="Export").click()
        with page.expect_download(timeout=PATIENCE_MS) as download:
            page.locator("button", has_text=re.compile("^CSV$")).click()
        times, heights, headings = states_of(download.value.path())
        assert look.complaints == []
    assert times[-1] > 19
    assert heights.min() > LEAST_HEIGHT
    turned = np.interp([3, 4, 10, 12, 18], times, headings)
    assert abs(turned[1] - turned[0]) < 0.3
    assert turned[2] - turned[1] > 3
    assert turned[4] - turned[3] < -3


def test_a_finger_turns_a_human_by_the_stick_on_the_stage(tmp_path: Path):
    export_site(page_folder(), [shipped_folder() / "human"], tmp_path / "site")
    with (
        browsing() as browser,
        hosting(tmp_path / "site") as site,
        looking(browser, PHONE, is_moving=True, is_touched=True) as look,
    ):
        page = look.page
        page.add_init_script(STEPPED)
        page.goto(site)
        page.locator("html[data-frames]").wait_for(state="attached", timeout=PATIENCE_MS)
        stick = page.locator(".stick").first
        expect(stick).to_be_visible()
        expect(page.locator(".stick").last).to_be_hidden()
        box = stick.bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        page.mouse.move(box["x"] + 2, box["y"] + box["height"] / 2)
        let_time_go(page, 1)
        turning = page.locator(".slider", has_text="turn left").locator("output")
        expect(turning).to_have_text("0.80 rad/s")
        page.mouse.up()
        let_time_go(page, 1)
        expect(turning).to_have_text(re.compile("^-?0.00 rad/s$"))
        assert look.complaints == []
