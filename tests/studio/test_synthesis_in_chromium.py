"""Somebody's first press in the page: controls are found, corrected and proved, and all of it is in sight, on any screen."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from chromium import PATIENCE_MS, Looking, browsing, enter, hosting, looking, next_frame
from jaxtyping import Float
from playwright.sync_api import Browser, Locator, Page, Route, ViewportSize, expect
from serving import Serving, serving

from neuroanimator_studio.catalogue import shipped_folder
from neuroanimator_studio.descents import WITH_DESCENT
from neuroanimator_studio.run import page_folder
from neuroanimator_studio.static_site import export_site

WINDOW: ViewportSize = {"width": 1000, "height": 380}
"""Wide enough for the panels."""

SCREENS: dict[str, ViewportSize] = {
    "laptop": {"width": 1280, "height": 720},
    "tablet": {"width": 820, "height": 1180},
    "phone": {"width": 390, "height": 844},
}

MAX_ITERATIONS = 20

ORANGE = (0.75, 0.45, 0.1)
"""Of the last link of the pendulum, in daylight."""

IS_IN_SIGHT = """(one) => {
    const { left, right, top, bottom } = one.getBoundingClientRect();
    const isInside = left >= 0 && right <= innerWidth && top >= 0 && bottom <= innerHeight;
    return isInside && [left + 2, right - 2].every((x) => one.contains(document.elementFromPoint(x, (top + bottom) / 2)));
}"""
"""Whether an element is inside the window, and nothing lies on it."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with browsing() as opened:
        yield opened


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serving]:
    with serving(tmp_path_factory.mktemp("studio"), page=page_folder()) as running:
        yield running


@contextmanager
def showing(
    browser: Browser, studio: Serving, name: str, window: ViewportSize
) -> Iterator[Looking]:
    """Open the studio with one system on its stage."""
    with looking(browser, window) as look:
        enter(look.page, f"{studio.gate.url}&show={name}")
        look.page.locator("html[data-frames]").wait_for(state="attached", timeout=PATIENCE_MS)
        yield look


@contextmanager
def without_server(browser: Browser, name: str, folder: Path) -> Iterator[Looking]:
    """Look at the page of one system as a web host has it."""
    export_site(page_folder(), [shipped_folder() / name], folder / "site")
    with hosting(folder) as origin, looking(browser, WINDOW) as look:
        look.page.goto(f"{origin}/site/")
        yield look


def find_button(page: Page) -> Locator:
    """Open "Reach a goal", which is open where nothing else steers, and return its button."""
    find = page.get_by_role("button", name="Find controls")
    expect(page.locator("summary", has_text="Reach a goal")).to_be_visible(timeout=PATIENCE_MS)
    if not find.is_visible():
        page.locator("summary", has_text="Reach a goal").click(timeout=PATIENCE_MS)
    return find


def press(page: Page) -> Locator:
    """Press the one button, wait until all is done, and return the verdict."""
    find_button(page).click(timeout=PATIENCE_MS)
    expect(page.locator(".results button")).to_be_visible(timeout=PATIENCE_MS)
    return page.locator(".verdict")


def to_the_end(page: Page) -> None:
    """Go to the last frame, and wait until it is drawn."""
    page.locator("canvas").first.focus()
    page.keyboard.press("End")
    next_frame(page, PATIENCE_MS)


def still_picture(page: Page) -> Float[np.ndarray, "H W 3"]:
    """Return the picture of the stage alone, once it is the same a second later: the camera comes to rest frame by frame."""
    before = stage_picture(page)
    for _ in range(PATIENCE_MS // 1_000):
        page.wait_for_timeout(1_000)
        now = stage_picture(page)
        if np.abs(now - before).max() < 0.02:
            break
        before = now
    return now


def stage_picture(page: Page) -> Float[np.ndarray, "H W 3"]:
    """Return the picture of the stage alone."""
    content = page.locator("canvas").first.screenshot(timeout=PATIENCE_MS)
    return matplotlib.image.imread(io.BytesIO(content), format="png")[..., :3]


def check_first_press(look: Looking, name: str) -> None:
    """Hold one press against what a person would call success, with everything in sight."""
    page = look.page
    for one in page.locator("nav button, .tools button, .timeline button, .timeline select").all():
        if one.is_visible():
            assert one.evaluate(IS_IN_SIGHT), f"cut off or covered: {one.text_content()}"
    verdict = press(page)
    expect(verdict).to_have_class("verdict success")
    expect(verdict).to_contain_text("Success: the physics")
    expect(verdict).to_be_in_viewport()
    expect(page.locator(".hud")).to_contain_text("the true physics", timeout=PATIENCE_MS)
    to_the_end(page)
    if name == "pendulum-50":
        check_upright(still_picture(page))
    assert look.complaints == []


def check_upright(picture: Float[np.ndarray, "H W 3"]) -> None:
    """Hold the picture against a last link that stands above the middle, and inside."""
    rows = np.flatnonzero((np.abs(picture - ORANGE) < 0.15).all(axis=2).any(axis=1))
    assert len(rows) > 0.05 * len(picture), "the last link is not in the picture"
    assert rows.min() > 0.02 * len(picture), "the last link leaves the picture"
    assert rows.max() < 0.5 * len(picture), "the last link does not stand"


@pytest.mark.parametrize(
    ("screen", "name"),
    [
        ("laptop", "pendulum-50"),
        *(
            pytest.param(screen, name, marks=pytest.mark.endurance)
            for screen in SCREENS
            for name in WITH_DESCENT
            if (screen, name) != ("laptop", "pendulum-50")
        ),
    ],
)
def test_the_first_press_ends_in_success_in_sight(
    browser: Browser, studio: Serving, screen: str, name: str
):
    with showing(browser, studio, name, SCREENS[screen]) as look:
        check_first_press(look, name)


def test_a_stage_that_is_not_there_yet_says_so(browser: Browser, studio: Serving):
    held: list[Route] = []
    with looking(browser, SCREENS["phone"]) as look:
        page = look.page
        page.route("**/emulator.wasm", lambda route: held.append(route))
        with page.expect_request("**/emulator.wasm"):
            enter(page, f"{studio.gate.url}&show=pendulum-50")
        expect(page.get_by_text("Loading …")).to_be_visible(timeout=PATIENCE_MS)
        held[0].continue_()
        expect(page.get_by_text("Loading …")).to_be_hidden(timeout=PATIENCE_MS)
        assert page.locator("html[data-frames]").count() == 1


@pytest.mark.parametrize("name", ["pendulum-passive-50", "cube"])
@pytest.mark.endurance
def test_what_has_no_goal_says_so(browser: Browser, studio: Serving, name: str):
    with showing(browser, studio, name, SCREENS["phone"]) as look:
        panel = look.page.locator("details", has_text="Reach a goal")
        expect(panel).to_contain_text(re.compile("no goal|none of the cube"))
        assert look.complaints == []


def test_a_fish_finds_its_way_in_a_page_without_a_server(browser: Browser, tmp_path: Path):
    with without_server(browser, "fish-50", tmp_path) as look:
        verdict = press(look.page)
        said = look.page.locator(".said").inner_text()
        match = re.fullmatch(r"(\d+) iterations", said)
        assert match, said
        assert int(match[1]) <= MAX_ITERATIONS
        expect(verdict).to_contain_text("Success: the physics ends")
        expect(verdict).to_contain_text("body lengths")
        assert look.complaints == []


def test_what_mujoco_moves_is_found_without_a_server_and_said_to_be_unproved(
    browser: Browser, tmp_path: Path
):
    with without_server(browser, "pendulum-50", tmp_path) as look:
        verdict = press(look.page)
        expect(verdict).to_contain_text("Found on the emulator, not verified: the physics")
        expect(verdict).to_contain_text("a page that 'neuroanimator studio' opens")
        assert look.complaints == []


def test_what_a_lost_server_does_not_prove_is_kept(browser: Browser, tmp_path: Path):
    with looking(browser, WINDOW) as look:
        page = look.page
        with serving(tmp_path, page=page_folder()) as studio:
            enter(page, f"{studio.gate.url}&show=pendulum-50")
            find = find_button(page)
            with page.expect_response(re.compile("worker"), timeout=PATIENCE_MS):
                find.hover(timeout=PATIENCE_MS)
        expect(page.get_by_text("The server does not answer")).to_be_visible(timeout=PATIENCE_MS)
        expect(press(page)).to_contain_text("not verified: the server does not answer")
        assert not [line for line in look.complaints if line.startswith("uncaught")]
