"""Files as whole scenes: what stands where, and that an engine simulates it so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orbit_assets.scene_files import load_scene
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import AmbientLight, Box, DirectionalLight, ImplicitPd, Plane, Scene
from tests.assets.usd_files import CUBE, body, stage

# In centimetres, y up: a driven arm on a table, a cup on the floor beside it, light from straight above.
CENTIMETRES = 'metersPerUnit = 0.01\n    kilogramsPerUnit = 1\n    upAxis = "Y"'
KITCHEN = f"""
    def PhysicsScene "physics"
    {{
        vector3f physics:gravityDirection = (0, -1, 0)
        float physics:gravityMagnitude = 162
    }}
    def DistantLight "sun"
    {{
        float inputs:intensity = 3000
        color3f inputs:color = (1, 0.5, 0.25)
        float xformOp:rotateX = -90
        uniform token[] xformOpOrder = ["xformOp:rotateX"]
    }}
    def DistantLight "lamp"
    {{
        float inputs:intensity = 750
    }}
    def DomeLight "sky"
    {{
        float inputs:intensity = 100
    }}
    def SphereLight "bulb"
    {{
    }}
    def Plane "floor" (prepend apiSchemas = ["PhysicsCollisionAPI"])
    {{
        uniform token axis = "Y"
    }}
    def Xform "table"
    {{
        double3 xformOp:translate = (100, 50, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        def Cube "board" (prepend apiSchemas = ["PhysicsCollisionAPI"])
        {{
            double size = 1
            double3 xformOp:scale = (80, 4, 60)
            uniform token[] xformOpOrder = ["xformOp:scale"]
        }}
        def Cube "painting"
        {{
        }}
    }}
    def Xform "arm"
    {{
        {body("base", CUBE, at=(100, 55, 0))}
        {body("hand", CUBE, at=(100, 95, 0))}
        def PhysicsFixedJoint "hold"
        {{
            rel physics:body1 = </top/arm/base>
        }}
        def PhysicsPrismaticJoint "lift" (prepend apiSchemas = ["PhysicsDriveAPI:linear"])
        {{
            rel physics:body0 = </top/arm/base>
            rel physics:body1 = </top/arm/hand>
            uniform token physics:axis = "Y"
            float physics:lowerLimit = 0
            float physics:upperLimit = 100
            float drive:linear:physics:stiffness = 500
            float drive:linear:physics:damping = 50
        }}
    }}
    {body("cup", CUBE, at=(0, 20, 30))}
"""


def kitchen(folder: Path) -> Scene:
    return load_scene(stage(folder, KITCHEN, CENTIMETRES))


def test_a_usd_scene_holds_robots_objects_ground_light_and_gravity(tmp_path: Path) -> None:
    scene = kitchen(tmp_path)
    (arm,) = scene.robots
    assert arm.fixed_base
    np.testing.assert_allclose(arm.pose.position, (1.0, 0.0, 0.55), atol=1e-9)
    assert arm.home == {"lift": pytest.approx(0.4)}
    assert arm.actuators == (ImplicitPd(joints=("lift",), stiffness=500.0, damping=50.0),)
    cup, table = scene.objects
    assert (cup.name, cup.fixed_base, table.name, table.fixed_base) == ("cup", False, "table", True)
    np.testing.assert_allclose(cup.pose.position, (0.0, -0.3, 0.2), atol=1e-9)
    np.testing.assert_allclose(table.pose.position, (1.0, 0.0, 0.5), atol=1e-9)
    (board,) = table.articulation.root.collisions
    assert isinstance(board.geometry, Box)
    turned = np.abs(board.pose.rotation_matrix() @ np.asarray(board.geometry.half_extents))
    np.testing.assert_allclose(turned, (0.4, 0.3, 0.02), atol=1e-9)
    assert len(table.articulation.root.visuals) == 2
    (floor,) = scene.terrain
    assert floor.geometry == Plane()
    np.testing.assert_allclose(floor.pose.rotation_matrix()[:, 2], (0.0, 0.0, 1.0), atol=1e-9)
    np.testing.assert_allclose(scene.gravity, (0.0, 0.0, -1.62), atol=1e-6)
    ambient, sun, lamp = scene.lights
    assert ambient == AmbientLight()
    assert isinstance(sun, DirectionalLight)
    assert isinstance(lamp, DirectionalLight)
    np.testing.assert_allclose(sun.direction, (0.0, 0.0, -1.0), atol=1e-7)
    assert sun.color == (1.0, 0.5, 0.25)
    np.testing.assert_allclose(lamp.direction, (0.0, 1.0, 0.0), atol=1e-7)
    assert lamp.intensity == pytest.approx(sun.intensity / 4)
    assert any("/top/bulb is a SphereLight" in note for note in arm.articulation.notes)


def test_an_engine_simulates_the_scene(tmp_path: Path) -> None:
    pytest.importorskip("orbit_mujoco", reason="the backend orbit-mujoco is not installed")
    from orbit_core.world import simulate

    world = simulate(kitchen(tmp_path), 1, "mujoco")
    world.reset()
    world.step(400)
    cup = world.objects["cup"]
    # The cup, a cube of 1 mm, has fallen to the floor, and the drive's target is the home position.
    assert abs(float(cup.root_pose[0, 2])) < 0.01
    assert float(world.robots["arm"].joint_positions[0, 0]) == pytest.approx(0.4, abs=0.01)
    world.close()


def test_an_mjcf_scene_holds_all_bodies_of_the_file(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MJCF files are read by MuJoCo's own parser")
    path = tmp_path / "scene.xml"
    path.write_text("""<mujoco><worldbody>
        <geom name="floor" type="plane" size="1 1 1"/>
        <geom name="shelf" type="box" size="0.1 0.2 0.3" pos="1 0 0"/>
        <body name="cup" pos="0 0 2"><freejoint/><geom size="0.1"/></body>
        <body name="door" pos="0 3 0"><joint name="hinge"/><geom size="0.1" pos="1 0 0"/></body>
    </worldbody></mujoco>""")
    scene = load_scene(path)
    assert scene.robots == ()
    by_name = {thing.name: thing for thing in scene.objects}
    assert by_name["cup"].pose.position == (0.0, 0.0, 2.0)
    assert not by_name["cup"].fixed_base
    assert by_name["door"].articulation.joint_names == ("hinge",)
    assert by_name["door"].fixed_base
    assert [shape.name for shape in by_name["world"].articulation.root.collisions] == ["shelf"]
    assert [shape.geometry for shape in scene.terrain] == [Plane()]


def test_a_file_without_a_scene_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="holds no scene"):
        load_scene(tmp_path / "robot.urdf")
    with pytest.raises(AssetError, match="no rigid body and no geometry"):
        load_scene(stage(tmp_path, ""))
