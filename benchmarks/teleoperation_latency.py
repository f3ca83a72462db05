"""How long it takes from a person's move in a browser to the arm's command, on one computer.

    python benchmarks/teleoperation_latency.py --backend mujoco

A headless Chromium drags the gizmo of `orbit teleop`'s page, two pixels at a time, and then a stick of its gamepad.
Each move is timed to the moment at which the action that does what it asks for is given to the environment's step: from
the page's handling of the event, by a listener of our own that is called before all others, so that all that the page,
the websocket and the wait for the next step add is in it; and from the call that moves the mouse, so that the time is
in it for which the browser holds the event back while it draws. Both clocks are the computer's. Prints the median, the
95th percentile and the largest of each.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, sync_playwright

from orbit_core.dynamics.transforms import quat_to_matrix
from orbit_core.envs import make
from orbit_data.recording import RecordingFile
from orbit_data.teleoperation.browser import Browser
from orbit_data.teleoperation.device import Speeds
from orbit_data.teleoperation.driver import Driver
from orbit_data.teleoperation.session import Session, Views
from orbit_viewer.viewer import Viewer

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
STAMPS = """
window.stamps = [];
addEventListener("pointermove", () => stamps.push(performance.timeOrigin + performance.now()), true);
"""
HELD_BACK, ITSELF = "the mouse's move", "the page's event"


class TimedSession(Session):
    """Notes when each action was given that did what a person asked for."""

    commands: list[float]

    def step(self, action):
        if self._moved is not None:
            self.commands.append(time.time())
        return super().step(action)


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


def dragged(page: Page, session: TimedSession, x: float, y: float, moves: int) -> dict[str, list[float]]:
    """s of each move of a drag that begins at a place of the page, by what they count from."""
    found: dict[str, list[float]] = {HELD_BACK: [], ITSELF: []}
    page.mouse.move(x, y)
    page.mouse.down()
    page.wait_for_timeout(500)
    for move in range(moves):
        page.wait_for_timeout(137)
        page.evaluate("stamps.length = 0")
        before, begin = len(session.commands), time.time()
        page.mouse.move(x - 2.0 * (move % 20 + 1), y)
        while len(session.commands) == before and time.time() - begin < 3.0:
            time.sleep(0.001)
        stamps = page.evaluate("stamps")
        if len(session.commands) > before and stamps:
            found[HELD_BACK].append(session.commands[before] - begin)
            found[ITSELF].append(session.commands[before] - 1e-3 * stamps[0])
    page.mouse.up()
    return found


def by_gizmo(page: Page, viewer: Viewer, device: Browser, driver: Driver) -> tuple[float, float]:
    """A place to begin at: the gizmo's arrow along the hand's y."""
    page.goto(viewer.url)
    page.get_by_role("button", name="Record").wait_for()
    page.wait_for_timeout(5000)
    assert driver.hand is not None
    axis = quat_to_matrix(driver.hand.target[0, 3:]).numpy()[:, 1]
    return pixel(viewer, np.array(device._gizmo.position) + 0.1 * axis)


def by_gamepad(page: Page, viewer: Viewer) -> tuple[float, float]:
    """A place to begin at: the left stick's middle."""
    page.goto(viewer.page_urls[0])
    box = page.locator("#left").bounding_box()
    assert box is not None
    page.wait_for_timeout(1000)
    return box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", default="mujoco")
    parser.add_argument("--moves", type=int, default=60)
    parser.add_argument("--views", action="store_true", help="draw pictures beside the scene, as the command does")
    arguments = parser.parse_args()
    environment = make("Lift", num_envs=1, backend=arguments.backend, seed=3, episode_length=600.0)
    driver = Driver(environment)
    device = Browser(Speeds(), driver)
    found: dict[str, dict[str, list[float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        file = RecordingFile(Path(folder) / "own.hdf5")
        session = TimedSession(environment, driver, device, "browser", file, "Lift", 3)
        session.commands = []
        views = Views(environment.world, driver)
        pictures = views.pictures if arguments.views else None
        beside = {"tool": device.attach, "pages": device.pages, "views": pictures}
        with Viewer(session, session, port=8190, **beside) as viewer:

            def run() -> None:
                viewer.run()
                views.close()

            thread = threading.Thread(target=run)
            thread.start()
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
                page = browser.new_page(viewport={"width": 1000, "height": 640})
                page.add_init_script(STAMPS)
                for name in ("gizmo", "gamepad"):
                    place = by_gizmo(page, viewer, device, driver) if name == "gizmo" else by_gamepad(page, viewer)
                    found[name] = dragged(page, session, *place, arguments.moves)
                browser.close()
            viewer.controls.stop()
            thread.join()
        session.close()
    environment.close()
    for name, times in found.items():
        for begin, values in times.items():
            if not values:
                raise SystemExit(f"no move of the {name} reached the arm: is it in view?")
            median, high, most = 1e3 * np.percentile(values, (50, 95, 100))
            told = f"median {median:.0f} ms, 95 % within {high:.0f} ms, at most {most:.0f} ms"
            print(f"{name}: {len(values)} moves, from {begin} on: {told}")


if __name__ == "__main__":
    main()
