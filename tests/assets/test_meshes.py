"""Mesh files: each decoded once, vertices merged in order, and files that lie or lack told apart from sound ones."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.exchange.dae import export_collada
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from orbit_assets.meshes import MeshFiles, load_mesh, load_parts, merge_vertices
from orbit_assets.options import ReadOptions
from orbit_assets.urdf import read_urdf
from orbit_core.interfaces.errors import AssetError


def test_points_that_are_one_are_merged_in_the_order_met() -> None:
    corners = np.array([[1, 0, 0], [0, 0, 0], [0, 1, 0], [0, 1, 0], [-0.0, 0, 0], [0, 0, 1], [9, 9, 9]], np.float32)
    vertices, faces = merge_vertices(corners, np.array([[0, 1, 2], [3, 4, 5], [1, 4, 5]]))
    np.testing.assert_array_equal(vertices, [[1, 0, 0], [0, 0, 0], [0, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(faces, [[0, 1, 2], [2, 1, 3]], "a triangle of two points is none")


def test_merging_is_what_numpy_finds_distinct() -> None:
    rng = np.random.default_rng(0)
    points = rng.integers(0, 9, (3000, 3)).astype(np.float32) / 8
    vertices, faces = merge_vertices(points, np.arange(3000).reshape(-1, 3))
    assert len(np.unique(vertices, axis=0)) == len(vertices)
    soup = points.reshape(-1, 3, 3).astype(float)
    solid = np.linalg.norm(np.cross(soup[:, 1] - soup[:, 0], soup[:, 2] - soup[:, 0]), axis=1) > 0
    np.testing.assert_array_equal(vertices[faces], points.reshape(-1, 3, 3)[solid])


def test_two_million_corners_merge_in_seconds() -> None:
    grid = np.stack(np.meshgrid(np.arange(580), np.arange(580)), axis=-1).reshape(-1, 2).astype(np.float32)
    points = np.concatenate([grid, np.zeros((len(grid), 1), np.float32)], axis=1)
    cell = (np.arange(579)[:, None] * 580 + np.arange(579)).ravel()
    faces = np.concatenate([cell[:, None] + [0, 1, 581], cell[:, None] + [0, 581, 580]])
    start = time.process_time()
    vertices, _ = merge_vertices(points[faces.ravel()], np.arange(faces.size).reshape(-1, 3))
    assert len(vertices) == len(points)
    assert time.process_time() - start < 15.0, "on a slow machine; a second or two is usual"


def test_a_file_of_visual_and_collision_is_one_mesh(tmp_path: Path) -> None:
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "box.stl")
    files = MeshFiles(ReadOptions(), tmp_path / "robot.urdf")
    (part,) = files.parts(tmp_path / "box.stl")
    assert files.mesh(tmp_path / "box.stl") is part.mesh
    assert files.mesh(tmp_path / "box.stl", (2.0, 1.0, 1.0)).vertices[:, 0].max() == 1.0


def test_stl_files_that_are_cut_short_say_so(tmp_path: Path) -> None:
    path = tmp_path / "box.stl"
    trimesh.creation.box((1, 1, 1)).export(path)
    whole = path.read_bytes()
    for data, message in (
        (whole[:-60], "says 12 triangles and holds 10"),
        (whole[:80] + b"\xff\xff\xff\x7f" + whole[84:], "says 2147483647 triangles and holds 12"),
        (whole[:50], "fewer than an STL file's header"),
    ):
        path.write_bytes(data)
        with pytest.raises(AssetError, match=message):
            load_mesh(path)


@pytest.mark.parametrize("change", [str, str.upper])
def test_text_stl_files_are_read_in_small_and_capital_letters(tmp_path: Path, change: Callable[[str], str]) -> None:
    (tmp_path / "box.stl").write_text(change(trimesh.creation.box((1, 2, 3)).export(file_type="stl_ascii")))
    np.testing.assert_allclose(np.ptp(load_mesh(tmp_path / "box.stl").vertices, axis=0), (1, 2, 3))


def test_obj_files_that_are_cut_short_say_so(tmp_path: Path) -> None:
    path = tmp_path / "thing.obj"
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    for text, message in (
        (corners + "f 1 2 3\nf 1 2", "ends within a line, 'f 1 2'"),
        (corners + "v 0.5 0.", "ends within a line, 'v 0.5 0.'"),
        (corners + "f 1 2 9\nf 1 2 3\n", "a face of vertex 9 and 4 vertices"),
    ):
        path.write_text(text)
        with pytest.raises(AssetError, match=message):
            load_mesh(path)


@pytest.mark.parametrize("texture", ["t", "there"])
def test_a_dae_whose_texture_is_broken_keeps_its_geometry(tmp_path: Path, texture: str) -> None:
    text = export_collada(trimesh.creation.box((1, 1, 1))).decode()
    broken = f"""<library_images><image id="there"><init_from>there.png</init_from></image></library_images>
    <library_effects><effect id="e"><profile_COMMON>
    <newparam sid="s"><surface type="2D"><init_from>nowhere</init_from></surface></newparam>
    <newparam sid="t"><sampler2D><source>s</source></sampler2D></newparam>
    <technique sid="common"><phong><diffuse><texture texture="{texture}" texcoord="UV"/></diffuse></phong></technique>
    </profile_COMMON></effect></library_effects>
    <library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>"""
    for library in ("effects", "materials"):
        start, end = text.find(f"<library_{library}"), text.find(f"</library_{library}>")
        if start >= 0:
            text = text[:start] + text[end + len(f"</library_{library}>") :]
    text = text.replace("<library_geometries", broken + "<library_geometries", 1)
    assert "<instance_material" in text
    head, _, tail = text.partition('target="#')
    text = head + 'target="#m' + tail[tail.index('"') :]
    (tmp_path / "box.dae").write_text(text)
    (part,) = load_parts(tmp_path / "box.dae")
    assert len(part.mesh.faces) == 12
    if texture == "t":  # it leads nowhere; the other names a picture, of which only the file is missing
        assert part.color is not None
        assert part.color[:3] == pytest.approx((0.7, 0.7, 0.7), abs=0.01)


def test_a_texture_without_coordinates_counts_whole(tmp_path: Path) -> None:
    Image.new("RGB", (4, 4), (255, 0, 0)).save(tmp_path / "red.png")
    (tmp_path / "box.mtl").write_text("newmtl red\nmap_Kd red.png\n")
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    (tmp_path / "box.obj").write_text(f"mtllib box.mtl\n{corners}usemtl red\nf 1 2 3\nf 1 2 4\n")
    (part,) = load_parts(tmp_path / "box.obj")
    assert (part.color, part.textured) == ((1.0, 0.0, 0.0, 1.0), True)


def test_a_textured_surface_keeps_its_picture_and_coordinates(tmp_path: Path) -> None:
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)
    faces, coordinates = [(0, 1, 2), (0, 2, 3)], corners[:, :2]
    pixels = np.zeros((4, 4, 3), np.uint8)
    pixels[:2, :2] = 255, 0, 0
    material = PBRMaterial(baseColorTexture=Image.fromarray(pixels))
    surface = trimesh.Trimesh(corners, faces, process=False, visual=TextureVisuals(coordinates, material=material))
    plain = trimesh.creation.box((0.1, 0.1, 0.1))
    trimesh.Scene([surface, plain]).export(tmp_path / "sign.glb")
    box, sign = load_parts(tmp_path / "sign.glb", (2.0, 2.0, 2.0))
    assert box.texture is None
    assert sign.texture is not None
    np.testing.assert_array_equal(sign.texture.pixels, pixels)
    assert sign.mesh.coordinates is not None
    # A corner of the surface is at its own place of the picture, from the lower left one.
    np.testing.assert_allclose(sign.mesh.vertices[:, :2], 2.0 * sign.mesh.coordinates, atol=1e-6)
    assert load_mesh(tmp_path / "sign.glb").coordinates is None, "collision needs merged vertices"
    visual = '<visual><geometry><mesh filename="sign.glb"/></geometry></visual>'
    (tmp_path / "r.urdf").write_text(f'<robot name="r"><link name="l">{visual}</link></robot>')
    visuals = read_urdf(tmp_path / "r.urdf").root.visuals
    assert [shape.finish.texture is not None for shape in visuals] == [False, True]
    assert visuals[1].color == (1.0, 1.0, 1.0, 1.0)
