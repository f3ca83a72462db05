"""Textures and texture coordinates of MJCF and USD models are kept, and laid as their own programs lay them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from orbit_assets.mjcf import read_mjcf
from orbit_assets.options import ReadLimits, ReadOptions
from orbit_assets.scene_files import load_scene
from orbit_assets.usd import read_usd, write_usd
from orbit_assets.usd.scene_writer import write_usd_scene
from orbit_assets.usd.writer import mesh_articulation
from orbit_core.interfaces.errors import AssetError
from orbit_core.plugin_kit.surfaces import textured_surface
from orbit_core.scene import Articulation, Box, Finish, Link, Mesh, ObjectSpec, Plane, Scene, Shape, Sphere, Texture
from orbit_core.scene.shapes import DULL

# Red, green over blue, white.
QUADRANTS = np.zeros((8, 8, 3), np.uint8)
QUADRANTS[:4, :4], QUADRANTS[:4, 4:] = (255, 0, 0), (0, 255, 0)
QUADRANTS[4:, :4], QUADRANTS[4:, 4:] = (0, 0, 255), (255, 255, 255)
NAMES = {(255, 0, 0): "red", (0, 255, 0): "green", (0, 0, 255): "blue", (255, 255, 255): "white"}
# A square pyramid that points down, its base mapped as it is seen from above.
PYRAMID = """v -1 -1 0
v 1 -1 0
v 1 1 0
v -1 1 0
v 0 0 -1
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vt .5 .5
f 1/1 2/2 3/3
f 1/1 3/3 4/4
f 1/1 5/5 2/2
f 2/2 5/5 3/3
f 3/3 5/5 4/4
f 4/4 5/5 1/1
"""


def color_at(shape: Shape, x: float, y: float) -> str:
    """Return the name of the texture's colour where a ray from above meets a shape at (x, y) of its link."""
    texture = shape.finish.texture
    assert texture is not None
    surface = textured_surface(shape, texture)
    points = shape.pose.transform(surface.vertices)
    best, found = -np.inf, np.zeros(2)
    for face in surface.faces:
        corners = points[face]
        edges = (corners[1:] - corners[0])[:, :2].T
        if abs(np.linalg.det(edges)) < 1e-12:
            continue
        s, t = np.linalg.solve(edges, np.array((x, y)) - corners[0, :2])
        height = float(corners[0, 2] + (corners[1:] - corners[0])[:, 2] @ (s, t))
        if min(s, t, 1.0 - s - t) >= -1e-9 and height > best:
            best, found = height, np.array((1.0 - s - t, s, t)) @ surface.coordinates[face]
    rows, columns = texture.pixels.shape[:2]
    column, row = int(found[0] % 1.0 * columns) % columns, int((1.0 - found[1]) % 1.0 * rows) % rows
    red, green, blue = texture.pixels[row, column].tolist()
    return NAMES.get((red, green, blue), f"{red, green, blue}")


def quarters(shape: Shape, half: float = 0.5) -> tuple[str, ...]:
    """Return the colours at the upper left, upper right, lower left and lower right quarter, seen from above."""
    return tuple(color_at(shape, x, y) for y in (half, -half) for x in (-half, half))


def mjcf(folder: Path, geom: str, kind: str = "2d", material: str = "") -> Path:
    """Write a model of one body with a geom of a textured material."""
    Image.fromarray(QUADRANTS).save(folder / "quadrants.png")
    (folder / "pyramid.obj").write_text(PYRAMID)
    (folder / "model.xml").write_text(
        f'<mujoco><asset><texture name="t" type="{kind}" file="quadrants.png"/>'
        f'<material name="m" texture="t" {material}/><mesh name="pyramid" file="pyramid.obj"/></asset>'
        f'<worldbody><body name="b"><freejoint/><geom {geom} material="m"/></body></worldbody></mujoco>'
    )
    return folder / "model.xml"


AS_IT_IS = ("red", "green", "blue", "white")


@pytest.mark.parametrize(
    ("geom", "material", "seen"),
    [
        # Each row was compared with a picture that MuJoCo draws of the same file.
        ('type="mesh" mesh="pyramid"', "", AS_IT_IS),
        ('type="mesh" mesh="pyramid"', 'texrepeat="0.5 1"', ("red", "red", "blue", "blue")),
        ('type="box" size="1 1 .5"', "", AS_IT_IS),
        ('type="box" size="1 1 .5"', 'texrepeat=".5 .5"', ("red", "red", "red", "red")),
        ('type="box" size="1 1 .5"', 'texrepeat=".5 1" texuniform="true"', ("red", "red", "blue", "blue")),
    ],
)
def test_a_flat_texture_is_laid_as_mujoco_lays_it(tmp_path: Path, geom: str, material: str, seen: tuple[str]) -> None:
    got = read_mjcf(mjcf(tmp_path, geom, material=material))
    (visual,) = got.root.visuals
    assert quarters(visual) == seen
    assert not any("textures" in note for note in got.notes)


def test_contact_takes_the_merged_mesh(tmp_path: Path) -> None:
    got = read_mjcf(mjcf(tmp_path, 'type="mesh" mesh="pyramid"')).root
    drawn, solid = got.visuals[0].geometry, got.collisions[0].geometry
    assert isinstance(drawn, Mesh)
    assert isinstance(solid, Mesh)
    assert drawn.coordinates is not None
    assert solid.coordinates is None
    assert len(solid.vertices) == 5


def test_a_cube_texture_is_on_each_side_of_a_box(tmp_path: Path) -> None:
    (visual,) = read_mjcf(mjcf(tmp_path, 'type="box" size="1 1 .5"', "cube")).root.visuals
    assert quarters(visual, 0.3) == AS_IT_IS
    assert isinstance(visual.geometry, Mesh)
    assert visual.geometry.coordinates is not None


def test_a_ball_with_one_picture_for_all_faces_of_its_cube_stays_a_ball(tmp_path: Path) -> None:
    (visual,) = read_mjcf(mjcf(tmp_path, 'type="sphere" size="1"', "cube")).root.visuals
    assert quarters(visual, 0.3) == AS_IT_IS
    assert visual.geometry == Sphere(1.0)


def test_a_cube_of_one_colour_is_a_colour(tmp_path: Path) -> None:
    path = mjcf(tmp_path, 'type="box" size="1 1 1"', "cube", 'rgba="1 .5 1 1"')
    Image.fromarray(np.full((8, 8, 3), (255, 255, 0), np.uint8)).save(tmp_path / "quadrants.png")
    (visual,) = read_mjcf(path).root.visuals
    assert visual.color == (1.0, 0.5, 0.0, 1.0)
    assert visual.geometry == Box((1.0, 1.0, 1.0))


def test_a_material_gives_roughness_and_metal_and_ground_its_texture(tmp_path: Path) -> None:
    got = read_mjcf(mjcf(tmp_path, 'type="box" size="1 1 .5"', material='roughness="0.3" metallic="0.8"'))
    finish = got.root.visuals[0].finish
    assert (finish.roughness, finish.metallic) == pytest.approx((0.3, 0.8))
    path = mjcf(tmp_path, 'type="box" size=".1 .1 .1"', material='texrepeat="4 4" texuniform="true"')
    path.write_text(
        path.read_text().replace("<worldbody>", '<worldbody><geom type="plane" size="0 0 1" material="m"/>')
    )
    (ground,) = load_scene(path).terrain
    assert ground.finish.texture is not None
    assert ground.finish.texture.width == 0.5


def usd(folder: Path, mesh: str, picture: str = "", coordinates: str = "") -> Path:
    """Write a stage of one body with a mesh whose material has a picture."""
    Image.fromarray(QUADRANTS).save(folder / "quadrants.png")
    (folder / "stage.usda").write_text(f"""#usda 1.0
(
    defaultPrim = "top"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "top"
{{
    def Material "paint"
    {{
        token outputs:surface.connect = </top/paint/shader.outputs:surface>
        def Shader "shader"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </top/paint/picture.outputs:rgb>
            float inputs:roughness = 0.25
            token outputs:surface
        }}
        def Shader "picture"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @quadrants.png@
            float2 inputs:st.connect = </top/paint/place.outputs:result>
            {picture}
            color3f outputs:rgb
        }}
        def Shader "place"
        {{
            uniform token info:id = "UsdTransform2d"
            float2 inputs:in.connect = </top/paint/reader.outputs:result>
            {coordinates}
            float2 outputs:result
        }}
        def Shader "reader"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "uv"
            float2 outputs:result
        }}
    }}
    def Xform "body" (prepend apiSchemas = ["PhysicsRigidBodyAPI"])
    {{
        def Mesh "pyramid" (prepend apiSchemas = ["MaterialBindingAPI", "PhysicsCollisionAPI"])
        {{
            rel material:binding = </top/paint>
            int[] faceVertexCounts = [4, 3, 3, 3, 3]
            int[] faceVertexIndices = [0, 1, 2, 3, 0, 4, 1, 1, 4, 2, 2, 4, 3, 3, 4, 0]
            point3f[] points = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (0, 0, -1)]
            {mesh}
        }}
    }}
}}
""")
    return folder / "stage.usda"


BY_VERTEX = 'texCoord2f[] primvars:uv = [(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0.5)] (interpolation = "vertex")'
BY_CORNER = (
    "texCoord2f[] primvars:uv = [(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0.5)] "
    '(interpolation = "faceVarying")\nint[] primvars:uv:indices = [0, 1, 2, 3, 0, 4, 1, 1, 4, 2, 2, 4, 3, 3, 4, 0]'
)


@pytest.mark.parametrize("mesh", [BY_VERTEX, BY_CORNER])
def test_a_picture_of_a_stage_is_laid_by_its_coordinates(tmp_path: Path, mesh: str) -> None:
    got = read_usd(usd(tmp_path, mesh))
    (visual,) = got.root.visuals
    assert quarters(visual) == AS_IT_IS
    assert visual.finish.roughness == 0.25
    assert visual.color == (1.0, 1.0, 1.0, 1.0)
    solid = got.root.collisions[0].geometry
    assert isinstance(solid, Mesh)
    assert solid.coordinates is None
    assert len(solid.vertices) == 5


def test_transforms_and_tints_of_a_picture_count(tmp_path: Path) -> None:
    path = usd(
        tmp_path,
        BY_VERTEX,
        "float4 inputs:scale = (1, 0.5, 0.25, 1)",
        "float2 inputs:scale = (0.5, 1)\nfloat2 inputs:translation = (0.5, 0)",
    )
    (visual,) = read_usd(path).root.visuals
    assert quarters(visual) == ("green", "green", "white", "white")
    assert visual.color == (1.0, 0.5, 0.25, 1.0)


def test_pictures_that_are_missing_or_large_or_without_coordinates(tmp_path: Path) -> None:
    path = usd(tmp_path, "")
    assert any("no coordinates on its picture" in note for note in read_usd(path).notes)
    usd(tmp_path, BY_VERTEX)
    with pytest.raises(AssetError, match=r"quadrants\.png has 8 x 8 pixels"):
        read_usd(path, options=ReadOptions(limits=ReadLimits(pixels=10)))
    (tmp_path / "quadrants.png").unlink()
    got = read_usd(path)
    assert any("'quadrants.png'" in note and "is missing" in note for note in got.notes)
    assert got.root.visuals[0].finish.texture is None


def test_a_picture_outside_the_models_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "model").mkdir()
    path = usd(tmp_path / "model", BY_VERTEX)
    (tmp_path / "model" / "quadrants.png").rename(tmp_path / "secret.png")
    path.write_text(path.read_text().replace("@quadrants.png@", "@../secret.png@"))
    with pytest.raises(AssetError, match="outside the model's folder"):
        read_usd(path)


def test_finishes_come_back_from_usd(tmp_path: Path) -> None:
    wood = Finish(roughness=0.5, texture=Texture(QUADRANTS, 0.5))
    table = Shape(Box((0.5, 0.5, 0.1)), color=(0.5, 0.25, 0.75, 1.0), finish=wood, name="top")
    metal = Shape(Box((0.125, 0.5, 0.25)), finish=Finish(roughness=0.25, metallic=1.0), name="leg")
    sign = read_usd(usd(tmp_path, BY_VERTEX)).root.visuals[0]
    link = Link("a", 1.0, inertia=np.eye(3), collisions=(table,), visuals=(table, metal, sign))
    write_usd(Articulation("a", (link,)), tmp_path / "a.usda")
    back = read_usd(tmp_path / "a.usda").root
    assert [shape.finish for shape in back.visuals] == [shape.finish for shape in link.visuals]
    np.testing.assert_allclose([shape.color for shape in back.visuals], [shape.color for shape in link.visuals], 1e-6)
    assert quarters(back.visuals[2]) == AS_IT_IS
    assert back.collisions[0].geometry == table.geometry
    assert back.collisions[0].finish == table.finish


def test_a_scenes_ground_and_furniture_keep_their_textures(tmp_path: Path) -> None:
    floor = Shape(Plane(), finish=Finish(texture=Texture(QUADRANTS, 1.0)), name="ground")
    top = Shape(Box((0.5, 0.5, 0.1)), finish=Finish(texture=Texture(QUADRANTS, 0.25)), name="top")
    table = ObjectSpec(
        name="table", articulation=Articulation("table", (Link("table", 1.0, inertia=np.eye(3), collisions=(top,)),))
    )
    assert not write_usd_scene(Scene(objects=(table,), terrain=(floor,)), tmp_path / "room.usda")
    back = load_scene(tmp_path / "room.usda")
    assert back.terrain[0].finish == floor.finish
    assert back.objects[0].articulation.root.collisions[0].finish == top.finish
    assert len(list((tmp_path / "room_textures").iterdir())) == 1, "one picture, used twice"


def test_a_mesh_as_one_body_keeps_its_picture(tmp_path: Path) -> None:
    Image.fromarray(QUADRANTS).save(tmp_path / "skin.png")
    (tmp_path / "skin.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    (tmp_path / "thing.obj").write_text(
        PYRAMID.replace("f 1", "usemtl skin\nf 1", 1).replace("v", "mtllib skin.mtl\nv", 1)
    )
    got = mesh_articulation(tmp_path / "thing.obj")
    assert quarters(got.root.visuals[0]) == AS_IT_IS
    assert got.root.collisions[0].finish == DULL
    assert not any("picture" in note for note in got.notes)
