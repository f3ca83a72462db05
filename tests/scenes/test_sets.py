"""Object sets that users have, read from small files of the same layout."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.validation import validate_entity
from orbit_core.scene import JointType
from orbit_scenes.sets import ImportOptions, SetLayout, load_set_object, set_layout


def _box(path: Path, size: tuple[float, float, float]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box(extents=size).export(path)


def test_ycb_brings_its_mass_and_label(tmp_path: Path):
    folder = tmp_path / "003_cracker_box"
    _box(folder / "google_16k" / "textured.obj", (0.16, 0.21, 0.07))
    spec = load_set_object(folder, "box")
    validate_entity(spec)
    assert set_layout(folder)[0] is SetLayout.YCB
    assert (spec.name, spec.semantic_label, spec.fixed_base) == ("box", "cracker_box", False)
    # Calli et al. 2015: 411 g.
    assert spec.articulation.mass == pytest.approx(0.411)


def test_ycb_of_the_other_scans_is_found_and_a_folder_that_is_none_is_named(tmp_path: Path):
    _box(tmp_path / "025_mug" / "poisson" / "textured.obj", (0.08, 0.08, 0.08))
    assert load_set_object(tmp_path / "025_mug").articulation.mass == pytest.approx(0.118)
    _box(tmp_path / "mug" / "google_16k" / "textured.obj", (0.08, 0.08, 0.08))
    with pytest.raises(AssetError, match="named as 003_cracker_box"):
        load_set_object(tmp_path / "mug")


def test_google_scanned_objects_have_the_category_of_their_metadata(tmp_path: Path):
    folder = tmp_path / "Threshold_Porcelain_Mug"
    _box(folder / "meshes" / "model.obj", (0.1, 0.08, 0.1))
    (folder / "metadata.pbtxt").write_text('name: "Mug"\nannotations {\n  category: "Coffee Mug"\n}\n')
    spec = load_set_object(folder, options=ImportOptions(density=1000.0))
    assert spec.semantic_label == "coffee_mug"
    assert spec.articulation.mass == pytest.approx(0.8)


def test_objaverse_is_scaled_to_the_height_that_is_given_and_refused_without(tmp_path: Path):
    _box(tmp_path / "glbs" / "000-023" / "8ff7f1f2.glb", (1.0, 4.0, 2.0))
    (tmp_path / "metadata").mkdir()
    entry = {"8ff7f1f2": {"name": "A lamp", "categories": [{"name": "Furniture Home"}]}}
    (tmp_path / "metadata" / "000-023.json").write_text(json.dumps(entry))
    file = tmp_path / "glbs" / "000-023" / "8ff7f1f2.glb"
    with pytest.raises(AssetError, match="which has no unit"):
        load_set_object(file)
    spec = load_set_object(file, options=ImportOptions(height=0.4))
    points = np.asarray(spec.articulation.root.collisions[0].geometry.vertices)  # pyright: ignore[reportAttributeAccessIssue]
    # glTF has y up: its 4 units of y are 0.4 m of z.
    assert np.ptp(points, axis=0) == pytest.approx((0.1, 0.2, 0.4), abs=1e-6)
    assert spec.semantic_label == "furniture_home"


_MOBILITY = """<robot name="partnet_1"><link name="base"/>
<link name="link_1"><visual><geometry><mesh filename="textured_objs/a.obj"/></geometry></visual>
<collision><geometry><mesh filename="textured_objs/a.obj"/></geometry></collision></link>
<link name="link_0"><visual><geometry><mesh filename="textured_objs/b.obj"/></geometry></visual>
<collision><geometry><mesh filename="textured_objs/b.obj"/></geometry></collision></link>
<joint name="joint_1" type="fixed"><origin rpy="1.570796326794897 0 -1.570796326794897" xyz="0 0 0"/>
<child link="link_1"/><parent link="base"/></joint>
<joint name="joint_0" type="revolute"><origin xyz="0.3 0 0.4"/><axis xyz="0 1 0"/><child link="link_0"/>
<parent link="link_1"/><limit lower="0" upper="1.57"/></joint></robot>"""


def test_partnet_mobility_has_joints_masses_and_labels_of_its_links(tmp_path: Path):
    folder = tmp_path / "7119"
    _box(folder / "textured_objs" / "a.obj", (0.6, 0.8, 0.6))
    _box(folder / "textured_objs" / "b.obj", (0.3, 0.7, 0.02))
    (folder / "mobility.urdf").write_text(_MOBILITY)
    (folder / "meta.json").write_text(json.dumps({"model_cat": "Microwave"}))
    (folder / "semantics.txt").write_text("link_0 hinge rotation_door\nlink_1 heavy microwave_body\n")
    spec = load_set_object(folder)
    validate_entity(spec)
    assert spec.fixed_base
    assert spec.semantic_label == "microwave"
    assert [joint.type for joint in spec.articulation.movable_joints] == [JointType.REVOLUTE]
    labels = {link.name: link.semantic_label for link in spec.articulation.links}
    assert labels["link_0"] == "rotation_door"
    assert all(link.mass > 0.1 for link in spec.articulation.links)
    # The files' y is up: 0.8 m of it, half of which is below the origin.
    assert spec.articulation.frame("floor").pose.position[2] == pytest.approx(-0.4, abs=1e-3)


_MODEL = """<mujoco model="apple"><asset>
<mesh file="visual/model_normalized_0.obj" name="visual"/>
<mesh file="collision/model_normalized_collision_0.obj" name="c0"/>
</asset><worldbody><body><body name="object">
<geom solimp="0.998 0.998 0.001" solref="0.001 1" density="50" friction="0.95 0.3 0.1" type="mesh" mesh="visual"
  conaffinity="0" contype="0" group="1"/>
<geom density="200" friction="0.95 0.3 0.1" type="mesh" mesh="c0" group="0"/></body>
<site rgba="0 0 0 0" size="0.005" pos="0 0 -0.04" name="bottom_site"/>
<site rgba="0 0 0 0" size="0.005" pos="0 0 0.04" name="top_site"/></body></worldbody></mujoco>"""


def test_robocasa_is_read_by_its_model_with_the_category_of_its_folder(tmp_path: Path):
    folder = tmp_path / "objects" / "apple" / "apple_3"
    _box(folder / "visual" / "model_normalized_0.obj", (0.08, 0.08, 0.08))
    _box(folder / "collision" / "model_normalized_collision_0.obj", (0.07, 0.07, 0.07))
    (folder / "model.xml").write_text(_MODEL)
    spec = load_set_object(folder, options=ImportOptions(mass=0.1))
    validate_entity(spec)
    assert spec.semantic_label == "apple"
    assert spec.articulation.mass == pytest.approx(0.1)
    assert len(spec.articulation.root.collisions) == 1


def test_a_folder_of_no_known_layout_is_named_with_those_that_are_known(tmp_path: Path):
    (tmp_path / "model.stl").write_bytes(b"")
    with pytest.raises(AssetError, match=r"no known set: .*partnet: mobility.urdf; robocasa: model.xml"):
        load_set_object(tmp_path)
    with pytest.raises(AssetError, match="does not exist"):
        load_set_object(tmp_path / "nothing")
