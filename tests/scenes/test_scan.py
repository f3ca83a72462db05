"""Mesh scans: a simulated camera walks through a procedural room, and its fused surface becomes a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from orbit_assets.options import ReadLimits, ReadOptions
from orbit_core.interfaces.errors import ArgumentError, AssetError
from orbit_core.plugin_kit.meshes import triangles
from orbit_core.scene import CameraSpec, Channel, Pose, Scene, look_at
from orbit_core.sensors import intrinsic_matrix
from orbit_core.world import simulate
from orbit_motion.perception import TsdfConfig, TsdfVolume
from orbit_motion.planning import BasePlanner, BasePlannerConfig
from orbit_scenes.certify import certify
from orbit_scenes.furnish import furnished
from orbit_scenes.house import building
from orbit_scenes.plan import Plan, Rectangle, Room, RoomKind, Wall
from orbit_scenes.scan import (
    Scan,
    ScanCollision,
    cleaned,
    cut_out,
    decimated,
    extract_surface,
    floor_map,
    on_floor,
    read_scan,
    scan_object,
    scan_scene,
    voxel_boxes,
)
from orbit_scenes.things import thing

VOXEL = 0.04


@dataclass(frozen=True)
class Walk:
    """A scan of a room, and the truth that it was taken of."""

    scan: Scan
    truth: trimesh.Trimesh
    scene: Scene


def room() -> Scene:
    """Return a living room of 5 x 4 m without doors."""
    floor = Rectangle(-2.56, -2.06, 2.56, 2.06)
    walls = (
        Wall(True, floor.x0, floor.y0, floor.y1, (0,)),
        Wall(True, floor.x1, floor.y0, floor.y1, (0,)),
        Wall(False, floor.y0, floor.x0, floor.x1, (0,)),
        Wall(False, floor.y1, floor.x0, floor.x1, (0,)),
    )
    plan = Plan((Room(RoomKind.LIVING, floor, "living"),), walls, floor)
    layout = furnished(plan, 0, np.random.default_rng(2))
    return Scene(objects=(building(plan), *(piece.build() for piece in (*layout.pieces, *layout.hung))))


def surface_of(scene: Scene) -> trimesh.Trimesh:
    """Return what is drawn of a scene, with its ground, as triangles."""
    parts = [trimesh.creation.box(extents=(6.0, 6.0, 0.02), transform=Pose((0.0, 0.0, -0.01)).matrix())]
    for entity in scene.objects:
        for link in entity.articulation.links:
            for shape in link.visuals:
                mesh = triangles(shape.geometry)
                mesh.apply_transform((entity.pose @ shape.pose).matrix())
                parts.append(mesh)
    return trimesh.util.concatenate(parts)


@pytest.fixture(scope="module")
def walk() -> Walk:
    """Walk a depth camera with noise through the room, and fuse what it sees."""
    scene = room()
    world = simulate(scene, 1, "mujoco")
    spec = CameraSpec(name="eye", width=160, height=120, vertical_fov=1.0, channels=(Channel.DEPTH,))
    renderer = world.create_renderer((spec,), False)
    config = TsdfConfig((-2.72, -2.24, -0.16), VOXEL, (136, 112, 52), truncation=2.5 * VOXEL)
    volume, intrinsics = TsdfVolume(config, 1, torch.device("cpu")), intrinsic_matrix(spec)
    noise = torch.Generator().manual_seed(0)
    for index in range(48):
        angle = 2.0 * math.pi * index / 24
        # Two rounds, the second one looking further down; the eye stays off the furniture in the middle.
        eye = (0.5 * math.cos(angle + 2.5), 0.4 * math.sin(angle + 2.5), 1.5)
        target = (eye[0] + math.cos(angle), eye[1] + math.sin(angle), 1.25 if index < 24 else 0.55)
        view = look_at(eye, target)
        pose = torch.tensor([[*view.position, *view.orientation]])
        depth = renderer.render(spec, pose, world.link_poses, (Channel.DEPTH,), None, None).depth
        assert depth is not None
        # Standard deviation of a structured-light camera: 1.5 mm at 1 m, growing with the square of the distance.
        noisy = depth + 0.0015 * depth.square().clamp_max(36.0) * torch.randn(depth.shape, generator=noise)
        volume.integrate(noisy, intrinsics, pose)
    renderer.close()
    world.close()
    mesh = extract_surface(volume.distances[0].numpy(), volume.weights[0].numpy(), config.lower, VOXEL)
    raw = Scan(np.asarray(mesh.vertices, dtype=np.float64), mesh.faces)
    return Walk(on_floor(cleaned(raw)), surface_of(scene), scene)


def distances(scan: Scan, truth: trimesh.Trimesh, count: int = 1000) -> np.ndarray:
    """Return distances of points of a scan to the true surface, m."""
    points = scan.corners.mean(1)
    chosen = np.random.default_rng(0).choice(len(points), min(count, len(points)), replace=False)
    return trimesh.proximity.closest_point_naive(truth, points[chosen])[1]


def test_a_scan_of_a_room_of_5_by_4_m_is_within_10_mm_rms_of_the_truth(walk: Walk):
    off = distances(walk.scan, walk.truth)
    rms = float(np.sqrt(np.square(off).mean()))
    assert rms <= 0.010


def test_the_floor_of_a_scan_is_level_and_at_zero_and_a_robot_finds_its_place(walk: Walk):
    normals = walk.scan.doubled_normals
    level = normals[:, 2] > 0.98 * np.linalg.norm(normals, axis=1)
    ground = walk.scan.corners[level].mean(1)[:, 2]
    assert abs(np.median(ground[np.abs(ground) < 0.1])) < 0.003
    found = floor_map(walk.scan, radius=0.25, height=1.2, fill_holes=True)
    assert 2.0 < found.area < 16.0
    # Where the sofa is there is no place.
    (sofa,) = (each for each in walk.scene.objects if each.semantic_label == "sofa")
    assert not found.is_free(*sofa.pose.position[:2])
    assert not found.is_free(9.0, 0.0)


def test_things_stand_in_a_scan_on_an_engine(walk: Walk):
    mug = thing("mug")
    (table,) = (each for each in walk.scene.objects if each.semantic_label == "coffee_table")
    x, y, _ = table.pose.position
    # The scanned table goes, and the mug stands on the floor in its place.
    cut = cut_out(walk.scan, Pose((x, y, 0.3)), (0.7, 0.7, 0.25))
    scene = scan_scene(cut, (mug.build("mug", Pose((x, y, mug.rest_height + 0.001))),), voxel=0.08)
    certify(scene, "mujoco", seconds=0.3).check()


def _box_room() -> Scan:
    """Return the inside of a room of 4 x 3 x 2.4 m, all surfaces facing in."""
    mesh = trimesh.creation.box(extents=(4.0, 3.0, 2.4), transform=Pose((0.0, 0.0, 1.2)).matrix())
    for _ in range(4):
        mesh = mesh.subdivide()
    return Scan(np.asarray(mesh.vertices), np.asarray(mesh.faces)[:, ::-1])


def _with_block(size: tuple[float, float, float], middle: tuple[float, float, float]) -> Scan:
    """Return the room with a block in it."""
    block, inside = trimesh.creation.box(extents=size, transform=Pose(middle).matrix()), _box_room()
    vertices = np.concatenate((inside.vertices, block.vertices))
    return Scan(vertices, np.concatenate((inside.faces, np.asarray(block.faces) + len(inside.vertices))))


def test_the_surface_of_a_field_is_where_it_is_zero_and_faces_free_space():
    axis = np.arange(40) * 0.05 + 0.025 - 1.0
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    field = np.sqrt(x**2 + y**2 + z**2) - 0.6
    mesh = extract_surface(field, np.ones_like(field), (-1.0, -1.0, -1.0), 0.05)
    ball = trimesh.Trimesh(mesh.vertices, mesh.faces)
    assert np.abs(np.linalg.norm(ball.vertices, axis=1) - 0.6).max() < 0.002
    assert ball.is_watertight
    assert ball.volume == pytest.approx(4.0 / 3.0 * math.pi * 0.6**3, rel=0.01)


def test_a_field_has_no_surface_where_a_voxel_was_not_seen():
    field = np.broadcast_to(np.linspace(0.1, -0.1, 10), (10, 10, 10)).copy()
    seen = np.ones_like(field)
    whole = extract_surface(field, seen, (0.0, 0.0, 0.0), 0.1)
    seen[:5] = 0.0
    part = extract_surface(field, seen, (0.0, 0.0, 0.0), 0.1)
    assert len(part.faces) < 0.6 * len(whole.faces)
    assert np.asarray(part.vertices)[:, 0].min() >= 0.5
    with pytest.raises(ArgumentError, match="no surface"):
        extract_surface(field, np.zeros_like(field), (0.0, 0.0, 0.0), 0.1)


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_a_scan_of_no_stated_unit_is_refused_and_read_with_unit_and_axis(tmp_path: Path, suffix: str):
    source = _box_room()
    # Millimetres, y up.
    path, turned = tmp_path / f"room.{suffix}", 1000.0 * source.vertices[:, [1, 2, 0]]
    trimesh.Trimesh(turned, source.faces, process=False).export(path)
    with pytest.raises(AssetError, match=r"does not state its unit.*3000 x 2400 x 4000 units"):
        read_scan(path)
    with pytest.raises(AssetError, match="does not state its up axis"):
        read_scan(path, unit=0.001)
    scan = on_floor(cleaned(read_scan(path, unit=0.001, up="y")))
    assert scan.size == pytest.approx((4.0, 3.0, 2.4), abs=1e-3)
    assert scan.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-3)


def test_gltf_is_read_in_metres_with_y_up(tmp_path: Path):
    source = _box_room()
    trimesh.Trimesh(source.vertices[:, [1, 2, 0]], source.faces, process=False).export(tmp_path / "room.glb")
    assert read_scan(tmp_path / "room.glb").size == pytest.approx((4.0, 3.0, 2.4), abs=1e-5)


def _labelled_room(path: Path) -> None:
    """Write a room with a block, whose faces a PLY file labels 1 and 7, in metres, z up."""
    scan, inside = _with_block((0.8, 0.8, 0.6), (0.0, 0.0, 0.3)), _box_room()
    kinds = np.where(np.arange(len(scan.faces)) < len(inside.faces), 1, 7)
    rows = [f"{x} {y} {z}" for x, y, z in scan.vertices]
    rows += [f"3 {a} {b} {c} {kind}" for (a, b, c), kind in zip(scan.faces, kinds, strict=True)]
    head = f"""ply
format ascii 1.0
element vertex {len(scan.vertices)}
property float x
property float y
property float z
element face {len(scan.faces)}
property list uchar int vertex_indices
property int object_id
end_header
"""
    path.write_text(head + "\n".join(rows) + "\n")


def test_labels_of_faces_outlast_cleaning_cutting_and_decimation_and_become_objects(tmp_path: Path):
    _labelled_room(tmp_path / "room.ply")
    scan = on_floor(cleaned(read_scan(tmp_path / "room.ply", unit=1.0, up="z", names={7: "coffee table"})))
    assert set(scan.names) == {"label_1", "coffee table"}
    table = scan.part(scan.names.index("coffee table"))
    assert table.size == pytest.approx((0.8, 0.8, 0.6), abs=1e-3)
    cut = cut_out(scan, Pose((1.9, 0.0, 1.0)), (0.2, 0.5, 0.5))
    assert cut.labels is not None
    assert len(cut.labels) == len(cut.faces) < len(scan.faces)
    objects = scan_scene(cut, voxel=0.1).objects
    assert [(each.name, each.semantic_label) for each in objects] == [
        ("label_1", "label_1"),
        ("coffee_table", "coffee table"),
    ]
    pytest.importorskip("fast_simplification")
    small = decimated(scan, 400)
    assert small.part(small.names.index("coffee table")).size == pytest.approx((0.8, 0.8, 0.6), abs=0.02)


def test_surfaces_of_a_gltf_file_are_labelled_by_their_names(tmp_path: Path):
    scan, inside = _with_block((0.8, 0.8, 0.6), (0.0, 0.0, 0.3)), _box_room()
    parts = {"walls": scan.faces[: len(inside.faces)], "sofa": scan.faces[len(inside.faces) :]}
    file = trimesh.Scene()
    for name, faces in parts.items():
        file.add_geometry(trimesh.Trimesh(scan.vertices[:, [1, 2, 0]], faces, process=False), geom_name=name)
    file.export(tmp_path / "room.glb")
    read = read_scan(tmp_path / "room.glb")
    assert set(read.names) == {"walls", "sofa"}
    assert len(read.part(read.names.index("sofa")).faces) == 12


def test_a_scan_of_too_many_triangles_is_refused_before_it_is_cleaned(tmp_path: Path):
    source = _box_room()
    trimesh.Trimesh(source.vertices, source.faces, process=False).export(tmp_path / "room.ply")
    few = ReadOptions(limits=ReadLimits(vertices=1000))
    with pytest.raises(AssetError, match="holds 3072 triangles: make it smaller, or raise"):
        read_scan(tmp_path / "room.ply", unit=1.0, up="z", options=few)


def test_a_tilted_scan_is_made_level_and_loose_bits_go():
    source = _box_room()
    bit = trimesh.creation.icosphere(radius=0.02).apply_translation((0.0, 0.0, 1.0))
    vertices = np.concatenate((source.vertices, bit.vertices))
    faces = np.concatenate((source.faces, np.asarray(bit.faces) + len(source.vertices)))
    tilted = Pose.from_euler(0.05, -0.08, 0.0, (0.0, 0.0, 0.7)).transform(vertices)
    scan = on_floor(cleaned(Scan(tilted, faces)))
    assert scan.size[2] == pytest.approx(2.4, abs=0.002)
    assert scan.tilt == pytest.approx(math.hypot(0.05, 0.08), abs=0.003)
    assert len(scan.faces) == len(source.faces)


def test_a_scan_without_floor_and_one_of_the_wrong_unit_are_named():
    wall = trimesh.creation.box(extents=(0.1, 3.0, 2.0))
    with pytest.raises(AssetError, match=r"no floor: its fullest level surface is 0\.30 m"):
        on_floor(Scan(np.asarray(wall.vertices), np.asarray(wall.faces)))
    small = _box_room()
    with pytest.raises(AssetError, match="check its unit"):
        cleaned(Scan(0.001 * small.vertices, small.faces))


def test_boxes_hold_the_surface_and_leave_the_room_free():
    pairs = voxel_boxes(_box_room(), 0.1)
    assert len(pairs) < 60
    points = np.array(((1.0, 1.0, 1.0), (0.0, 0.0, 0.5)))
    assert not any((np.abs(points - middle) <= half).all(1).any() for middle, half in pairs)
    low = np.min([middle - half for middle, half in pairs], axis=0)
    assert low == pytest.approx((-2.0, -1.5, 0.0), abs=0.11)


def test_a_hole_in_the_floor_is_measured_and_filled_or_refused():
    scan = cut_out(_box_room(), Pose((0.5, 0.2, 0.0)), (0.3, 0.3, 0.1))
    found = floor_map(scan, 0.2, 1.0)
    assert 0.25 < found.holes < 1.2
    assert not found.is_free(0.5, 0.2)
    assert floor_map(scan, 0.2, 1.0, fill_holes=True).is_free(0.5, 0.2)
    with pytest.raises(AssetError, match="floor has holes of"):
        scan_scene(scan, fill_floor=False)
    with pytest.raises(AssetError, match="leaves its floor to the ground"):
        scan_scene(_box_room(), fill_floor=False)
    with pytest.raises(AssetError, match="no floor of the scan is free"):
        floor_map(scan, 3.0, 1.0)


@pytest.mark.parametrize("collision", ScanCollision)
def test_a_brick_rests_on_a_scanned_table_as_triangles_and_as_boxes(collision: ScanCollision):
    scan = _with_block((0.8, 0.8, 0.6), (0.0, 0.0, 0.3))
    brick = thing("foam_brick").build("brick", Pose((0.0, 0.0, 0.68)))
    world = simulate(scan_scene(scan, (brick,), collision=collision, voxel=0.1), 1, "mujoco")
    world.step(150)
    assert float(world.objects["brick"].root_pose[0, 2]) == pytest.approx(0.625, abs=0.1)
    world.close()


def test_a_robot_base_plans_a_path_around_what_was_scanned():
    scan = _with_block((0.4, 2.0, 1.0), (0.0, -0.5, 0.5))
    world = simulate(scan_scene(scan, voxel=0.1), 1, "mujoco")
    config = BasePlannerConfig(radius=0.25, height=0.4, low=(-2.0, -1.5), high=(2.0, 1.5), resolution=0.1)
    path = BasePlanner(world, config).plan(torch.tensor((-1.2, -0.8)), torch.tensor((1.2, -0.8)))
    world.close()
    # The only way is past the block's end at y = 0.5.
    assert float(path[:, 1].max()) > 0.7


def test_a_scan_is_decimated_without_moving_its_surface():
    pytest.importorskip("fast_simplification")
    scan = _box_room()
    small = decimated(scan, 200)
    assert len(small.faces) <= 220
    assert small.size == pytest.approx(scan.size, abs=1e-3)
    with pytest.raises(ArgumentError, match="four or more"):
        decimated(scan, 1)


def test_a_scan_is_drawn_as_its_surface_and_fixed():
    spec = scan_object(_box_room(), voxel=0.1)
    assert spec.fixed_base
    assert [shape.name for shape in spec.articulation.root.visuals] == ["surface"]
    assert len(spec.articulation.root.collisions) == len(voxel_boxes(_box_room(), 0.1))


def test_a_scan_in_a_wrong_unit_is_refused_before_it_fills_the_memory():
    # A hall of 7 x 6.5 m in millimetres that are taken as metres.
    floor = trimesh.creation.box(extents=(7000.0, 6500.0, 0.1))
    scan = Scan(np.asarray(floor.vertices), np.asarray(floor.faces))
    for made in (lambda: scan_scene(scan), lambda: floor_map(scan, 0.3, 1.0)):
        with pytest.raises(AssetError, match=r"extends over 7000 x 6500 x 0.1 m .*check its unit"):
            made()
