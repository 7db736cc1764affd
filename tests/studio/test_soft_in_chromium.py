"""In a real browser: a cloth is drawn, what holds it is dragged, and a crowd of it comes."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from chromium import PATIENCE_MS, browsing, hosting, looking
from cloths import untrained_cloth
from PIL import Image
from playwright.sync_api import Page, ViewportSize, expect

from neuroanimator_studio.bundle import make_bundle
from neuroanimator_studio.run import page_folder
from neuroanimator_studio.static_site import export_site

WINDOW: ViewportSize = {"width": 1000, "height": 640}
"""With panels beside the stage, and room above the cloth for what is said of an emulator that learnt nothing."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    file = folder / "cloth.emulator.safetensors"
    untrained_cloth(folder).save(file)
    bundle = make_bundle(str(file), folder / "cloth")
    export_site(page_folder(), [bundle], folder / "page")
    return folder / "page"


def picture(page: Page) -> np.ndarray:
    """Return what the stage shows: red, green, blue."""
    content = page.locator("canvas").first.screenshot(timeout=PATIENCE_MS)
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)


def places_of(image: np.ndarray, colour: tuple[int, int, int], within: int) -> np.ndarray:
    """Return [row, column] of each point of a colour."""
    return np.argwhere(np.abs(image - np.array(colour)).max(axis=2) < within)


@pytest.mark.endurance
def test_a_cloth_is_drawn_dragged_and_multiplied(site: Path):
    with browsing() as browser, hosting(site) as address, looking(browser, WINDOW) as look:
        page = look.page
        page.goto(address)
        page.locator("html[data-frames]").wait_for(state="attached", timeout=PATIENCE_MS)
        page.wait_for_timeout(1000)
        before = picture(page)
        red = before[..., 0] - before[..., 1:].max(axis=2)
        assert (red > 60).sum() > 1000  # the cloth
        knob = places_of(before, (110, 225, 215), 35)
        assert len(knob) > 3
        row, column = knob.mean(axis=0)
        box = page.locator("canvas").first.bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + column, box["y"] + row)
        page.mouse.down()
        page.mouse.move(box["x"] + column + 60, box["y"] + row, steps=5)
        expect(page.locator(".chip").first).to_have_text("live", timeout=PATIENCE_MS)
        page.wait_for_timeout(3000)
        after = places_of(picture(page), (110, 225, 215), 35)
        page.mouse.up()
        assert len(after) > 3
        assert after[:, 1].mean() > column + 10
        page.select_option("select[aria-label='How many more of them']", label="with 20 more")
        page.wait_for_timeout(2000)
        expect(page.locator("dd").nth(1)).to_contain_text("ms", timeout=PATIENCE_MS)
        assert look.complaints == []
