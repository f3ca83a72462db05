"""Tasks of arms on bases stand in rooms from files, such as a scanned hall; what overlaps is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from orbit_assets.objects import box
from orbit_assets.usd.scene_writer import write_usd_scene
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import ObjectSpec, Pose, Scene
from orbit_scenes.scan import cleaned, on_floor, read_scan, scan_scene
from orbit_tasks.mobile_lift import MobileLift
from orbit_tasks.mobile_reach import MobileReach
from orbit_tasks.room_reorganization import RoomReorganization


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the scene of a noisy scan, in millimetres and y up, of an open hall of 7 x 6.5 m with a pillar in it."""
    folder = tmp_path_factory.mktemp("hall")
    inside = trimesh.creation.box(extents=(7.05, 6.45, 0.85), transform=Pose((0.0, 0.0, 0.425)).matrix())
    inside.update_faces(inside.face_normals[:, 2] < 0.5)
    inside.invert()
    pillar = trimesh.creation.box(extents=(0.3, 0.3, 1.0), transform=Pose((-3.2, -2.9, 0.5)).matrix())
    mesh = trimesh.util.concatenate([inside, pillar])
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 0.3)
    merged = trimesh.Trimesh(vertices, faces)
    noise = np.random.default_rng(0).normal(0.0, 0.004, merged.vertices.shape)
    turned = (merged.vertices + noise)[:, (0, 2, 1)] * (1.0, 1.0, -1.0)
    trimesh.Trimesh(1000.0 * turned, merged.faces, process=False).export(folder / "hall.ply")
    scan = on_floor(cleaned(read_scan(folder / "hall.ply", unit=0.001, up="y")))
    write_usd_scene(scan_scene(scan, voxel=0.1), folder / "hall.usdc")
    return folder / "hall.usdc"


def test_the_walls_of_a_scan_stand_around_a_task_at_its_place(hall: Path) -> None:
    scene = MobileReach(surroundings=str(hall), surroundings_place=(1.0, 0.5, 0.0)).scene()
    (walls,) = (thing for thing in scene.objects if thing.name == "scan")
    assert walls.pose.position == pytest.approx((1.0, 0.5, 0.0), abs=1e-6)
    assert walls.semantic_label == "scan" or walls.articulation.root.semantic_label == "scan"
    own = RoomReorganization().scene()
    within = RoomReorganization(surroundings=str(hall)).scene()
    assert len(own.terrain) == 5
    assert len(within.terrain) == 1, "the scan has walls of its own"


def test_a_room_that_reaches_into_what_the_task_brings_is_named(hall: Path, tmp_path: Path) -> None:
    task = MobileLift(surroundings=str(hall), surroundings_place=(5.0, 0.0, 0.0))
    with pytest.raises(ConfigurationError, match=r"'scan' of .* is where the task's 'table' stands, .*cut it out"):
        task.scene()
    loose = Scene(objects=(box("ball", (0.1, 0.1, 0.1)),))
    write_usd_scene(loose, tmp_path / "loose.usda")
    with pytest.raises(ConfigurationError, match="has no fixed object"):
        MobileReach(surroundings=str(tmp_path / "loose.usda")).scene()


def test_a_room_keeps_what_it_calls_as_the_task_does_under_another_name(tmp_path: Path) -> None:
    board: ObjectSpec = box("table", (0.2, 0.2, 0.2), fixed_base=True, pose=Pose((9.0, 0.0, 0.1)))
    desk = replace(board, name="desk", pose=Pose((9.0, 3.0, 0.1)))
    write_usd_scene(Scene(objects=(board, desk)), tmp_path / "r.usda")
    names = [thing.name for thing in MobileLift(surroundings=str(tmp_path / "r.usda")).scene().objects]
    assert names[-2:] == ["room_table", "desk"]
