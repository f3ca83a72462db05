"""What tests need to act as a person in a real browser."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from playwright.sync_api import Page, sync_playwright

from orbit_viewer.viewer import Viewer

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
ARGUMENTS = [
    "--headless", "--no-sandbox", "--disable-gpu-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip
SLOW_SCREEN = """
    const next = window.requestAnimationFrame.bind(window);
    window.requestAnimationFrame = (draw) => window.setTimeout(() => next(draw), 80);
    window.cancelAnimationFrame = window.clearTimeout.bind(window);
"""
"""A screen of about ten pictures a second: a software renderer, left alone, draws on every core that there is."""
COARSE = 0.4
"""Pixels that are drawn across one of the page."""


@contextmanager
def opened_page(touched: bool = False, width: int = 640, height: int = 480) -> Iterator[Page]:
    """An empty page of a headless Chromium; ``touched`` as a phone's."""
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        opened = browser.new_page(viewport={"width": width, "height": height}, has_touch=touched, is_mobile=touched)
        if not touched:
            opened.add_init_script(SLOW_SCREEN)
        opened.set_default_timeout(120_000.0)  # a software renderer draws the scene, on whatever cores are free
        yield opened
        browser.close()


def address(viewer: Viewer) -> str:
    """Of a viewer's page, drawn coarsely."""
    return f"{viewer.url}{'&' if '?' in viewer.url else '?'}fixedDpr={COARSE}"


def until(condition: Callable[[], bool], page: Page, seconds: float = 120.0) -> None:
    assert _comes_about(condition, page, seconds), "it did not come about in time"


def again(act: Callable[[], None], condition: Callable[[], bool], page: Page, tries: int = 4) -> None:
    """What a person does, who does it again where nothing came of it: a slow page misses a touch now and then."""
    for _ in range(tries):
        act()
        if _comes_about(condition, page, 30.0):
            return
    raise AssertionError("it did not come about")


def _comes_about(condition: Callable[[], bool], page: Page, seconds: float) -> bool:
    end = time.monotonic() + seconds
    while not (come := condition()) and time.monotonic() < end:
        page.wait_for_timeout(100)
    return come


def touch(page: Page, *way: tuple[float, float]) -> Callable[[], None]:
    """Put a finger down and draw it along points of the page; what is returned lifts it."""
    session = page.context.new_cdp_session(page)
    for kind, (x, y) in zip(("touchStart", *("touchMove",) * (len(way) - 1)), way, strict=True):
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": float(x), "y": float(y)}]})
        page.wait_for_timeout(100)
    return lambda: session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def pixel(viewer: Viewer, point: np.ndarray, drawn: float = COARSE) -> tuple[float, float]:
    """Where a point of the world is on the page of :func:`address`, or of any with so many pixels ``drawn`` for one."""
    camera = next(iter(viewer._server.get_clients().values())).camera
    forward = camera.look_at - camera.position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, camera.up_direction)
    right = right / np.linalg.norm(right)
    width, height = camera.image_width / drawn, camera.image_height / drawn
    arm, scale = point - camera.position, 0.5 * height / np.tan(0.5 * camera.fov)
    depth = arm @ forward
    x, y = arm @ right / depth, arm @ np.cross(right, forward) / depth
    return 0.5 * width + scale * x, 0.5 * height - scale * y
