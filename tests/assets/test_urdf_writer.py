"""What is written to URDF comes back the same, and what URDF cannot hold is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from orbit_assets.files import asset_file, load_articulation
from orbit_assets.urdf import read_urdf, write_urdf
from orbit_assets.urdf.writer import roll_pitch_yaw
from orbit_core.interfaces.errors import AssetError, StorageError
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Cylinder,
    Frame,
    Joint,
    JointType,
    Link,
    LoopJoint,
    Mesh,
    Mimic,
    PhysicsMaterial,
    Plane,
    Pose,
    Shape,
    Sphere,
)

CUBE = trimesh.creation.box((0.1, 0.2, 0.3))
MESH = Mesh(CUBE.vertices.astype(np.float32), CUBE.faces.astype(np.int32))


def _mechanism() -> Articulation:
    rng = np.random.default_rng(0)

    def pose() -> Pose:
        x, y, z, roll, pitch, yaw = (float(value) for value in rng.uniform(-1, 1, 6))
        return Pose.from_euler(roll, pitch, yaw, (x, y, z))

    geometries = (Box((0.1, 0.2, 0.3)), Sphere(0.1), Cylinder(0.1, 0.2), Capsule(0.05, 0.1), MESH)
    links = []
    for index, geometry in enumerate(geometries):
        rotation = pose().rotation_matrix()
        inertia = rotation @ np.diag([0.02, 0.03, 0.04]) @ rotation.T
        shape = Shape(geometry, pose(), color=(0.1, 0.2, 0.3, 1.0), name=f"shape{index}")
        links.append(Link(f"link{index}", 1.0 + index, pose().position, inertia, (shape,), (shape,)))
    joints = (
        Joint(
            "a", JointType.REVOLUTE, "link0", "link1", pose(), pose(), (0.0, 0.6, 0.8), -1.0, 2.0, 87.0, 2.5, 0.3, 0.1
        ),
        Joint("b", JointType.CONTINUOUS, "link1", "link2", pose(), pose()),
        Joint("c", JointType.FIXED, "link2", "link3", pose(), pose()),
        Joint("d", JointType.PRISMATIC, "link3", "link4", pose(), pose(), mimic=Mimic("a", -0.5, 0.1)),
    )
    return validate(Articulation("mechanism", tuple(links), joints, (Frame("tip", "link4", pose()),)))


def _placed(articulation: Articulation) -> dict[str, np.ndarray]:
    """Homogeneous transforms in the root, and inertias in its axes, where joints stand at odd positions."""
    poses = {articulation.root.name: Pose()}
    for joint in articulation.joints:
        value = 0.3 + 0.1 * len(joint.name)
        moved = Pose.from_axis_angle(joint.axis, value)
        if joint.type is JointType.PRISMATIC:
            moved = Pose(tuple(value * along for along in joint.axis))
        moved = moved if joint.movable else Pose()
        poses[joint.child] = poses[joint.parent] @ joint.parent_pose @ moved @ joint.child_pose.inverse()
    placed = {frame.name: (poses[frame.link] @ frame.pose).matrix() for frame in articulation.frames}
    for link in articulation.links:
        rotation = poses[link.name].rotation_matrix()
        placed[f"inertia of {link.name}"] = rotation @ link.inertia @ rotation.T
        placed[f"center of {link.name}"] = poses[link.name].transform(link.center_of_mass)
        for shape in (*link.collisions, *link.visuals):
            placed[f"{shape.name} of {link.name}"] = (poses[link.name] @ shape.pose).matrix()
    return placed


def test_a_mechanism_comes_back_with_its_physics(tmp_path: Path) -> None:
    mechanism = _mechanism()
    write_urdf(mechanism, tmp_path / "copy.urdf")
    copy = validate(read_urdf(tmp_path / "copy.urdf"))
    expected, found = _placed(merge_fixed_links(mechanism)), _placed(merge_fixed_links(copy))
    assert found.keys() >= expected.keys() - {"link3"}  # a merged link's frame stands at its joint's
    for name in expected.keys() - {"link3"}:
        np.testing.assert_allclose(found[name], expected[name], atol=1e-9, err_msg=name)
    for old, new in zip(mechanism.joints, copy.joints, strict=False):
        same = replace(old, parent_pose=new.parent_pose, child_pose=new.child_pose)
        np.testing.assert_allclose(new.axis, old.axis, atol=1e-15)
        assert replace(new, axis=old.axis) == (same if old.movable else replace(same, axis=new.axis))
    assert [link.mass for link in copy.links[:5]] == [link.mass for link in mechanism.links]
    (shape,) = copy.links[4].collisions
    assert shape.geometry == MESH, "a mesh keeps its vertices and their order"
    assert copy.links[0].visuals[0].color == (0.1, 0.2, 0.3, 1.0)


def test_one_mesh_of_several_shapes_is_one_file(tmp_path: Path) -> None:
    write_urdf(_mechanism(), tmp_path / "copy.urdf", tmp_path / "elsewhere" / "meshes")
    assert len(list((tmp_path / "elsewhere" / "meshes").iterdir())) == 1
    assert 'filename="elsewhere/meshes/shape4_' in (tmp_path / "copy.urdf").read_text()


def test_what_urdf_cannot_hold_is_said(tmp_path: Path) -> None:
    mechanism = _mechanism()
    joints = (replace(mechanism.joints[0], armature=0.1, stiffness=3.0), *mechanism.joints[1:])
    ground = Shape(Plane(), material=PhysicsMaterial(static_friction=0.3))
    root = replace(mechanism.root, collisions=(ground,), semantic_label="base")
    said = write_urdf(
        replace(
            mechanism,
            links=(root, *mechanism.links[1:]),
            joints=joints,
            loops=(LoopJoint("loop", "link0", "link4"),),
            self_collisions=True,
            home=(("a", 0.5),),
        ),
        tmp_path / "copy.urdf",
    )
    for words in (
        "armature, which joints have: 'a'",
        "springs",
        "planes",
        "friction",
        "labels",
        "loop",
        "home",
        "<caps",
    ):
        assert any(words in sentence for sentence in said), words
    assert not any("drives" in sentence for sentence in said)


def test_a_cabinet_and_odd_names_come_back(tmp_path: Path) -> None:
    cabinet = load_articulation(asset_file("cabinet.usda"))
    odd = replace(cabinet, name='a "cabinet" <&> ü')
    write_urdf(odd, tmp_path / "cabinet.urdf")
    copy = load_articulation(tmp_path / "cabinet.urdf")
    assert (copy.name, copy.link_names, copy.joint_names) == (odd.name, odd.link_names, odd.joint_names)
    assert copy.mass == pytest.approx(cabinet.mass, rel=1e-12)


def test_angles_are_exact_where_pitch_is_a_quarter_turn() -> None:
    for pitch in (np.pi / 2, np.pi / 2 - 1e-9, -np.pi / 2, 0.3):
        pose = Pose.from_euler(0.4, pitch, -2.0)
        again = Pose.from_euler(*roll_pitch_yaw(pose))
        np.testing.assert_allclose(again.rotation_matrix(), pose.rotation_matrix(), atol=1e-14)


def test_files_that_cannot_be_written_are_named(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match=r"name it \*.urdf"):
        write_urdf(_mechanism(), tmp_path / "copy.xml")
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(StorageError, match="taken"):
        write_urdf(_mechanism(), tmp_path / "taken" / "copy.urdf")
