"""The editor without a browser: what its buttons do, its catalogue, its pictures and its guard."""

from __future__ import annotations

import http.client
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_core.scene import CameraSpec, Pose
from orbit_scenes.cli.edit import main
from orbit_scenes.document.files import SENSORS, load_document
from orbit_scenes.document.session import Session
from orbit_scenes.editor import pictures
from orbit_scenes.editor.catalogue import Entry, Group, entries, search, sensor_for
from orbit_scenes.editor.editor import Editor
from orbit_scenes.editor.panel import GOAL
from orbit_scenes.editor.properties import euler


@pytest.fixture
def editor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Editor]:
    """An editor whose loop the test turns; pictures are not drawn."""
    monkeypatch.setattr("orbit_scenes.editor.library.thumbnail", lambda entry, renderer: None)
    monkeypatch.setattr(Editor, "_show_pictures", lambda self: None)
    session = Session(tmp_path / "room.toml")
    with Editor(session, ["mujoco"], "mujoco", port=8197) as made:
        yield made
    session.close()


def entry(group: Group, name: str) -> Entry:
    return next(each for each in entries() if each.group is group and each.name == name)


def add(editor: Editor, group: Group, name: str) -> None:
    editor.add(entry(group, name))
    editor._turn()


# The catalogue


def test_search_finds_words_in_any_order_under_a_heading_and_compositions():
    assert search("box")[0].name == "box"
    assert {each.group for each in search("", Group.FURNITURE)} == {Group.FURNITURE}
    assert "franka_panda" in [each.name for each in search("panda franka")]
    assert [each.name for each in search("ur10+robotiq_2f85")] == ["ur10+robotiq_2f85"]
    assert not search("ur10+robotiq")
    assert not search("no such thing")


def test_every_object_and_piece_of_furniture_of_the_catalogue_can_be_built(editor: Editor):
    for each in entries():
        if each.group in (Group.FURNITURE, Group.OBJECT):
            entity = editor.session.builder.entity(each.item("item"))
            assert entity.articulation.links, each.name


@pytest.mark.parametrize("kind", [kind for kind in SENSORS if kind != "camera"])
def test_every_kind_of_sensor_can_be_added_to_a_robot_and_only_cameras_need_none(editor: Editor, kind: str):
    if issubclass(SENSORS[kind], CameraSpec):
        assert sensor_for(kind, "sensor", None, Pose()).name == "sensor"
    else:
        with pytest.raises(ConfigurationError, match="select the robot or object"):
            sensor_for(kind, "sensor", None, Pose())
    add(editor, Group.ROBOT, "cartpole")
    add(editor, Group.SENSOR, kind)
    assert [sensor.name for sensor in editor.session.document.sensors] == [kind]
    editor.session.save()
    assert load_document(editor.session.path) == editor.session.document


# Buttons


def test_what_is_added_stands_on_what_is_selected_and_is_selected_itself(editor: Editor):
    add(editor, Group.OBJECT, "table")
    add(editor, Group.THING, "mug")
    bottom = editor.session.builder.bounds(editor.session.document.item("mug"))[0][2]
    assert bottom == pytest.approx(editor.session.document.item("table").position[2], abs=2e-3)
    assert editor.selected == "mug"
    editor.duplicate()
    editor._turn()
    assert editor.selected == "mug_2"
    editor.delete()
    editor._turn()
    assert editor.selected == ""
    assert [item.name for item in editor.session.document.items] == ["table", "mug"]


def test_a_drag_snaps_and_is_one_edit(editor: Editor):
    add(editor, Group.OBJECT, "box")
    start = editor.session.document.item("box").position
    half = math.sqrt(0.5)
    for phase, x in (("start", 0.0), ("update", 0.11), ("update", 0.27), ("end", 0.27)):
        editor._put(lambda phase=phase, x=x: editor._drag(phase, (x, start[1], start[2]), (half, 0.0, 0.0, half)))
    editor._turn()
    item = editor.session.document.item("box")
    assert item.position == pytest.approx((0.25, start[1], start[2]))  # the panel's grid is 5 cm
    assert item.orientation == pytest.approx((half, 0.0, 0.0, half))
    editor.undo()
    editor._turn()
    assert editor.session.document.item("box").position == start


def test_a_camera_on_a_moving_link_is_dragged_in_the_frame_that_carries_it(editor: Editor):
    add(editor, Group.ROBOT, "cartpole")
    spec = CameraSpec(name="eye", entity="cartpole", frame="cart", pose=Pose((0.1, 0.0, 0.0)))
    from orbit_scenes.document import edits

    editor.do("add eye", lambda document: edits.add_sensor(document, spec))
    editor.select("eye")
    editor._turn()
    before = editor._gizmo_pose()
    assert before is not None
    x, y, z = before.position
    editor._put(lambda: editor._drag("end", (x, y, z + 0.5), before.orientation))
    editor._turn()
    after = editor._gizmo_pose()
    assert after is not None
    # On the panel's grid of 5 cm, in the scene's axes.
    assert after.position == pytest.approx((x, y, round((z + 0.5) / 0.05) * 0.05), abs=1e-5)


def test_an_edit_that_is_refused_is_reported_and_changes_nothing(editor: Editor):
    from orbit_scenes.document import edits

    add(editor, Group.THING, "mug")
    document = editor.session.document
    editor.do("change mass", lambda document: edits.change(document, "mug", mass=-1.0))
    editor._turn()
    assert editor.session.document == document
    assert "mass cannot be -1.0" in editor._note


def test_stopping_restores_what_was_edited_and_keeping_makes_an_edit(editor: Editor):
    from orbit_scenes.document import edits

    add(editor, Group.OBJECT, "box")
    editor.do("lift", lambda document: edits.change(document, "box", position=(0.0, 0.0, 0.5)))
    editor._turn()
    document = editor.session.document
    editor.play()
    for _ in range(10):
        editor._turn()
    assert editor.playing is not None
    editor.do("move", lambda document: edits.change(document, "box", position=(0.0, 0.0, 0.7)))
    editor._turn()
    assert "stop it first" in editor._note
    editor.play()
    editor._turn()
    assert editor.session.document == document
    editor.play()
    for _ in range(10):
        editor._turn()
    editor.keep()
    editor._turn()
    assert editor.playing is None
    assert editor.session.document.item("box").position[2] < 0.49
    editor.undo()
    editor._turn()
    assert editor.session.document == document


def test_a_task_is_made_of_what_is_selected_and_tried_at_once(editor: Editor):
    editor.make_task()
    editor._turn()
    assert "needs a robot" in editor._note
    add(editor, Group.ROBOT, "cartpole")
    add(editor, Group.OBJECT, "box")
    editor.make_task()
    editor._turn()
    assert editor.selected == GOAL
    editor.try_task("random")
    for _ in range(3):
        editor._turn()
    assert editor.playing is not None
    assert "random agent, return" in editor.playing.words
    editor.play()
    editor._turn()
    assert load_document(editor.session.path).task == editor.session.document.task


def test_rotations_are_shown_as_angles_that_make_the_same_rotation():
    for angles in ((10.0, 20.0, -170.0), (0.0, 90.0, 30.0), (-179.0, 0.0, 0.0)):
        roll, pitch, yaw = (math.radians(angle) for angle in angles)
        pose = Pose.from_euler(roll, pitch, yaw)
        again = Pose.from_euler(*(math.radians(angle) for angle in euler(pose.orientation)))
        assert again.orientation == pytest.approx(pose.orientation, abs=1e-4)


# Pictures


def test_a_thumbnail_is_drawn_once_and_then_read_from_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("ORBIT_CACHE_DIR", str(tmp_path))
    ball = entry(Group.OBJECT, "sphere")
    first = pictures.thumbnail(ball, "mujoco")
    assert first is not None
    assert first.shape == (96, 128, 3)
    assert first.std() > 5.0  # not one colour

    def never(*_: object) -> None:
        raise AssertionError("it is drawn again")

    monkeypatch.setattr(pictures, "draw_thumbnail", never)
    again = pictures.thumbnail(ball, "mujoco")
    assert again is not None
    assert np.array_equal(first, again)


# The server


def test_the_editors_page_is_behind_the_viewers_guard(editor: Editor):
    port = int(editor.url.rsplit(":", 1)[1])

    def status(**headers: str) -> int:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
        connection.request("GET", "/", headers=headers)
        return connection.getresponse().status

    assert status() == 200
    assert status(Host="editor.example.org") == 403
    assert status(Origin="https://example.org") == 403


def test_an_address_that_other_computers_reach_has_a_token(tmp_path: Path):
    session = Session(tmp_path / "room.toml")
    with Editor(session, ["mujoco"], "mujoco", host="0.0.0.0", port=8198) as made:
        assert "/?token=" in made.url
    session.close()


def test_the_command_refuses_what_it_cannot_edit_before_it_serves(tmp_path: Path):
    with pytest.raises(ConfigurationError, match="is no scene file by its name"):
        main([str(tmp_path / "room.blend"), "--backend", "mujoco"])
    with pytest.raises(UnknownNameError, match="mujoco"):
        main([str(tmp_path / "room.toml"), "--backend", "mujocoo"])
    with pytest.raises(ConfigurationError, match="there is no folder"):
        main([str(tmp_path / "none" / "room.toml"), "--backend", "mujoco"])
    assert not list(tmp_path.iterdir())
