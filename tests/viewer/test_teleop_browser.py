"""A person lifts the cube in a real browser, by dragging the gizmo, and the episode is kept."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Page

from orbit_core.backends import default_backend
from orbit_core.dynamics.transforms import quat_to_matrix
from orbit_core.envs import make
from orbit_data.hdf5 import Hdf5Dataset
from orbit_data.recording import RecordingFile
from orbit_data.teleoperation.browser import Browser, Pad
from orbit_data.teleoperation.device import Event, Speeds
from orbit_data.teleoperation.driver import Driver
from orbit_data.teleoperation.session import Session, Views
from orbit_viewer.viewer import Viewer

Running = tuple[Viewer, Session, Browser, Driver]


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    environment = make("Lift", num_envs=1, backend=default_backend(), seed=3, episode_length=1200.0)
    driver = Driver(environment)
    device = Browser(Speeds(), driver)
    session = Session(environment, driver, device, "browser", RecordingFile(tmp_path / "own.hdf5"), "Lift", 3)
    rows = lambda _: session.information()  # noqa: E731
    views = Views(environment.world, driver)
    with Viewer(
        session, session, port=8170, information=rows, tool=device.attach, pages=device.pages, views=views.pictures
    ) as viewer:

        def run() -> None:
            viewer.run()
            views.close()

        thread = threading.Thread(target=run)
        thread.start()
        yield viewer, session, device, driver
        viewer.controls.stop()
        thread.join(10.0)
    environment.close()


def drag_to(page: Page, person: ModuleType, running: Running, target: NDArray[np.float32], tolerance: float) -> None:
    """Drag the gizmo's arrows until the hand is at a point."""
    viewer, _, device, driver = running
    hand = driver.hand
    assert hand is not None
    for _ in range(5):
        page.wait_for_timeout(700)
        if np.abs(target - hand.measured[0, :3].numpy()).max() < tolerance:
            return
        axes = quat_to_matrix(hand.target[0, 3:]).numpy()
        for axis in axes.T:
            page.wait_for_timeout(600)  # the gizmo is back at the hand
            place = np.array(device._gizmo.position)
            way = float((target - place) @ axis)
            if abs(way) > 0.5 * tolerance:
                page.mouse.move(*person.pixel(viewer, place + 0.1 * axis))
                page.mouse.down()
                page.mouse.move(*person.pixel(viewer, place + (0.1 + way) * axis), steps=6)
                page.mouse.up()
    raise AssertionError(f"the hand is at {hand.measured[0, :3]}, not at {target}")


def point_down(page: Page, driver: Driver) -> None:
    """Hold the button that tilts the hand until its fingers point downwards."""
    hand = driver.hand
    assert hand is not None
    button = page.get_by_role("button", name="Tilt down", exact=True)
    button.scroll_into_view_if_needed()
    button.hover()
    page.mouse.down()
    for _ in range(100):
        if quat_to_matrix(hand.target[0, 3:])[0, 2] < 0.06:
            break
        page.wait_for_timeout(20)
    page.mouse.up()
    page.wait_for_timeout(500)
    assert quat_to_matrix(hand.measured[0, 3:])[2, 2] < -0.98


def rest(page: Page, person: ModuleType, session: Session, opening: float = 1.0) -> None:
    """Wait until the robot rests with its fingers no further apart than ``opening``, as long as that takes."""
    robot = session.world.robots["robot"]
    fingers = robot.find_joints("panda_finger_joint.*")
    person.until(lambda: float(robot.joint_positions[0, fingers].sum()) < opening, page)
    person.until(lambda: float(robot.joint_velocities.abs().max()) < 0.01, page)


def test_a_person_lifts_the_cube_by_the_gizmo(page: Page, person: ModuleType, running: Running, tmp_path: Path) -> None:
    viewer, session, _, driver = running
    page.set_viewport_size({"width": 1000, "height": 640})
    page.goto(person.address(viewer))
    person.until(lambda: len(viewer._server.get_clients()) == 1, page)
    page.get_by_role("button", name="Record").wait_for()
    page.wait_for_timeout(2000)
    page.keyboard.press("r")
    person.until(lambda: session.recording, page)
    point_down(page, driver)
    cube = session.world.objects["cube"]
    at = cube.root_pose[0, :3].numpy().copy()
    drag_to(page, person, running, at + np.float32((0.0, 0.0, 0.12)), 0.01)
    drag_to(page, person, running, at, 0.008)
    rest(page, person, session)
    page.keyboard.press("g")
    rest(page, person, session, opening=0.06)
    drag_to(page, person, running, at + np.float32((0.0, 0.0, 0.15)), 0.02)
    page.screenshot(path=tmp_path / "teleop.png")
    assert cube.root_pose[0, 2] > at[2] + 0.1
    page.get_by_role("button", name="Mark success").click()
    page.keyboard.press("v")
    person.until(lambda: session.kept == 1, page)
    assert sum(session.latencies) / len(session.latencies) < 1.0
    viewer.controls.stop()
    assert session.close() == 1
    dataset = Hdf5Dataset(tmp_path / "own.hdf5")
    assert dataset.episodes[0].success
    heights = dataset.read(0).arrays["poses/cube"][:, 2]
    assert heights[-1] > heights[0] + 0.1
    dataset.close()


def test_a_phone_drives_by_the_sticks_and_by_the_gizmo(person: ModuleType, running: Running, tmp_path: Path) -> None:
    viewer, session, device, driver = running
    hand = driver.hand
    assert hand is not None
    with person.opened_page(touched=True, width=844, height=390) as phone:
        phone.goto(viewer.page_urls[0])
        phone.get_by_role("button", name="Record").tap()
        person.until(lambda: session.recording, phone)
        phone.get_by_text("recording: yes").wait_for()
        assert all(handle.image.std() > 10.0 for handle in viewer._panel._pictures.values())  # hand and side view
        begin = hand.measured[0, :3].clone()
        box = phone.locator("#left").bounding_box()
        x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
        lift = person.touch(phone, (x, y), (x, y - 20.0), (x, y - 40.0))
        person.until(lambda: float(hand.measured[0, 0] - begin[0]) > 0.05, phone)
        phone.screenshot(path=tmp_path / "pad.png")
        lift()
        phone.wait_for_timeout(500)
        rest = hand.target.clone()
        phone.wait_for_timeout(300)
        assert (hand.target - rest).abs().max() < 1e-3  # a stick that is let go asks for nothing
        phone.get_by_role("button", name="Grip").tap()
        person.until(lambda: not hand.gripper_open, phone)

        phone.goto(viewer.url)
        person.until(lambda: len(viewer._server.get_clients()) == 1, phone)
        phone.wait_for_timeout(4000)
        begun, axis = np.array(device._gizmo.position), quat_to_matrix(hand.target[0, 3:]).numpy()[:, 1]

        def drag() -> None:
            points = (np.array(device._gizmo.position) + reach * axis for reach in (0.1, 0.13, 0.16, 0.2))
            person.touch(phone, *(person.pixel(viewer, point, drawn=1.0) for point in points))()

        person.again(drag, lambda: float((hand.measured[0, :3].numpy() - begun) @ axis) > 0.07, phone)
        phone.screenshot(path=tmp_path / "phone.png")


def test_a_pad_says_what_is_no_frame_and_lets_go_when_it_is_no_longer_heard_of() -> None:
    events: list[Event | None] = []
    pad = Pad(events.append)
    rest = pad.shares
    for bad in (
        b"no json", b"[" * 900, b"{}", b"\xff", b" " * 2000, b'{"hand": [0, 0, 0, 0, 0, 2], "base": [0, 0, 0]}',
        b'{"hand": [0, 0, 0, 0, 0, NaN], "base": [0, 0, 0]}', b'{"hand": [0, 0, 0, 0, 0, 0], "base": [0, 0]}',
        b'{"hand": [0, 0, 0, 0, 0, 0], "base": [0, 0, 0], "event": "explode"}',
    ):  # fmt: skip
        assert pad._take(bad)
    assert pad.shares == rest
    assert not events
    assert not pad._take('{"hand": [1, 0, 0, 0, 0, 0], "base": [0, 0, -0.5], "event": "save"}')
    assert events == [Event.SAVE]
    assert pad.shares == ((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, -0.5))
    time.sleep(0.3)
    assert pad.shares == rest
