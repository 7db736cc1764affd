"""Somebody looks for controls in the page: one button, iterations, the proof, and the gap that is closed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from chromium import Looking, browsing, hosting, looking
from playwright.sync_api import Browser, Page, ViewportSize, expect
from serving import serving

from neuroanimator_studio.catalogue import shipped_folder
from neuroanimator_studio.run import page_folder
from neuroanimator_studio.static_site import export_site

PATIENCE = 120_000
"""A picture may take so long on a busy machine without a graphics card [ms]."""

WINDOW: ViewportSize = {"width": 1000, "height": 380}
"""Wide enough for the panels."""

MAX_ITERATIONS = 20

PROVE = "Replay the controls on the true physics"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with browsing() as opened:
        yield opened


def open_panel(page: Page) -> None:
    """Open "Reach a goal", which is open where nothing else steers."""
    find = page.get_by_role("button", name="Find controls")
    expect(page.locator("summary", has_text="Reach a goal")).to_be_visible(timeout=PATIENCE)
    if not find.is_visible():
        page.locator("summary", has_text="Reach a goal").click(timeout=PATIENCE)


def find_controls(page: Page) -> int:
    """Press the button and wait for the result; return how many iterations it took."""
    page.get_by_role("button", name="Find controls").click(timeout=PATIENCE)
    expect(page.locator(".results button").last).to_be_visible(timeout=PATIENCE)
    said = page.locator(".said").inner_text()
    match = re.fullmatch(r"(\d+) iterations, \d+ ms", said)
    assert match, said
    return int(match[1])


@pytest.mark.endurance
def test_what_the_physics_does_not_do_at_once_it_does_when_the_gap_is_closed(
    browser: Browser, tmp_path: Path
):
    with serving(tmp_path, page=page_folder()) as studio, looking(browser) as look:
        studio.studio.library.bundles = lambda: [shipped_folder() / "pendulum-50"]
        page = look.page
        page.set_viewport_size(WINDOW)
        page.goto(studio.gate.url)
        open_panel(page)
        assert find_controls(page) <= MAX_ITERATIONS
        page.get_by_role("button", name="Replay the controls").click()
        verdict = page.locator(".verdict")
        expect(verdict).to_contain_text("Not yet: the physics ends", timeout=PATIENCE)
        page.get_by_role("button", name="Learn from the replay").click()
        expect(verdict).to_contain_text("Success: the physics ends", timeout=PATIENCE)
        results = page.locator(".results button")
        assert results.count() >= 2
        results.first.click()
        expect(verdict).to_contain_text("Not yet")
        assert look.complaints == []


@pytest.mark.endurance
@contextmanager
def without_server(browser: Browser, name: str, folder: Path) -> Iterator[Looking]:
    """Look at the page of one system as a web host has it, with the panel of goals open."""
    export_site(page_folder(), [shipped_folder() / name], folder / "site")
    with hosting(folder) as origin, looking(browser, WINDOW) as look:
        look.page.goto(f"{origin}/site/")
        open_panel(look.page)
        yield look


def test_a_fish_finds_its_way_in_a_page_without_a_server(browser: Browser, tmp_path: Path):
    with without_server(browser, "fish-50", tmp_path) as look:
        assert find_controls(look.page) <= MAX_ITERATIONS
        look.page.get_by_role("button", name=PROVE).click(timeout=PATIENCE)
        expect(look.page.locator(".verdict.success")).to_contain_text(
            "body lengths", timeout=PATIENCE
        )
        look.page.keyboard.press("g")
        expect(look.page.locator(".chip.ghost")).to_contain_text("physics: gap", timeout=PATIENCE)
        assert look.complaints == []


def test_what_mujoco_moves_is_proven_by_a_server_alone(browser: Browser, tmp_path: Path):
    with without_server(browser, "pendulum-50", tmp_path) as look:
        expect(look.page.get_by_title("The proof of this system needs the server")).to_be_disabled()
        assert look.complaints == []
