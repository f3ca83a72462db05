"""The editor in a real browser: a scene is made, played and saved by a person who clicks and types."""

from __future__ import annotations

import io
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import imageio.v3 as imageio
import numpy as np
import pytest
from playwright.sync_api import Page

from orbit_core.envs import make
from orbit_core.scene import CameraSpec
from orbit_scenes.document.files import load_document
from orbit_scenes.document.session import Session
from orbit_scenes.editor.editor import Editor
from orbit_scenes.editor.panel import GOAL

# A folder in which the pictures of each step are kept, for people to look at; width and height of the page.
_SHOTS = os.environ.get("ORBIT_SHOTS", "")
_SIZE = os.environ.get("ORBIT_SHOT_SIZE", "800x640")
_DRAWN = os.environ.get("ORBIT_SHOT_DPR", "0.2")


@pytest.fixture
def page(person: ModuleType) -> Iterator[Page]:
    width, height = map(int, _SIZE.split("x"))
    with person.opened_page(width=width, height=height) as opened:
        yield opened


@pytest.fixture
def editor(tmp_path: Path) -> Iterator[Editor]:
    """An editor whose loop runs in a thread of its own, since the browser's must be this one."""
    session = Session(tmp_path / "room.toml")
    started, made = threading.Event(), []

    def serve() -> None:
        # Renderers belong to the thread that makes them.
        with Editor(session, ["mujoco"], "mujoco", port=8190) as running:
            made.append(running)
            started.set()
            running.run()

    thread = threading.Thread(target=serve)
    thread.start()
    assert started.wait(60.0)
    yield made[0]
    made[0].stop()
    thread.join(60.0)
    session.close()
    assert not thread.is_alive()


class Person:
    """Hands and eyes of a person at the editor's page."""

    def __init__(self, page: Page, editor: Editor, tools: ModuleType) -> None:
        self.page, self.editor, self._tools, self._shots = page, editor, tools, 0

    def until(self, condition) -> None:
        self._tools.until(condition, self.page)

    def tab(self, name: str) -> None:
        self.page.get_by_role("tab", name=name).click()

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).first.click()

    def add(self, words: str, entry: str) -> None:
        """Search in the library and add what was found."""
        before = len(self.editor.session.document.items) + len(self.editor.session.document.sensors)
        self.page.locator("input:visible").first.fill(words)
        self.press(f"Add {entry}")
        document = lambda: self.editor.session.document  # noqa: E731
        self.until(lambda: len(document().items) + len(document().sensors) == before + 1)

    def choose(self, name: str) -> None:
        """Choose what is selected in the panel's list."""
        self.page.locator("input:visible").first.click()
        self.page.get_by_role("option", name=name, exact=True).click()
        self.until(lambda: self.editor.selected == name)

    def look(self, name: str) -> np.ndarray:
        """Return the page as a person sees it, (H, W, 3)."""
        data = self.page.screenshot()
        if _SHOTS:
            self._shots += 1
            Path(_SHOTS, f"{_SIZE}_{self._shots:02d}_{name}.png").write_bytes(data)
        return imageio.imread(io.BytesIO(data))[..., :3].astype(int)


def test_a_person_makes_a_scene_plays_it_and_makes_a_task(page: Page, person: ModuleType, editor: Editor) -> None:
    session, me = editor.session, Person(page, editor, person)
    page.goto(f"{editor.url}/?fixedDpr={_DRAWN}")
    page.get_by_role("tab", name="Add").wait_for()
    me.tab("Add")
    me.add("table", "table")
    me.until(lambda: page.locator("img[alt='table']").count() == 1)  # with its picture
    me.add("mug", "mug")
    table, mug = (session.document.item(name) for name in ("table", "mug"))
    assert session.builder.bounds(mug)[0][2] == pytest.approx(table.position[2], abs=0.01)
    me.until(lambda: page.locator("img[alt='mug']").count() == 1)
    me.look("added")

    # Properties: typed, then undone and done again by the keyboard.
    me.tab("Scene")
    page.get_by_text("Friction").wait_for()
    label = page.get_by_text("Mass, kg", exact=True)
    field = page.locator("input:visible").nth(_index_of(page, label))
    field.fill("0.5")
    me.until(lambda: session.document.item("mug").mass == 0.5)
    me.look("mug")
    page.mouse.click(100, 600)  # keys are the page's where no field has them
    page.keyboard.press("Control+z")
    me.until(lambda: session.document.item("mug").mass is None)
    page.keyboard.press("Control+Shift+z")
    me.until(lambda: session.document.item("mug").mass == 0.5)
    me.choose("mug")
    me.press("Duplicate")
    me.until(lambda: editor.selected == "mug_2")
    me.press("Delete")
    me.until(lambda: [item.name for item in session.document.items] == ["table", "mug"])

    # A mug that is lifted falls back to the table.
    me.choose("mug")
    editor.do("lift", lambda document: _lifted(document))
    me.until(lambda: session.history.undo_label == "lift")
    me.press("Drop")
    me.until(lambda: session.history.undo_label == "drop mug")
    assert session.builder.bounds(session.document.item("mug"))[0][2] == pytest.approx(table.position[2], abs=0.005)

    # A camera shows a picture of what it sees.
    me.tab("Add")
    me.add("camera", "camera")
    assert isinstance(session.document.sensor("camera"), CameraSpec)
    me.tab("Scene")
    page.get_by_text("Live picture").wait_for()
    me.until(lambda: editor.pictures_drawn > 0)
    me.look("camera")

    # Physics, and back to what was edited.
    before = session.document
    me.tab("Play")
    me.press("Play")
    me.until(lambda: editor.playing is not None and "0." in editor.playing.words)
    me.look("play")
    me.press("Stop, and restore")
    me.until(lambda: editor.playing is None)
    assert session.document == before

    # A task of it, which runs from its file.
    me.tab("Add")
    me.add("cartpole", "cartpole")
    me.tab("Scene")
    me.choose("mug")
    me.tab("Task")
    me.press("Make a task of what is selected")
    me.until(lambda: session.document.task is not None and editor.selected == GOAL)
    me.look("task")
    me.tab("File")
    me.press("Save as TOML")
    me.until(lambda: session.history.saved)
    me.look("file")
    assert load_document(session.path) == session.document
    environment = make(str(session.path), backend="mujoco")
    environment.reset()
    assert environment.task.plan.objects == ("mug",)
    environment.close()


def _index_of(page: Page, label) -> int:
    """Return the number of the visible input that stands next to a label."""
    middle = label.bounding_box()
    rows = [box for field in page.locator("input:visible").all() if (box := field.bounding_box())]
    heights = [abs(box["y"] + box["height"] / 2 - middle["y"] - middle["height"] / 2) for box in rows]
    return int(np.argmin(heights))


def _lifted(document):
    from orbit_scenes.document import edits

    x, y, z = document.item("mug").position
    return edits.change(document, "mug", position=(x, y, z + 0.2))
