"""Merging fixed links changes nothing that physics can see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate
from orbit_core.scene import Articulation, Frame, Joint, JointType, Link, LoopJoint, LoopType, Pose, Shape, Sphere

_number = st.floats(-1.0, 1.0)
_vector = st.tuples(_number, _number, _number)
_pose = st.builds(Pose.from_euler, _number, _number, _number, position=_vector)


@st.composite
def _link(draw: st.DrawFn, name: str) -> Link:
    size = np.array(draw(st.tuples(*[st.floats(0.05, 0.5)] * 3))) ** 2
    mass = draw(st.floats(0.1, 5.0))
    rotation = draw(_pose).rotation_matrix()
    inertia = rotation @ (mass / 3 * np.diag(size.sum() - size)) @ rotation.T
    shape = Shape(Sphere(0.1), draw(_pose), name=name)
    return Link(name, mass, draw(_vector), inertia, (shape,), (shape,), semantic_label=name)


@st.composite
def _tree(draw: st.DrawFn) -> Articulation:
    links = [draw(_link(f"link{index}")) for index in range(6)]
    joints = []
    for index in range(1, 6):
        kind = draw(st.sampled_from([JointType.FIXED, JointType.REVOLUTE, JointType.PRISMATIC]))
        parent = f"link{draw(st.integers(0, index - 1))}"
        joints.append(Joint(f"joint{index}", kind, parent, f"link{index}", draw(_pose), draw(_pose)))
    return Articulation("tree", tuple(links), tuple(joints), (Frame("tip", "link5", draw(_pose)),))


def link_poses(articulation: Articulation, positions: dict[str, float]) -> dict[str, Pose]:
    """Every link's pose in the root, by the definition of a joint."""
    poses = {articulation.root.name: Pose()}
    for joint in articulation.joints:
        value = positions.get(joint.name, 0.0)
        x, y, z = joint.axis
        if joint.type is JointType.REVOLUTE:
            motion = Pose.from_axis_angle(joint.axis, value)
        else:
            motion = Pose((x * value, y * value, z * value)) if joint.movable else Pose()
        poses[joint.child] = poses[joint.parent] @ joint.parent_pose @ motion @ joint.child_pose.inverse()
    return poses


def _spatial_inertia(articulation: Articulation, positions: dict[str, float]) -> np.ndarray:
    """Mass, first and second moments of all links as one matrix (4, 4) in the root's axes: they add up plainly."""
    total = np.zeros((4, 4))
    poses = link_poses(articulation, positions)
    for link in articulation.links:
        own = np.zeros((4, 4))
        own[:3, :3] = 0.5 * np.trace(link.inertia) * np.eye(3) - link.inertia
        center = np.array([*link.center_of_mass, 1.0])
        matrix = poses[link.name].matrix()
        total += matrix @ (own + link.mass * np.outer(center, center)) @ matrix.T
    return total


def _shape_positions(articulation: Articulation, positions: dict[str, float]) -> dict[str, tuple[float, ...]]:
    poses = link_poses(articulation, positions)
    return {
        shape.name: (poses[link.name] @ shape.pose).position for link in articulation.links for shape in link.collisions
    }


@given(_tree(), st.lists(_number, min_size=5, max_size=5))
@settings(max_examples=50, deadline=None)
def test_merging_keeps_mass_inertia_shapes_and_frames(tree: Articulation, values: list[float]) -> None:
    positions = {f"joint{index + 1}": value for index, value in enumerate(values)}
    merged = validate(merge_fixed_links(tree))
    assert all(joint.movable for joint in merged.joints)
    np.testing.assert_allclose(_spatial_inertia(merged, positions), _spatial_inertia(tree, positions), atol=1e-9)
    before, after = _shape_positions(tree, positions), _shape_positions(merged, positions)
    for name, position in before.items():
        np.testing.assert_allclose(after[name], position, atol=1e-9)
    poses, merged_poses = link_poses(tree, positions), link_poses(merged, positions)
    for name in (*tree.link_names, "tip"):
        old, new = tree.frame(name), merged.frame(name)
        np.testing.assert_allclose(
            (merged_poses[new.link] @ new.pose).matrix(), (poses[old.link] @ old.pose).matrix(), atol=1e-9
        )


def test_two_balls_on_a_rod_have_the_textbook_inertia() -> None:
    balls = [Link(name, 2.0, inertia=0.01 * np.eye(3)) for name in ("a", "b")]
    rod = Joint("rod", JointType.FIXED, "a", "b", parent_pose=Pose((1.0, 0.0, 0.0)))
    (link,) = merge_fixed_links(Articulation("dumbbell", tuple(balls), (rod,))).links
    assert link.mass == 4.0
    assert link.center_of_mass == (0.5, 0.0, 0.0)
    np.testing.assert_allclose(link.inertia, np.diag([0.02, 1.02, 1.02]))


def test_labels_exclusions_and_massless_frames() -> None:
    body = {"mass": 1.0, "inertia": np.eye(3)}
    links = (
        Link("base", **body, semantic_label="base"),
        Link("mount"),
        Link("arm", **body),
        Link("tool", **body, semantic_label="tool"),
    )
    joints = (
        Joint("a", JointType.FIXED, "base", "mount", Pose((0.0, 0.0, 1.0))),
        Joint("b", JointType.REVOLUTE, "mount", "arm", Pose((0.0, 1.0, 0.0))),
        Joint("c", JointType.FIXED, "arm", "tool"),
    )
    pairs = (("mount", "tool"), ("arm", "tool"), ("base", "arm"))
    merged = merge_fixed_links(Articulation("thing", links, joints, collision_exclusions=pairs))
    assert merged.link_names == ("base", "arm")
    assert [link.semantic_label for link in merged.links] == ["base", ""]
    assert merged.links[0].mass == 1.0
    assert merged.frame("mount") == Frame("mount", "base", Pose((0.0, 0.0, 1.0)))
    assert merged.joints[0].parent == "base"
    assert merged.joints[0].parent_pose.position == (0.0, 1.0, 1.0)
    assert merged.collision_exclusions == (("base", "arm"),)


def test_nothing_to_merge_returns_the_same() -> None:
    articulation = Articulation("ball", (Link("ball", 1.0, inertia=np.eye(3)),))
    assert merge_fixed_links(articulation) is articulation
    with pytest.raises(KeyError):
        merge_fixed_links(replace(articulation, frames=(Frame("tip", "ball"),))).frame("nowhere")


def test_a_loop_moves_to_the_link_that_takes_its_end_in() -> None:
    links = tuple(Link(name, 1.0, inertia=np.eye(3)) for name in ("base", "arm", "tip"))
    turned = Pose.from_axis_angle((0.0, 0.0, 1.0), np.pi / 2, (0.5, 0.0, 0.0))
    joints = (
        Joint("turn", JointType.CONTINUOUS, "base", "arm"),
        Joint("weld", JointType.FIXED, "arm", "tip", parent_pose=turned),
    )
    loop = LoopJoint("pin", "base", "tip", (0.1, 0.0, 0.0), (0.2, 0.0, 0.0))
    (merged,) = merge_fixed_links(Articulation("arm", links, joints, loops=(loop,))).loops
    assert (merged.first, merged.second, merged.first_point) == ("base", "arm", (0.1, 0.0, 0.0))
    assert merged.second_point == pytest.approx((0.5, 0.2, 0.0))


def test_a_weld_keeps_what_it_holds_when_an_end_is_merged() -> None:
    links = tuple(Link(name, 1.0, inertia=np.eye(3)) for name in ("base", "arm", "tip"))
    mount = Pose.from_euler(0.3, -0.4, 0.5, (0.5, 0.0, 0.0))
    joints = (
        Joint("turn", JointType.CONTINUOUS, "base", "arm"),
        Joint("mount", JointType.FIXED, "arm", "tip", parent_pose=mount),
    )
    held = Pose.from_euler(0.1, 0.7, -0.2)
    weld = LoopJoint("weld", "base", "tip", type=LoopType.WELD, orientation=held.orientation)
    (merged,) = merge_fixed_links(Articulation("arm", links, joints, loops=(weld,))).loops
    assert merged.type is LoopType.WELD
    # The tip stands in the base as held, so the arm stands as held and the mount undone.
    assert merged.orientation == pytest.approx((held @ mount.inverse()).orientation)
