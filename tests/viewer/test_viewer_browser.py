"""The viewer in a real browser: what a person sees, and what the buttons do."""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
from playwright.sync_api import Page

from orbit_viewer.scene_view import Frame, SceneView
from orbit_viewer.viewer import Viewer


@pytest.fixture(scope="module")
def page(person: ModuleType) -> Iterator[Page]:
    with person.opened_page(width=720, height=620) as opened:
        yield opened


@pytest.fixture
def running(fakes: ModuleType) -> Iterator[tuple[Viewer, Any]]:
    """A viewer whose simulation runs in a thread of its own, since the browser's must be this one."""
    environment = fakes.FakeEnvironment(num_envs=4)
    with Viewer(environment, fakes.FakeAgent(), port=8150, title="Things") as viewer:
        thread = threading.Thread(target=viewer.run)
        thread.start()
        yield viewer, environment
        viewer.controls.stop()
        thread.join(10.0)
        assert not thread.is_alive()


def _picture(page: Page) -> np.ndarray:
    """The scene's part of the page, (H, W, 3)."""
    picture = imageio.imread(io.BytesIO(page.screenshot(clip={"x": 0, "y": 160, "width": 380, "height": 460})))
    return picture[..., :3].astype(int)


def _pixels_like(picture: np.ndarray, name: str) -> int:
    """How many pixels have the hue of one of the things."""
    r, g, b = picture[..., 0], picture[..., 1], picture[..., 2]
    mask = {
        "box": (r > 120) & (r > 1.6 * g) & (r > 1.6 * b),
        "ball": (b > 120) & (b > 1.8 * r),
        "can": (g > 100) & (g > 1.4 * r) & (g > 1.3 * b),
        "pill": (r > 150) & (g > 110) & (b < 0.5 * r),
    }[name]
    return int(mask.sum())


def test_a_person_sees_the_scene_and_drives_it(page: Page, person: ModuleType, running: tuple[Viewer, Any]) -> None:
    viewer, environment = running
    page.goto(viewer.url)
    things = ("box", "ball", "can", "pill")
    person.until(lambda: all(_pixels_like(_picture(page), thing) > 300 for thing in things), page)

    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Play").wait_for()
    held = environment.steps
    page.wait_for_timeout(300)
    assert environment.steps == held

    page.get_by_role("button", name="Step").click()
    person.until(lambda: environment.steps == held + 1, page)
    page.wait_for_timeout(200)
    assert environment.steps == held + 1
    page.get_by_text(str(held + 1), exact=True).wait_for()

    resets = environment.resets
    page.get_by_role("button", name="Reset").click()
    person.until(lambda: environment.resets == resets + 1, page)
    assert environment.steps == 0

    before = _picture(page)
    viewer.controls.select(first=3)
    person.until(lambda: bool(np.abs(_picture(page) - before).max(axis=-1).mean() > 2.0), page)

    page.get_by_role("button", name="Play").click()
    person.until(lambda: environment.steps > 5, page)


def test_several_environments_are_drawn_side_by_side(
    page: Page, person: ModuleType, running: tuple[Viewer, Any]
) -> None:
    viewer, _ = running
    viewer.controls.pause()
    viewer.controls.select(count=4, markers=False)
    page.goto(viewer.url)
    person.until(lambda: _pixels_like(_picture(page), "ball") > 300, page)
    page.wait_for_timeout(500)
    picture = _picture(page)
    columns = np.flatnonzero(((picture[..., 2] > 120) & (picture[..., 2] > 1.8 * picture[..., 0])).any(axis=0))
    assert np.count_nonzero(np.diff(columns) > 8) >= 1, "balls stand apart"


def test_the_run_ends_after_its_steps_and_keeps_real_time(fakes: ModuleType) -> None:
    environment = fakes.FakeEnvironment()
    with Viewer(environment, fakes.FakeAgent(), port=8150) as viewer:
        start = time.perf_counter()
        viewer.run(max_steps=25)
        seconds = time.perf_counter() - start
    assert (environment.steps, environment.resets) == (25, 1)
    assert seconds >= 0.9 * 24 * environment.step_dt


def test_the_interrupt_key_ends_the_run(fakes: ModuleType) -> None:
    class Interrupting:
        def act(self) -> Any:
            raise KeyboardInterrupt

    with Viewer(fakes.FakeEnvironment(), Interrupting(), port=8150) as viewer:
        viewer.run()
        assert viewer.controls.stopped


def test_an_update_moves_what_moved_and_nothing_else(fakes: ModuleType) -> None:
    import viser

    world = fakes.FakeEnvironment(num_envs=2).world
    server = viser.ViserServer("127.0.0.1", 8150, verbose=False)
    try:
        view = SceneView(server, world.layout)
        links, markers = world.link_poses.numpy(), np.zeros((2, 2, 7), dtype=np.float32)
        markers[..., 3] = 1.0
        view.update(Frame(links, markers))
        assert view.count == 2
        sent: list[Any] = []
        queue = server._websock_server.queue_message
        server._websock_server.queue_message = lambda message: (sent.append(message), queue(message))  # type: ignore
        view.update(Frame(links.copy(), markers.copy()))
        assert not [message for message in sent if hasattr(message, "updates")]
        moved = links.copy()
        moved[:, 1, 2] += 0.1
        view.update(Frame(moved, markers))
        updates = [message for message in sent if hasattr(message, "updates")]
        assert [message.name for message in updates] == ["/links/1"]
    finally:
        server.stop()


def test_without_the_library_the_error_says_how_to_get_it(fakes: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    from orbit_core.interfaces import ConfigurationError

    monkeypatch.setitem(__import__("sys").modules, "viser", None)
    with pytest.raises(ConfigurationError, match=r"pip install .*\[viewer\]"):
        Viewer(fakes.FakeEnvironment(), fakes.FakeAgent())
