"""Velocity-Rough and Recover: what they show, where they start, how the curriculum moves robots between cells."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from orbit_assets.terrain import Flat, Slope, Stairs, TerrainGrid
from orbit_core.envs import make
from orbit_core.interfaces import ConfigurationError
from orbit_core.sensors import RayCaster
from orbit_tasks import biped
from orbit_tasks.velocity_rough import BY_DISTANCE, SCAN, VelocityRough

PITCH_JOINTS = ("hip_pitch", "knee", "ankle_pitch")
GRID = TerrainGrid(kinds=(Slope(), Stairs(), Stairs(down=True)), levels=4, cell_size=4.0, border=3.0)


@pytest.mark.parametrize("backend", ["mujoco", "bullet"])
def test_the_policy_sees_the_ground_below_it(backend: str) -> None:
    env = make("Velocity-Rough", 3, backend, robot="unitree_go2", terrain=GRID, seed=1)
    observation, _ = env.reset()
    seen = observation["policy"][:, -187:]
    scan = env.world.sensors[SCAN]
    assert isinstance(scan, RayCaster)
    points = scan.points.double()
    ground = torch.as_tensor(GRID.height(*points[..., :2].numpy().transpose(2, 0, 1)))
    near = (points[..., 2] - ground).abs() < 0.02  # an upright wall is as wide as the resolution
    assert near.double().mean() > 0.85
    torch.testing.assert_close(seen, scan.distances)
    assert env.task.metadata.ppo.iterations == VelocityRough.metadata.ppo.iterations
    env.close()


@pytest.mark.parametrize("robot", ["anymal_b", "unitree_a1", "unitree_go1", "unitree_g1"])
def test_every_legged_robot_stands_on_its_cell(robot: str) -> None:
    env = make("Velocity-Rough", 3, "mujoco", robot=robot, terrain=GRID, domain_randomization=True, seed=0)
    env.reset()
    body = env.world.robots["robot"]
    cell = env.state.cell_origins[env.state.level, env.state.kind]
    torch.testing.assert_close(body.root_pose[:, :2], cell[:, :2], atol=1e-5, rtol=0.0)
    clear = body.root_pose[:, 2] - cell[:, 2]
    torch.testing.assert_close(clear, torch.full((3,), body.spec.pose.position[2]), atol=1e-5, rtol=0.0)
    for _ in range(10):
        observation, reward, *_ = env.step(torch.zeros(3, env.action_size))
    assert torch.isfinite(observation["policy"]).all()
    assert torch.isfinite(reward).all()
    assert len(env.state.foot_links) == len(body.spec.feet)
    env.close()


def test_the_curriculum_moves_robots_between_levels() -> None:
    env = make("Velocity-Rough", 6, "mujoco", terrain=GRID, curriculum_enabled=True, episode_length=4.0, seed=0)
    env.reset()
    world = env.world
    env.state.level[:] = torch.tensor([0, 1, 3, 2, 0, 1])
    env.state.spare_level[:] = 2
    env.state.difficulty[:] = env.state.level / 3.0
    cell = env.state.cell_origins[env.state.level, env.state.kind]
    gone = torch.tensor([2.1, 0.1, 2.1, 1.2, 0.1, 1.2])
    pose = world.robots["robot"].root_pose.clone()
    pose[:, 0] = cell[:, 0] + gone
    pose[:, 1] = cell[:, 1]
    world.robots["robot"].set_root_pose(pose)
    env.commands["velocity"][:, :3] = torch.tensor(
        [0.5, 0.0, 0.0]
    )  # 2 m in the episode: half of that is enough to stay
    following = (env.state.difficulty + BY_DISTANCE(env)) * 3.0
    torch.testing.assert_close(following, torch.tensor([1.0, 0.0, 2.0, 2.0, 0.0, 1.0]))
    env.state.difficulty[:] = following / 3.0
    env.reset(env_ids=torch.tensor([0, 2]))
    assert env.state.level[[0, 2]].tolist() == [1, 2]
    env.close()


def test_a_heading_is_commanded_in_place_of_a_yaw_rate() -> None:
    env = make("Velocity-Rough", 4, "mujoco", terrain=GRID, seed=3)
    env.reset()
    assert (env.commands["velocity"][:, 2].abs() <= env.task.commands.velocity.max_yaw_rate).all()
    env.commands["velocity"][:, 3] = torch.tensor([0.0, 1.0, 3.0, -3.0])
    pose = env.world.robots["robot"].root_pose.clone()
    pose[:, 3:] = torch.tensor([1.0, 0.0, 0.0, 0.0])
    env.world.robots["robot"].set_root_pose(pose)
    env.commands.update()
    expected = torch.tensor([0.0, 0.5, 1.0, -1.0])
    torch.testing.assert_close(env.commands["velocity"][:, 2], expected, atol=1e-4, rtol=0.0)
    env.close()


def test_robots_on_two_feet_have_rewards_and_drives_of_their_own() -> None:
    env = make("Velocity-Flat", 2, "mujoco", robot="unitree_g1", seed=0, **{"rewards.slide": None})
    env.reset()
    body = env.world.robots["robot"]
    assert "slide" not in env.reward_terms, "what the user takes away stays away"
    assert env.reward_terms["tilt"].weight == -1.0
    swinging = [name for name, still in zip(body.joint_names, env.state.still_joints, strict=True) if not still]
    assert swinging == [f"{side}_{joint}_joint" for side in ("left", "right") for joint in PITCH_JOINTS]
    assert body.nominal_gains[body.find_joints("left_knee_joint")[0]] == (150.0, 4.0)
    assert env.actions.generators[0].config.scale == 1.0
    env.commands["velocity"][:] = torch.tensor([[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]])
    timer = biped.contacts_of(env.world).timer()
    timer.times[:2] = 0.0
    timer.times[0, :, env.state.foot_links[0]] = 0.3  # the left foot has stood for 0.3 s, the right flown for 0.2 s
    timer.times[1, :, env.state.foot_links[1]] = 0.2
    torch.testing.assert_close(biped.stride(env), torch.tensor([0.2, 0.0]))
    body.set_joint_state((body.home_positions + 0.1).expand(2, -1))
    assert biped.stray(env)[0] == pytest.approx(0.1 * 23, abs=1e-5)
    env.close()
    dog = make("Velocity-Flat", 1, "mujoco", robot="unitree_go2")
    assert not {*biped.OF_TWO_FEET} & {*dog.reward_terms}
    assert dog.reward_terms["tilt"].weight == -5.0
    dog.close()


def test_terrain_that_does_not_suit_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"terrain\.levels is 1: give 2 or more"):
        make("Velocity-Rough", 1, "mujoco", terrain=replace(GRID, levels=1), curriculum_enabled=True)
    small = TerrainGrid(kinds=(Flat(platform=0.2),), cell_size=0.6)
    with pytest.raises(ConfigurationError, match=r"cells of 0\.6 m are smaller"):
        make("Velocity-Rough", 1, "mujoco", terrain=small)


@pytest.mark.parametrize(
    ("backend", "robot"), [("mujoco", "anymal_c"), ("mujoco", "unitree_g1"), ("bullet", "unitree_a1")]
)
def test_a_robot_that_lies_anyhow_has_not_recovered_and_one_that_stands_has(backend: str, robot: str) -> None:
    env = make("Recover", 4, backend, robot=robot, seed=0)
    env.reset()
    task, body = env.task, env.world.robots["robot"]
    assert not task.success(env).any()
    tilts = task.metrics(env)["tilt_rad"]
    assert tilts.std() > 0.1
    assert torch.isfinite(env.step(env.expert().compute({})["action"])[1]).all()
    body.set_joint_state(body.home_positions.expand(4, -1))
    home = torch.tensor([*body.spec.pose.position, 1.0, 0.0, 0.0, 0.0])
    body.set_root_pose(home.expand(4, 7))
    assert task.success(env).all()
    env.close()


@pytest.mark.parametrize("robot", ["anymal_c", "anymal_b"])
def test_the_gait_keeps_joints_within_their_velocity_limits(robot: str) -> None:
    env = make("Velocity-Flat", 2, "mujoco", robot=robot, seed=0)
    gait, body = env.expert(), env.world.robots["robot"]
    env.reset(seed=0)
    command = torch.tensor([[0.8, 0.0, 0.0], [0.4, -0.3, 0.6]])
    ratios = []
    for _ in range(60):
        env.commands["velocity"].copy_(command)
        env.step(gait.compute({})["action"])
        ratios.append(body.joint_velocities.abs() / env.state.speed_limits)
    beyond = torch.stack(ratios) > 1.0
    assert beyond.float().mean() < 0.01, "a landing foot is struck by the ground, and no more"
    env.close()
