"""Documents of authored scenes: edits, undo, files, recovery. Nothing here knows of a browser."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from orbit_assets.objects import box
from orbit_assets.scene_files import load_scene
from orbit_assets.usd.scene_writer import write_usd_scene
from orbit_core.interfaces.errors import ArgumentError, AssetError, ConfigurationError, OrbitError, UnknownNameError
from orbit_core.interfaces.layout import home_positions
from orbit_core.scene import CameraSpec, DirectionalLight, ImuSpec, Pose, RobotSpec, Scene, look_at
from orbit_scenes.document import (
    History,
    Item,
    JointChange,
    SceneBuilder,
    SceneDocument,
    TaskPlan,
    edits,
    load_document,
    save_document,
)
from orbit_scenes.document.files import document_text, save_usd
from orbit_scenes.document.session import RECOVERED, Session

MUG = Item(name="mug", object="thing", parameters={"thing": "mug"}, position=(0.0, 0.0, 0.1))
TABLE = Item(name="table", object="table", parameters={"size": [0.8, 1.2, 0.4]}, position=(0.0, 0.0, 0.4))
CARTPOLE = Item(name="cart", robot="cartpole")


@pytest.fixture
def builder(tmp_path: Path) -> SceneBuilder:
    return SceneBuilder(tmp_path)


def document(*items: Item, **fields: object) -> SceneDocument:
    return SceneDocument(items=items, **fields)  # type: ignore[arg-type]


# Items and changes


def test_an_items_changes_are_those_of_the_entity_that_is_built(builder: SceneBuilder):
    changed = replace(MUG, mass=0.5, friction=0.3, color=(0.1, 0.2, 0.3), texture="wood", roughness=0.4, fixed=True)
    plain, entity = builder.entity(MUG), builder.entity(changed)
    link, before = entity.articulation.root, plain.articulation.root
    assert link.mass == pytest.approx(0.5)
    assert link.inertia == pytest.approx(before.inertia * (0.5 / before.mass))
    assert {shape.material.static_friction for shape in link.collisions} == {0.3}
    assert {shape.color[:3] for shape in link.visuals} == {(0.1, 0.2, 0.3)}
    assert all(shape.finish.texture is not None and shape.finish.roughness == 0.4 for shape in link.visuals)
    assert entity.fixed_base
    assert not plain.fixed_base


def test_a_joints_limits_home_and_drive_change_and_other_joints_keep_theirs(builder: SceneBuilder):
    arm = Item(name="arm", robot="franka_panda")
    names = builder.entity(arm).articulation.joint_names
    first, second = names[0], names[1]
    entity = builder.entity(replace(arm, joints={first: JointChange(lower=-0.5, upper=0.5, home=0.25, stiffness=70.0)}))
    joint = next(each for each in entity.articulation.joints if each.name == first)
    assert (joint.lower_limit, joint.upper_limit) == (-0.5, 0.5)
    homes = dict(zip(names, home_positions(entity), strict=True))
    before = dict(zip(names, home_positions(builder.entity(arm)), strict=True))
    assert homes[first] == 0.25
    assert homes[second] == before[second]

    def gain(spec: object, name: str) -> float:
        import re

        assert isinstance(spec, RobotSpec)
        return next(g.stiffness for g in spec.actuators if any(re.fullmatch(p, name) for p in g.joints))

    assert gain(entity, first) == 70.0
    assert gain(entity, second) == gain(builder.entity(arm), second)


def test_a_home_that_a_new_limit_cuts_off_moves_to_the_limit(builder: SceneBuilder):
    entity = builder.entity(replace(CARTPOLE, joints={"slider": JointChange(lower=0.2)}))
    assert home_positions(entity)[entity.articulation.joint_names.index("slider")] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("item", "words"),
    [
        (replace(MUG, mass=0.0), "mass cannot be 0.0"),
        (replace(MUG, texture="velvet"), "wood"),
        (replace(MUG, roughness=2.0), "roughness"),
        (replace(MUG, parameters={"thing": "mugg"}), "mug"),
        (replace(MUG, parameters={"thimg": "mug"}), "thing"),
        (replace(MUG, object="thimg", parameters={}), "thing"),
        (replace(MUG, joints={"hinge": JointChange(home=1.0)}), "hinge"),
        (replace(CARTPOLE, robot="cartpol"), "cartpole"),
        (replace(CARTPOLE, joints={"slider": JointChange(lower=2.0, upper=1.0)}), "limits from 2.0 to 1.0"),
        (replace(CARTPOLE, joints={"slider": JointChange(home=99.0)}), "99.0"),
        (replace(MUG, position=(math.nan, 0.0, 0.0)), "mug"),
        (replace(MUG, orientation=(1.0, 1.0, 0.0, 0.0)), "length 1"),
    ],
)
def test_what_an_item_cannot_be_is_one_error_that_names_it(builder: SceneBuilder, item: Item, words: str):
    with pytest.raises(OrbitError, match=words):
        builder.scene(document(item))


def test_a_name_source_or_reference_that_cannot_be_is_refused():
    with pytest.raises(ConfigurationError, match="is no name"):
        Item(name="a mug", object="thing")
    with pytest.raises(ConfigurationError, match="no source"):
        Item(name="mug")
    with pytest.raises(ConfigurationError, match="robot and object"):
        Item(name="mug", object="thing", robot="cartpole")
    with pytest.raises(ConfigurationError, match="two items are called 'mug'"):
        document(MUG, MUG)
    with pytest.raises(UnknownNameError, match="mug"):
        document(MUG, task=TaskPlan(robot="arm", objects=("mug",), goal=(0.0, 0.0, 0.0)))
    with pytest.raises(UnknownNameError, match="mug"):
        document(MUG, sensors=(ImuSpec(name="imu", entity="mgu", frame="mug"),))


# Undo and redo


def test_undo_and_redo_walk_through_the_edits_and_a_new_edit_ends_what_was_undone():
    history = History(document())
    first, second = document(MUG), document(MUG, CARTPOLE)
    assert history.do("add mug", first)
    assert history.do("add cart", second)
    assert not history.do("nothing", second)
    assert (history.undo(), history.document) == ("add cart", first)
    assert (history.undo(), history.document) == ("add mug", document())
    assert history.undo() == ""
    assert (history.redo(), history.document) == ("add mug", first)
    assert history.redo_label == "add cart"
    history.do("add table", document(MUG, TABLE))
    assert history.redo() == ""


def test_edits_that_a_person_makes_stroke_by_stroke_are_one_step():
    history = History(document(MUG))
    for mass in (3.0, 35.0, 35.5):
        history.do("change mass of mug", edits.change(history.document, "mug", mass=mass), merge=True)
    assert history.document.item("mug").mass == 35.5
    history.undo()
    assert history.document == document(MUG)


def test_a_history_knows_whether_its_file_holds_the_document():
    history = History(document())
    assert history.saved
    history.do("add mug", document(MUG))
    assert not history.saved
    history.mark_saved()
    history.undo()
    assert not history.saved
    history.redo()
    assert history.saved


# Edits


def test_a_rename_reaches_sensors_and_the_task():
    imu = ImuSpec(name="imu", entity="cart", frame="cart")
    task = TaskPlan(robot="cart", objects=("mug",), goal=(0.0, 0.0, 0.0))
    before = document(MUG, CARTPOLE, sensors=(imu,), task=task)
    after = edits.rename(edits.rename(before, "cart", "robot"), "mug", "cup")
    assert [item.name for item in after.items] == ["cup", "robot"]
    assert after.sensors == (replace(imu, entity="robot"),)
    assert after.task == replace(task, robot="robot", objects=("cup",))
    assert edits.rename(before, "imu", "gyro").sensors == (replace(imu, name="gyro"),)
    with pytest.raises(ConfigurationError, match="'imu' is there already"):
        edits.rename(before, "mug", "imu")


def test_removing_a_robot_removes_its_sensors_and_its_task():
    imu, task = (
        ImuSpec(name="imu", entity="cart", frame="cart"),
        TaskPlan(robot="cart", objects=("mug",), goal=(0, 0, 0)),
    )
    assert edits.remove(document(MUG, CARTPOLE, sensors=(imu,), task=task), ["cart"]) == document(MUG)


def test_a_copy_has_a_free_name_and_stands_next_to_the_first():
    once, name = edits.duplicate(document(MUG), "mug")
    twice, second = edits.duplicate(once, name)
    assert (name, second) == ("mug_2", "mug_3")
    assert twice.item("mug_3").position == pytest.approx((0.2, 0.0, 0.1))


def test_a_thing_is_put_on_the_highest_thing_below_it(builder: SceneBuilder):
    scene = document(TABLE)
    on, off = (edits.standing_at(scene, builder, MUG, x, 0.0) for x in (0.0, 2.0))
    assert builder.bounds(on)[0][2] == pytest.approx(0.401, abs=1e-3)
    assert builder.bounds(off)[0][2] == pytest.approx(0.001, abs=1e-3)
    assert edits.standing_at(document(), builder, TABLE, 0.0, 0.0).position == pytest.approx((0.0, 0.0, 0.4))


def test_what_is_added_stands_beside_robots_and_things_and_not_on_them(builder: SceneBuilder):
    cart = replace(CARTPOLE, position=(0.0, 0.0, 1.0))
    near = edits.standing_near(document(TABLE, MUG, cart), builder, replace(MUG, name="cup"), 3.0, 0.0)
    assert near.position[:2] == pytest.approx((3.0, 0.0), abs=0.01)
    again = edits.standing_near(document(near), builder, replace(MUG, name="mug"), 3.0, 0.0)
    assert again.position[2] == pytest.approx(near.position[2])
    assert 0.05 < math.dist(again.position, near.position) < 0.5
    arm = Item(name="arm", robot="franka_panda")
    beside, upon = (edits.standing_near(document(TABLE), builder, arm, 0.0, 0.0, on) for on in ("", "table"))
    assert beside.position[2] == pytest.approx(0.0, abs=0.01)
    assert upon.position == pytest.approx((0.0, 0.0, 0.4), abs=0.01)


def test_a_drag_snaps_to_grid_and_angle_and_leaves_other_axes_as_they_were():
    start = Pose.from_euler(0.2, 0.0, 0.0, (0.012, 0.51, 0.77))
    turned = Pose.from_axis_angle((0.0, 0.0, 1.0), math.radians(40.0)) @ Pose(orientation=start.orientation)
    pose = edits.snapped(Pose((0.273, 0.51, 0.77), turned.orientation), start, 0.1, math.radians(15.0))
    assert pose.position == pytest.approx((0.3, 0.51, 0.77))
    wanted = Pose.from_axis_angle((0.0, 0.0, 1.0), math.radians(45.0)) @ Pose(orientation=start.orientation)
    assert pose.orientation == pytest.approx(wanted.orientation)
    assert edits.snapped(turned, start, 0.0, 0.0) == turned


def test_a_dropped_thing_rests_on_what_is_below_and_nothing_else_moves(builder: SceneBuilder):
    other = replace(MUG, name="other", position=(0.3, 0.0, 1.0))
    before = document(TABLE, replace(MUG, position=(0.0, 0.0, 0.8)), other)
    after = edits.settle(before, builder, ["mug"], "mujoco")
    assert builder.bounds(after.item("mug"))[0][2] == pytest.approx(0.4, abs=2e-3)
    assert after.item("other") == other
    with pytest.raises(ConfigurationError, match="'table' does not fall"):
        edits.settle(before, builder, ["table"], "mujoco")
    with pytest.raises(OrbitError, match="mug"):
        edits.settle(replace(document(MUG), ground=None), builder, ["mug"], "mujoco")


# Files


def everything() -> SceneDocument:
    camera = CameraSpec(name="front", pose=look_at((1.0, 1.0, 1.0), (0.0, 0.0, 0.0)), width=64, height=48)
    cart = replace(CARTPOLE, joints={"slider": JointChange(home=0.1, lower=-1.0)})
    mug = replace(MUG, color=(0.1, 0.2, 0.3), mass=0.2)
    return document(
        mug,
        cart,
        sensors=(camera, ImuSpec(name="imu", entity="cart", frame="cart", rate=50.0)),
        suns=(DirectionalLight((0.0, 0.0, -1.0)), DirectionalLight(shadows=False)),
        ground=None,
        task=TaskPlan(robot="cart", objects=("mug",), goal=(0.5, 0.0, 0.1), instruction='bring "it"\\ \x7f'),
    )


def test_a_document_is_read_back_from_its_file_as_it_was(tmp_path: Path):
    path = tmp_path / "scene.toml"
    save_document(everything(), path)
    assert load_document(path) == everything()


def test_what_is_a_default_is_left_out_of_the_file():
    assert document_text(document()) == "orbit_scene = 1\n"
    assert "orientation" not in document_text(document(MUG))


def test_a_document_is_written_as_usd_with_its_changes(tmp_path: Path, builder: SceneBuilder):
    path = tmp_path / "scene.usda"
    lost = save_usd(everything(), builder, path)
    assert any("sensors are left out" in line for line in lost)
    assert any("task" in line for line in lost)
    read = load_scene(path)
    assert {entity.name for entity in read.entities} == {"mug", "cart"}
    mug = next(entity for entity in read.objects if entity.name == "mug")
    assert mug.articulation.root.mass == pytest.approx(0.2)
    assert len(read.directional_lights) == 2


def test_a_usd_scene_is_a_document_whose_items_can_be_changed(tmp_path: Path):
    floor = Scene().terrain
    cubes = (box("red", (0.1, 0.1, 0.1), pose=Pose((0, 0, 1))), box("blue", (0.2, 0.2, 0.2), pose=Pose((1, 0, 0.1))))
    write_usd_scene(Scene(objects=cubes, terrain=floor), tmp_path / "cubes.usda")
    read = load_document(tmp_path / "cubes.usda")
    assert [item.name for item in read.items] == ["red", "blue"]
    save_document(edits.change(read, "red", mass=3.0), tmp_path / "cubes.toml")
    scene = SceneBuilder(tmp_path).scene(load_document(tmp_path / "cubes.toml"))
    masses = {entity.name: entity.articulation.root.mass for entity in scene.objects}
    assert masses["red"] == pytest.approx(3.0)
    assert masses["blue"] == pytest.approx(cubes[1].articulation.root.mass)
    assert len(scene.terrain) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "orbit_scene = None"),
        ("orbit_scene = 2", "another version"),
        ("orbit_scene = 1\n[[items]\n", "is not TOML"),
        ("orbit_scene = 1\nitem = 3", "items"),
        ("orbit_scene = 1\nitems = 3", "items"),
        ('orbit_scene = 1\n[[items]]\nname = "mug"\nobject = "thing"\nmas = 1.0', "mass"),
        ('orbit_scene = 1\n[[items]]\nname = "mug"\nobject = "thing"\nposition = [0.0, 1.0]', "position"),
        ('orbit_scene = 1\n[[items]]\nname = "mug"\nobject = "thing"\nmass = nan', "finite"),
        ('orbit_scene = 1\n[[items]]\nname = "../mug"\nobject = "thing"', "is no name"),
        ('orbit_scene = 1\n[[sensors]]\nkind = "camra"\nname = "a"', "camera"),
        ('orbit_scene = 1\n[[sensors]]\nkind = "camera"\nname = "a"\nwidth = 100000', "4096"),
        ("orbit_scene = 1\nsuns = [{}, {}, {}, {}]", "3"),
        ('orbit_scene = 1\n[task]\nrobot = "arm"\nobjects = []\ngoal = [0.0, 0.0, 0.0]', "no object of interest"),
        ('orbit_scene = 1\n[task]\nrobot = "arm"\nobjects = ["a"]\ngoal = [0.0, 0.0, 0.0]', "arm"),
        ("orbit_scene = 1\n" + '[[items]]\nname="a"\nobject="box"\n' * 1001, "more than 1,000"),
        ("orbit_scene = 1\n#" + "x" * 2**20, "larger than"),
        ("orbit_scene = 1\na = " + "[" * 40 + "]" * 40, "nests deeper"),
    ],
)
def test_a_damaged_file_is_one_error(tmp_path: Path, text: str, words: str):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(OrbitError, match=words):
        SceneBuilder(tmp_path).scene(load_document(path))


@pytest.mark.parametrize(
    "line",
    [
        'file = "../cubes.usda"\nentity = "red"',
        'file = "/etc/hostname"\nentity = "red"',
        'object = "mesh"\nparameters = {file = "../cube.stl"}',
        'robot = "../robot.json"',
        'file = "link.usda"\nentity = "red"',
    ],
)
def test_a_file_names_none_outside_of_its_folder(tmp_path: Path, line: str):
    folder = tmp_path / "scenes"
    folder.mkdir()
    write_usd_scene(Scene(objects=(box("red", (0.1, 0.1, 0.1)),)), tmp_path / "cubes.usda")
    (folder / "link.usda").symlink_to(tmp_path / "cubes.usda")
    (folder / "scene.toml").write_text(f'orbit_scene = 1\n[[items]]\nname = "thing"\n{line}\n')
    with pytest.raises(OrbitError, match="outside of"):
        SceneBuilder(folder).scene(load_document(folder / "scene.toml"))


def test_a_file_of_another_kind_is_refused(tmp_path: Path):
    with pytest.raises(ConfigurationError, match=r"\.toml, \.usd"):
        load_document(tmp_path / "scene.blend")
    with pytest.raises(ConfigurationError, match="cannot read scene file"):
        load_document(tmp_path / "none.toml")
    (tmp_path / "bad.usda").write_text("#usda 1.0\n(")
    with pytest.raises(AssetError, match="bad"):
        load_document(tmp_path / "bad.usda")
    (tmp_path / "s.toml").write_text('orbit_scene = 1\n[[sensors]]\nkind = "camera"\nname = "c"\nnear = 5.0\nfar = 1.0')
    with pytest.raises(ArgumentError, match="near"):
        SceneBuilder(tmp_path).scene(load_document(tmp_path / "s.toml"))


# Sessions

_KILLED = """
import os, signal, sys
from pathlib import Path
from orbit_scenes.document import Item, edits
from orbit_scenes.document.session import Session

session = Session(Path(sys.argv[1]))
box = Item(name="crate", object="box")
session.do("add crate", lambda document: edits.add_item(document, box))
session.save()
session.do("move crate", lambda document: edits.change(document, "crate", position=(1.0, 2.0, 3.0)))
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_session_that_was_killed_is_recovered_and_undo_goes_back_to_the_file(tmp_path: Path):
    path = tmp_path / "room.toml"
    killed = subprocess.run([sys.executable, "-W", "ignore", "-c", _KILLED, str(path)], env=os.environ, check=False)
    assert killed.returncode == -signal.SIGKILL
    assert load_document(path).item("crate").position == (0.0, 0.0, 0.0)
    session = Session(path)
    assert session.recovered
    assert session.document.item("crate").position == (1.0, 2.0, 3.0)
    assert not session.history.saved
    assert session.undo() == RECOVERED
    assert session.document == load_document(path)
    session.redo()
    session.save()
    session.close()
    assert sorted(each.name for each in tmp_path.iterdir()) == ["room.toml"]


def test_an_edit_that_makes_no_scene_is_refused_and_changes_nothing(tmp_path: Path):
    session = Session(tmp_path / "room.toml")
    session.do("add mug", lambda document: edits.add_item(document, MUG))
    with pytest.raises(ConfigurationError, match="mass"):
        session.do("change mass", lambda document: edits.change(document, "mug", mass=-1.0))
    assert session.document == document(MUG)
    assert session.history.undo_label == "add mug"
    session.close()


def test_a_file_is_edited_by_one_session_at_a_time(tmp_path: Path):
    path = tmp_path / "room.toml"
    first = Session(path)
    with pytest.raises(ConfigurationError, match="another 'orbit edit'"):
        Session(path)
    first.close()
    Session(path).close()


def test_a_damaged_autosave_is_one_error_that_says_what_to_do(tmp_path: Path):
    (tmp_path / ".room.toml.autosave").write_text("orbit_scene = 1\nitems = 3")
    with pytest.raises(ConfigurationError, match=r"autosave.*delete it to begin with"):
        Session(tmp_path / "room.toml")
    (tmp_path / ".room.toml.autosave").unlink()
    Session(tmp_path / "room.toml").close()


def test_a_usd_scene_is_edited_as_a_document_next_to_it_and_never_overwritten(tmp_path: Path):
    path = tmp_path / "cubes.usda"
    write_usd_scene(Scene(objects=(box("red", (0.1, 0.1, 0.1), pose=Pose((0, 0, 1))),)), path)
    before = path.read_bytes()
    session = Session(path)
    assert session.path == tmp_path / "cubes.toml"
    session.do("move red", lambda document: edits.place(document, "red", Pose((1.0, 0.0, 1.0))))
    written, _ = session.save_usd()
    assert written == tmp_path / "cubes_edited.usda"
    assert load_scene(written).objects[0].pose.position == pytest.approx((1.0, 0.0, 1.0))
    session.save()
    session.close()
    assert path.read_bytes() == before
    with pytest.raises(ConfigurationError, match=r"cubes\.toml is there already"):
        Session(path)
