"""A new task in one file: put one cube on top of another."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from orbit_assets.objects import BENCH_HEIGHT, box, work_bench
from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm, Task, make
from orbit_core.mdp import common
from orbit_core.robots import robot
from orbit_core.scene import Scene
from orbit_motion.experts import Expert, Phase

EDGE = 0.05


def red(env: Environment[Stack]) -> Tensor:
    """(N, 7) of the cube that moves."""
    return env.world.objects["red"].root_pose


def blue(env: Environment[Stack]) -> Tensor:
    """(N, 7) of the cube that stays."""
    return env.world.objects["blue"].root_pose


def raised(pose: Tensor, height: float) -> Tensor:
    """(N, 7)"""
    return pose + torch.tensor([0, 0, height, 0, 0, 0, 0], device=pose.device)


def distance(env: Environment[Stack]) -> Tensor:
    """(N,) metres between the red cube and its place on the blue one."""
    return (raised(blue(env), EDGE)[:, :3] - red(env)[:, :3]).norm(dim=1)


def reach(env: Environment[Stack]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the red cube."""
    return 1.0 - torch.tanh(5.0 * (red(env)[:, :3] - common.hand_pose(env)[:, :3]).norm(dim=1))


def place_cubes(env: Environment[Stack], env_ids: Tensor) -> None:
    """The red cube to the right of the robot, the blue one to its left."""
    for name, low, high in (("red", -0.25, -0.1), ("blue", 0.1, 0.25)):
        pose = torch.zeros(len(env_ids), 7, device=env.device)
        pose[:, 0] = env.world.random.uniform((), 0.4, 0.6, env_ids)
        pose[:, 1] = env.world.random.uniform((), low, high, env_ids)
        pose[:, 2], pose[:, 3] = 0.5 * EDGE, 1.0
        env.world.objects[name].set_root_pose(pose, env_ids)


def at_red(env: Environment[Stack]) -> Tensor:
    """(N, 7) the hand around the red cube, pointing down."""
    position = red(env)[:, :3]
    return torch.cat((position, common.facing_down(torch.zeros_like(position[:, 0]))), dim=1)


def over_blue(env: Environment[Stack], height: float) -> Tensor:
    """(N, 7) the hand where the red cube comes to lie ``height`` above its place, as it sits in the hand now."""
    hand = common.hand_pose(env)[:, :3]
    position = hand + raised(blue(env), EDGE + height)[:, :3] - red(env)[:, :3]
    return torch.cat((position, common.facing_down(torch.zeros_like(position[:, 0]))), dim=1)


@dataclass
class StackState(ObservationGroup):
    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    red: ObservationTerm | None = ObservationTerm(red)
    blue: ObservationTerm | None = ObservationTerm(blue)
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class StackObservations:
    policy: StackState = field(default_factory=StackState)


@dataclass
class StackRewards:
    reach: RewardTerm | None = RewardTerm(reach, 1.0)
    stack: RewardTerm | None = RewardTerm(lambda env: 1.0 - torch.tanh(5.0 * distance(env)), 10.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)


@dataclass
class StackTerminations:
    """Only the time limit ends an episode."""


@dataclass
class StackEvents:
    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cubes: EventTerm | None = EventTerm(place_cubes)


@dataclass(kw_only=True)
class Stack(Task):
    """Succeeds when the red cube lies on the blue one, and the hand has let go, at the episode's end."""

    robot: str = "franka_panda"
    action: str = "ik_relative"
    episode_length: float = 8.0
    tolerance: float = 0.015
    """Metres."""
    observations: StackObservations = field(default_factory=StackObservations)
    rewards: StackRewards = field(default_factory=StackRewards)
    terminations: StackTerminations = field(default_factory=StackTerminations)
    events: StackEvents = field(default_factory=StackEvents)

    def scene(self) -> Scene:
        size = (EDGE, EDGE, EDGE)
        red_cube = box("red", size=size, mass=0.1, color=(0.8, 0.15, 0.1, 1.0))
        blue_cube = box("blue", size=size, mass=0.1, color=(0.1, 0.25, 0.8, 1.0))
        return Scene(
            robots=(robot(self.robot, name=common.ROBOT),),
            objects=(red_cube, blue_cube, work_bench()),
            terrain=(common.floor(-BENCH_HEIGHT),),
            physics_dt=self.physics_dt,
        )

    def success(self, env: Environment) -> Tensor:
        away = (common.hand_pose(env)[:, :3] - red(env)[:, :3]).norm(dim=1) > EDGE
        return (distance(env) < self.tolerance) & away

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"distance_m": distance(env)}

    def expert(self, env: Environment) -> Expert:
        phases = (
            Phase(lambda env: raised(at_red(env), 0.1), position_tolerance=0.02),
            Phase(at_red, position_tolerance=0.006, timeout=1.5),
            Phase(at_red, gripper_open=False, dwell=0.4, timeout=0.5),
            Phase(lambda env: over_blue(env, 0.1), gripper_open=False, position_tolerance=0.02),
            Phase(lambda env: over_blue(env, 0.004), gripper_open=False, position_tolerance=0.003,
                  timeout=2.0),
            Phase(lambda env: over_blue(env, 0.004), dwell=0.3, timeout=0.4),
            Phase(lambda env: raised(at_red(env), 0.15)),
        )  # fmt: skip
        return Expert(env, phases)


def main() -> None:
    """One episode in each of 16 environments, with the expert."""
    environment = make(Stack(), num_envs=16, backend="mujoco", seed=0)
    expert = environment.expert()
    info = {}
    for _ in range(environment.max_episode_steps):
        *_, info = environment.step(expert.compute({})["action"])
    end = info["final"]
    print(f"{int(end.success.sum())} of {len(end.success)} stacked, off by {end.metrics['distance_m'].mean():.4f} m")
    environment.close()


if __name__ == "__main__":
    main()
