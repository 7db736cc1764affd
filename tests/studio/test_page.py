"""The studio as a person uses it: real Chromium, the real server, keys and mouse. Needs `make page` and Chromium."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from chromium import PATIENCE_MS, browsing, enter, hosting, looking
from playwright.sync_api import Browser, Page, ViewportSize
from waiting import PATIENCE

WINDOW: ViewportSize = {"width": 640, "height": 320}
"""Small: drawing without a graphics card is slow."""

SYSTEMS = ("dolphin", "truck", "lander", "pendulum", "pendulum-passive", "cube", "fish")

NEUROANIMATOR = (sys.executable, "-c", "from neuroanimator.cli.main import main; main()")


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Run `neuroanimator studio` and yield the address it prints."""
    process = subprocess.Popen(
        [*NEUROANIMATOR, "studio", "--no-open", "--port", "0"], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with browsing() as opened:
        yield opened


@contextmanager
def open_page(browser: Browser, address: str) -> Iterator[tuple[Page, list[str]]]:
    """Yield a page, and what is said on its console that should not be."""
    with looking(browser, WINDOW, is_moving=True) as look:
        look.page.set_default_timeout(PATIENCE_MS)
        enter(look.page, address)
        yield look.page, look.complaints


def wait_until(page: Page, expression: str) -> None:
    """Wait until a piece of JavaScript is true in the page, which lets nobody make functions out of strings."""
    end = time.monotonic() + PATIENCE_MS / 1000
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"never came true: {expression}"
        page.wait_for_timeout(50)


def shown(page: Page, selector: str) -> str:
    return page.locator(selector).first.inner_text()


def shows(page: Page, system: str) -> None:
    """Wait until a system is on the stage and its motion goes on."""
    name = system if system == "cube" else f"{system}-50"
    wait_until(page, f"document.querySelector('.about h1')?.textContent === '{name}'")
    before = shown(page, ".clock")
    wait_until(page, f"document.querySelector('.clock').textContent !== '{before}'")


def middle_of_stage(page: Page) -> tuple[float, float]:
    """Return the middle of the picture [pixels]."""
    box = page.locator("canvas").first.bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_a_person_looks_around_steers_and_comes_back(browser: Browser, address: str) -> None:
    with open_page(browser, address) as (page, complaints):
        shows(page, "fish")
        assert "token" not in page.url, "the token stays out of the address bar"
        for system in SYSTEMS:
            page.get_by_role("button", name=system.capitalize(), exact=True).click()
            shows(page, system)

        page.locator("canvas").first.focus()
        page.keyboard.press("Space")
        still = shown(page, ".clock")
        page.wait_for_timeout(300)
        assert shown(page, ".clock") == still, "space stops the motion"
        page.keyboard.press("End")
        wait_until(page, "document.querySelector('.clock').textContent.startsWith('5.00 ')")
        page.keyboard.press("Comma")
        wait_until(page, "document.querySelector('.clock').textContent.startsWith('4.90 ')")
        page.locator(".scrub").fill("1.5")
        wait_until(page, "document.querySelector('.clock').textContent.startsWith('1.50 ')")

        page.locator("canvas").first.focus()
        page.keyboard.down("ArrowLeft")
        wait_until(page, "document.querySelector('.hud').textContent.includes('live')")
        wait_until(page, "parseFloat(document.querySelector('.clock').textContent) > 2")
        page.keyboard.up("ArrowLeft")
        page.keyboard.press("g")
        wait_until(page, "!document.querySelector('.chip.ghost').hidden")
        page.keyboard.press("t")
        wait_until(
            page, "document.querySelector('[title^=\"Show a target\"]').ariaPressed === 'true'"
        )

        page.keyboard.press("?")
        assert page.get_by_role("dialog").is_visible()
        page.keyboard.press("Escape")
        assert not page.locator("dialog").is_visible()

        page.reload()
        shows(page, "fish")
        assert complaints == []


def test_physics_beside_it_is_pushed_with_it(browser: Browser, address: str) -> None:
    with open_page(browser, f"{address}&show=pendulum-50") as (page, complaints):
        shows(page, "pendulum")
        page.keyboard.press("g")
        middle = middle_of_stage(page)
        page.mouse.move(*middle)
        page.mouse.down()
        page.mouse.move(middle[0] + 120, middle[1] - 40, steps=3)
        wait_until(page, "document.querySelector('.hud').textContent.includes('live')")
        wait_until(page, "parseFloat(document.querySelector('.clock').textContent) > 2")
        wait_until(page, "!document.querySelector('.chip.ghost').hidden")
        # Held to the side it hangs still, and physics too, which unpushed would swing a metre away.
        gap = "parseFloat(document.querySelector('.chip.ghost').textContent.split('gap')[1])"
        wait_until(page, f"{gap} < 15")
        page.mouse.up()
        assert complaints == []


def test_where_the_emulator_is_lost_physics_goes_on(browser: Browser, address: str) -> None:
    press = "[...document.querySelectorAll('.banner button')].find((one) => one.textContent.startsWith('Continue with')).click()"
    with open_page(browser, f"{address}&show=lander-50") as (page, complaints):
        shows(page, "lander")
        page.keyboard.press("h")
        middle = middle_of_stage(page)
        page.mouse.move(*middle)
        page.mouse.down()
        page.mouse.move(middle[0] + 300, middle[1] - 150, steps=3)
        wait_until(page, "document.querySelector('.banner.warning') !== null")
        page.evaluate(press)
        page.mouse.up()
        wait_until(page, "document.querySelector('.hud').textContent.startsWith('physics')")
        wait_until(page, "parseFloat(document.querySelector('.clock').textContent) > 0.5")
        page.locator("canvas").first.focus()
        page.keyboard.press("r")
        wait_until(page, "document.querySelector('.hud').textContent.startsWith('live')")
        assert complaints == []


def test_a_file_that_is_no_emulator_is_refused_in_words(browser: Browser, address: str) -> None:
    drop = """() => {
        const data = new DataTransfer();
        data.items.add(new File(["junk"], "<b>junk</b>.safetensors"));
        document.dispatchEvent(new DragEvent("drop", { dataTransfer: data, cancelable: true }));
    }"""
    with open_page(browser, address) as (page, _):
        shows(page, "fish")
        page.evaluate(drop)
        wait_until(page, "document.querySelector('.banner.error') !== null")
        assert "<b>junk</b>" in shown(page, ".banner.error"), "a name is text, never markup"
        assert page.locator(".banner b").count() == 0
        shows(page, "fish")


def test_the_static_page_works_in_a_folder_of_any_host(browser: Browser, tmp_path: Path) -> None:
    folder = tmp_path / "some" / "folder"
    export = [*NEUROANIMATOR, "studio", "--export", str(folder)]
    subprocess.run(export, check=True, capture_output=True, timeout=PATIENCE)
    with hosting(tmp_path) as origin:
        address = f"{origin}/some/folder/?show=pendulum-50"
        with open_page(browser, address) as (page, complaints):
            shows(page, "pendulum")
            assert complaints == []
