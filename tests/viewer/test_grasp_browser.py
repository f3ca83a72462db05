"""A person grasps in a real browser: chooses by a click, sees candidates and ghost, refuses, accepts, lets go."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
import torch
from playwright.sync_api import Page, sync_playwright

from orbit_core.backends import backend_names
from orbit_core.envs import make
from orbit_core.motion.grasping import GraspWorkflow, Stage
from orbit_core.viewer.grasp_tool import GraspedEnvironment, GraspTool
from orbit_core.viewer.viewer import Viewer

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
ARGUMENTS = [
    "--headless", "--no-sandbox", "--disable-gpu-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip


@pytest.fixture
def page() -> Iterator[Page]:
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        opened = browser.new_page(viewport={"width": 640, "height": 480})
        opened.set_default_timeout(60_000.0)
        yield opened
        browser.close()


@pytest.fixture
def running() -> Iterator[tuple[Viewer, GraspWorkflow]]:
    environment = make("Lift", num_envs=1, backend=backend_names()[0], seed=3)
    grasped = GraspedEnvironment(environment)
    with Viewer(grasped, grasped, port=8160, tool=lambda s, v: GraspTool(grasped.workflow, s, v)) as viewer:
        thread = threading.Thread(target=viewer.run)
        thread.start()
        yield viewer, grasped.workflow
        viewer.controls.stop()
        thread.join(10.0)
    grasped.workflow.close()
    environment.close()


def until(condition: Callable[[], bool], page: Page, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come about in time"
        page.wait_for_timeout(100)


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


def test_a_person_chooses_refuses_accepts_and_lets_go(page: Page, running: tuple[Viewer, GraspWorkflow]) -> None:
    viewer, work = running
    page.goto(viewer.url)
    until(lambda: len(viewer._server.get_clients()) == 1, page)
    page.get_by_text("choose an object").wait_for()
    page.wait_for_timeout(2000)
    cube = work._world.objects["cube"].root_pose[0, :3].numpy()
    page.mouse.click(*pixel(viewer, cube))
    page.get_by_text("accept, refuse or move").wait_for()
    assert work.motion is not None
    first = work.motion.pose
    page.get_by_role("button", name="Refuse").click()
    until(lambda: work.motion is not None and not torch.equal(work.motion.pose, first), page)
    page.get_by_role("button", name="Accept").click()
    until(lambda: work.stage is Stage.EXECUTING, page)
    page.get_by_text("is lifted by").wait_for()
    assert work.lifted is not None
    assert work.lifted > 0.1
    page.get_by_role("button", name="Gripper").click()
    until(lambda: work.driver.gripper_open, page)
