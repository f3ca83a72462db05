"""What tests need to act as a person in a real browser."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from playwright.sync_api import Page, sync_playwright

from orbit_core.viewer.viewer import Viewer

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
ARGUMENTS = [
    "--headless", "--no-sandbox", "--disable-gpu-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip


@contextmanager
def opened_page(touched: bool = False, width: int = 640, height: int = 480) -> Iterator[Page]:
    """An empty page of a headless Chromium; ``touched`` as a phone's."""
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        opened = browser.new_page(viewport={"width": width, "height": height}, has_touch=touched, is_mobile=touched)
        opened.set_default_timeout(120_000.0)  # a software renderer draws the scene, on whatever cores are free
        yield opened
        browser.close()


def until(condition: Callable[[], bool], page: Page, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come about in time"
        page.wait_for_timeout(100)


def touch(page: Page, *way: tuple[float, float]) -> Callable[[], None]:
    """Put a finger down and draw it along points of the page; what is returned lifts it."""
    session = page.context.new_cdp_session(page)
    for kind, (x, y) in zip(("touchStart", *("touchMove",) * (len(way) - 1)), way, strict=True):
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": float(x), "y": float(y)}]})
        page.wait_for_timeout(100)
    return lambda: session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def pixel(viewer: Viewer, point: np.ndarray) -> tuple[float, float]:
    """Where a point of the world is on the page."""
    camera = next(iter(viewer._server.get_clients().values())).camera
    forward = camera.look_at - camera.position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, camera.up_direction)
    right = right / np.linalg.norm(right)
    arm, scale = point - camera.position, 0.5 * camera.image_height / np.tan(0.5 * camera.fov)
    depth = arm @ forward
    x, y = arm @ right / depth, arm @ np.cross(right, forward) / depth
    return 0.5 * camera.image_width + scale * x, 0.5 * camera.image_height - scale * y
