"""How long it takes from a person's move in a browser to the arm's command, on one computer.

    python benchmarks/teleoperation_latency.py --backend mujoco

A headless Chromium drags the gizmo of `orbit teleop`'s page, two pixels at a time. Each move is timed to the end of the
control step that carried it out: from the call that moves the mouse, so that the browser's own work is in it, which
without a GPU is for the most part drawing; and from the arrival of the browser's message, so that the wait for the next
step and the step itself are in it. Prints the median, the 95th percentile and the largest of both.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

from orbit_core.data.recording import RecordingFile
from orbit_core.dynamics.transforms import quat_to_matrix
from orbit_core.envs import make
from orbit_core.teleoperation.browser import Browser
from orbit_core.teleoperation.device import Speeds
from orbit_core.teleoperation.driver import Driver
from orbit_core.teleoperation.session import Session
from orbit_core.viewer.viewer import Viewer

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]


class TimedSession(Session):
    """Notes when each step ended that did what a person asked for."""

    done: list[float]

    def step(self, action):
        result = super().step(action)
        if self._moved is not None:
            self.done.append(time.perf_counter())
        return result


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
    return float(0.5 * camera.image_width + scale * x), float(0.5 * camera.image_height - scale * y)


def measured(viewer: Viewer, session: TimedSession, device: Browser, driver: Driver, moves: int) -> list[float]:
    """s of each move."""
    assert driver.hand is not None
    found: list[float] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1000, "height": 640})
        page.goto(viewer.url)
        page.get_by_role("button", name="Record").wait_for()
        page.wait_for_timeout(5000)
        axis = quat_to_matrix(driver.hand.target[0, 3:]).numpy()[:, 1]
        x, y = pixel(viewer, np.array(device._gizmo.position) + 0.1 * axis)
        page.mouse.move(x, y)
        page.mouse.down()
        for move in range(moves):
            page.wait_for_timeout(137)
            before = len(session.done)
            begin = time.perf_counter()
            page.mouse.move(x - 2.0 * (move % 20), y)
            while len(session.done) == before and time.perf_counter() - begin < 1.0:
                time.sleep(0.001)
            if len(session.done) > before:
                found.append(session.done[before] - begin)
        page.mouse.up()
        browser.close()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", default="mujoco")
    parser.add_argument("--moves", type=int, default=60)
    arguments = parser.parse_args()
    environment = make("Lift", num_envs=1, backend=arguments.backend, seed=3, episode_length=120.0)
    driver = Driver(environment)
    device = Browser(Speeds(), driver)
    with tempfile.TemporaryDirectory() as folder:
        file = RecordingFile(Path(folder) / "own.hdf5")
        session = TimedSession(environment, driver, device, "browser", file, "Lift", 3)
        session.done = []
        with Viewer(session, session, port=8190, tool=device.attach) as viewer:
            thread = threading.Thread(target=viewer.run)
            thread.start()
            times = 1e3 * np.array(measured(viewer, session, device, driver, arguments.moves))
            viewer.controls.stop()
            thread.join()
        session.close()
    environment.close()
    if not len(times):
        raise SystemExit("no move reached the arm: is the gizmo in view?")
    for name, values in (("the mouse's move", times), ("the browser's message", 1e3 * np.array(session.latencies))):
        median, high = np.percentile(values, (50, 95))
        told = f"median {median:.0f} ms, 95 % within {high:.0f} ms, at most {values.max():.0f} ms"
        print(f"{len(values)} moves, from {name} on: {told}")


if __name__ == "__main__":
    main()
