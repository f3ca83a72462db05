"""The report of a real run in a real browser, opened from the disk."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, sync_playwright

from .conftest import PAIR

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
BACKEND = PAIR[0]


@pytest.fixture
def page(report_page: Path) -> Iterator[Page]:
    """The opened report; the test fails if the browser complains of anything, or asks for what is not on the disk."""
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    complaints: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--headless", "--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda r: None if r.url.startswith(("file:", "data:")) else complaints.append(r.url))
        page.goto(report_page.as_uri())
        yield page
        browser.close()
    assert not complaints


def test_the_matrix_tells_status_and_reason(page: Page) -> None:
    backends = sorted((*PAIR, "dying", "hanging"))
    columns = [backends.index(BACKEND), backends.index("dying")]
    page.locator("#matrix-fold > summary").click()
    row = page.locator(".matrix > tbody > tr", has=page.get_by_role("link", name="projectile"))
    passing, failing = (row.locator("> td").nth(column) for column in columns)
    assert "pass" in passing.inner_text()
    colors = [
        cell.locator("summary").evaluate("e => getComputedStyle(e).backgroundColor") for cell in (passing, failing)
    ]
    assert colors[0] != colors[1]
    assert "fail" in failing.inner_text()
    assert "SIGABRT" in (failing.locator("summary").get_attribute("title") or "")
    assert not failing.locator(".more").is_visible()
    failing.locator("summary").focus()
    page.keyboard.press("Enter")
    assert "its process died of SIGABRT" in failing.locator(".more").inner_text()
    passing.locator("summary").click()
    assert "0.0001 rad/s" in passing.locator("tr", has_text="spin").inner_text()


def test_a_link_opens_its_scenario_with_the_plots(page: Page) -> None:
    page.locator("#matrix-fold > summary").click()
    page.locator("#matrix").get_by_role("link", name="free_fall").click()
    section = page.locator("details#free_fall")
    assert "Galileo" in section.inner_text()
    for words in ("Error against speed", "Measured and true"):
        figure = section.locator(f'figure[aria-label^="{words}"]')
        assert figure.is_visible()
        assert figure.locator("svg text", has_text=BACKEND).count() >= 1
        size = figure.locator("svg").bounding_box()
        assert size is not None
        assert size["width"] > 150


def test_the_videos_of_a_task_play_together(page: Page) -> None:
    videos = page.locator("#videos-Reach video")
    assert videos.count() == len(PAIR), "the dying backend has none"
    page.locator("#task-Reach > summary").click()
    page.locator("button[data-play='videos-Reach']").click()
    page.wait_for_function(
        "[...document.querySelectorAll('video')].every(v => v.readyState >= 2 && v.currentTime > 0.2 && !v.paused)"
    )
    assert videos.first.evaluate("v => [v.videoWidth, v.videoHeight]") == [256, 192]


def test_the_page_is_readable_on_a_narrow_screen(page: Page) -> None:
    """No content reaches beyond the screen except tables that scroll on their own, with all folds open."""
    page.set_viewport_size({"width": 480, "height": 800})
    page.evaluate("for (const fold of document.querySelectorAll('details')) fold.open = true")
    assert page.evaluate("document.documentElement.scrollWidth") <= 480


def test_the_first_screen_says_which_engine_and_every_link_has_its_place(page: Page) -> None:
    """This run has the figures of no use: each says so in place of a ranking."""
    page.set_viewport_size({"width": 1400, "height": 900})
    cards = page.locator(".card")
    assert cards.count() == 6
    box = cards.last.bounding_box()
    assert box is not None
    assert box["y"] + box["height"] <= 900, "all uses are on the first screen"
    assert "Not measured" in page.locator("#use-determinism").inner_text()
    anchors = page.locator('a[href^="#"]').evaluate_all("links => links.map(link => decodeURIComponent(link.hash))")
    ids = page.locator("[id]").evaluate_all("all => all.map(one => `#${one.id}`)")
    assert {*anchors} <= {*ids}
