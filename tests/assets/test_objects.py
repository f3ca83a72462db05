"""Objects stand, weigh and move as their docstrings say."""

from __future__ import annotations

import itertools
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from orbit_assets.files import asset_folder
from orbit_assets.objects import DENSITY, box, cabinet, capsule, cylinder, keyed_block, mesh_object, sphere, table
from orbit_assets.usd import read_usd
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate, validate_entity
from orbit_core.scene import Box, JointType, Mesh, PhysicsMaterial, Pose, Shape


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ORBIT_CACHE_DIR", str(tmp_path))
    return tmp_path


def corners(shape: Shape, pose: Pose) -> np.ndarray:
    """The corners (8, 3) of a box in the frame in which its link has ``pose``."""
    assert isinstance(shape.geometry, Box)
    signs = np.stack(np.meshgrid(*[(-1, 1)] * 3), -1).reshape(-1, 3)
    return (pose @ shape.pose).transform(signs * np.asarray(shape.geometry.half_extents))


def overlap(first: np.ndarray, second: np.ndarray) -> float:
    """The least depth along the axes by which two boxes aligned with them overlap; negative is a gap."""
    low = np.maximum(first.min(0), second.min(0))
    high = np.minimum(first.max(0), second.max(0))
    return float((high - low).min())


def test_solids() -> None:
    solids = [
        box("a", (0.1, 0.2, 0.3)),
        sphere("b", 0.1),
        cylinder("c", 0.1, 0.4),
        capsule("d", 0.1, 0.4),
        mesh_object("e", Mesh(*mesh_arrays())),
    ]
    volumes = [0.006, 4 / 3 * math.pi * 1e-3, math.pi * 0.004, math.pi * 0.004 + 4 / 3 * math.pi * 1e-3, 0.008]
    for solid, volume in zip(solids, volumes, strict=True):
        validate_entity(solid)
        assert solid.articulation.mass == pytest.approx(DENSITY * volume)
        assert len(solid.articulation.root.collisions) == len(solid.articulation.root.visuals) == 1


def mesh_arrays() -> tuple[np.ndarray, np.ndarray]:
    cube = trimesh.creation.box((0.2, 0.2, 0.2))
    return np.asarray(cube.vertices), np.asarray(cube.faces)


def test_options_reach_the_object() -> None:
    material = PhysicsMaterial(static_friction=0.3)
    pose = Pose((1.0, 2.0, 3.0))
    solid = box(
        "a",
        (0.1, 0.1, 0.1),
        mass=2.0,
        material=material,
        color=(1.0, 0.0, 0.0, 1.0),
        pose=pose,
        fixed_base=True,
        label="x",
    )
    shape = solid.articulation.root.collisions[0]
    assert (shape.material, shape.color) == (material, (1.0, 0.0, 0.0, 1.0))
    assert (solid.pose, solid.fixed_base, solid.semantic_label) == (pose, True, "x")
    assert solid.articulation.mass == 2.0
    assert solid.articulation.root.inertia[0, 0] == pytest.approx(2.0 * 0.01 / 6)


def test_a_mesh_file_is_scaled_to_metres(tmp_path: Path) -> None:
    trimesh.creation.box((100.0, 200.0, 300.0)).export(tmp_path / "box.stl")
    solid = mesh_object("a", tmp_path / "box.stl", scale=0.001, mass=1.0)
    np.testing.assert_allclose(
        solid.articulation.root.inertia, box("b", (0.1, 0.2, 0.3), mass=1.0).articulation.root.inertia, atol=1e-6
    )


def test_the_table_top_is_at_zero_and_its_feet_at_minus_its_height() -> None:
    spec = table(size=(0.6, 0.8, 0.5))
    assert spec.fixed_base
    points = np.concatenate([corners(shape, Pose()) for shape in spec.articulation.root.collisions])
    np.testing.assert_allclose(points.min(0), (-0.3, -0.4, -0.5), atol=1e-12)
    np.testing.assert_allclose(points.max(0), (0.3, 0.4, 0.0), atol=1e-12)


def cabinet_boxes(drawer: float, door: float) -> dict[str, list[np.ndarray]]:
    """Corners of every part of the cabinet with its joints there."""
    articulation = cabinet().articulation
    poses = {articulation.root.name: Pose()}
    for joint in articulation.joints:
        x, y, z = np.asarray(joint.axis) * drawer
        prismatic = joint.type is JointType.PRISMATIC
        motion = Pose((x, y, z)) if prismatic else Pose.from_axis_angle(joint.axis, door)
        poses[joint.child] = poses[joint.parent] @ joint.parent_pose @ motion @ joint.child_pose.inverse()
    return {link.name: [corners(shape, poses[link.name]) for shape in link.collisions] for link in articulation.links}


def test_the_cabinet_is_what_its_docstring_says() -> None:
    spec = cabinet()
    validate_entity(spec)
    assert spec.fixed_base
    articulation = spec.articulation
    assert articulation.link_names == ("cabinet", "drawer", "door")
    assert [link.semantic_label for link in articulation.links] == ["cabinet", "drawer", "door"]
    drawer, door = articulation.movable_joints
    assert (drawer.name, drawer.type, drawer.lower_limit) == ("drawer_joint", JointType.PRISMATIC, 0.0)
    assert (door.name, door.type, door.lower_limit) == ("door_joint", JointType.REVOLUTE, 0.0)
    assert drawer.upper_limit == pytest.approx(0.4)
    assert door.upper_limit == pytest.approx(1.57)
    for joint in (drawer, door):
        assert joint.damping > 0
        assert joint.friction > 0
    closed, opened = cabinet_boxes(0.0, 0.0), cabinet_boxes(0.4, math.pi / 2)
    points = np.concatenate([np.concatenate(parts) for parts in closed.values()])
    assert points[:, 2].min() == pytest.approx(0.0)
    assert points[:, 2].max() == pytest.approx(0.62)
    front = np.concatenate(closed["drawer"])[:, 0].min()
    assert np.concatenate(opened["drawer"])[:, 0].min() == pytest.approx(front - 0.4)
    assert np.concatenate(opened["door"])[:, 0].min() < -0.7
    handle = spec.pose @ articulation.frame("drawer_handle").pose
    np.testing.assert_allclose(handle.position, (0.635, 0.0, 0.4875), atol=1e-6)


@pytest.mark.parametrize("fraction", [0.0, 0.25, 0.5, 0.75, 1.0])
def test_the_cabinet_never_cuts_into_itself(fraction: float) -> None:
    parts = cabinet_boxes(0.4 * fraction, 0.0)
    for first, second in (("cabinet", "drawer"), ("cabinet", "door"), ("drawer", "door")):
        for one in parts[first]:
            for other in parts[second]:
                assert overlap(one, other) < -1e-3, (first, second)
    swung = np.concatenate(cabinet_boxes(0.0, 1.57 * fraction)["door"])
    assert swung[:, 0].max() < np.concatenate(parts["cabinet"])[:, 0].min()
    assert swung[:, 2].max() < np.concatenate(parts["drawer"])[:, 2].min()


@pytest.mark.parametrize(("name", "link", "opening"), [("drawer_handle", "drawer", 2), ("door_handle", "door", 1)])
def test_handles_can_be_grasped(name: str, link: str, opening: int) -> None:
    articulation = cabinet().articulation
    frame = articulation.frame(name)
    assert frame.link == link
    (origin,) = (joint.parent_pose.position for joint in articulation.joints if joint.child == link)
    handle = Pose(origin if link == "door" else (0.0, 0.0, 0.0)) @ frame.pose
    rotation = handle.rotation_matrix()
    np.testing.assert_allclose(rotation[:, 2], (1.0, 0.0, 0.0), atol=1e-6)
    assert abs(rotation[opening, 1]) == pytest.approx(1.0)
    parts = cabinet_boxes(0.0, 0.0)[link]
    bar = next(points for points in parts if np.allclose(points.mean(0), handle.position, atol=1e-6))
    extent = np.ptp(bar, axis=0)
    along = 3 - opening
    assert extent[along] >= 0.10
    assert 0.015 <= extent[opening] <= 0.02
    face = max(parts, key=lambda points: float(np.ptp(points, axis=0)[1:].prod()))
    assert face[:, 0].min() - bar[:, 0].max() >= 0.03


@pytest.mark.parametrize("name", ["cabinet", "dishwasher"])
def test_the_file_matches_the_script_that_makes_it(name: str, tmp_path: Path) -> None:
    script = asset_folder() / f"make_{name}.py"
    copy = tmp_path / script.name
    copy.write_text(script.read_text())
    subprocess.run([sys.executable, str(copy)], check=True, timeout=60)
    assert (tmp_path / f"{name}.usda").read_text() == (asset_folder() / f"{name}.usda").read_text()


def test_a_warm_cache_needs_no_usd(own_cache: Path) -> None:
    whole = merge_fixed_links(validate(read_usd(asset_folder() / "cabinet.usda")))
    cabinet()
    code = (
        "import sys; sys.modules['pxr'] = None\n"
        "from orbit_assets.objects import cabinet\n"
        "print(cabinet().articulation.mass)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert float(run.stdout) == pytest.approx(whole.mass)


def test_a_keyed_block_is_alike_in_no_two_orientations() -> None:
    """None of the 23 turns of a cube onto itself brings its key back, nor does any flip."""
    link = keyed_block("block", 0.06, mass=0.1).articulation.root
    assert link.mass == pytest.approx(0.1)
    key = next(shape for shape in link.visuals if shape.name == "key")
    middle, half = np.array(key.pose.position), np.array(key.geometry.half_extents)  # pyright: ignore[reportAttributeAccessIssue]
    corners = np.array([middle + half * signs for signs in itertools.product((-1, 1), repeat=3)])
    own = {tuple(corner.round(6)) for corner in corners}
    turns = [
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((-1, 1), repeat=3)
    ]
    alike = [turn for turn in turns if {tuple(corner.round(6) + 0.0) for corner in corners @ turn.T} == own]
    assert len(alike) == 1
    assert np.array_equal(alike[0], np.eye(3))
