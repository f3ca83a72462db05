"""A new task in one file: put one cube on top of another."""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from orbit_assets.objects import BENCH_HEIGHT, box, work_bench
from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm, Task, make
from orbit_core.mdp import common
from orbit_core.scene import Scene
from orbit_motion.experts import Expert
from orbit_motion.workspace import arm
from orbit_tasks.mdp import picking

EDGE = 0.05
red, blue = common.object_pose("red"), common.object_pose("blue")


def place(env: Environment) -> Tensor:
    """(N, 7) of the red cube where it belongs: on the blue one."""
    return blue(env) + torch.tensor([0, 0, EDGE, 0, 0, 0, 0], device=env.device)


def distance(env: Environment) -> Tensor:
    """(N,) metres between the red cube and its place."""
    return (place(env) - red(env))[:, :3].norm(dim=1)


def reach(env: Environment) -> Tensor:
    """(N,) metres between the hand and the red cube."""
    return (red(env) - common.hand_pose(env))[:, :3].norm(dim=1)


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
    reach: RewardTerm | None = RewardTerm(lambda env: common.nearness(reach(env), 0.2), weight=1.0)
    stack: RewardTerm | None = RewardTerm(lambda env: common.nearness(distance(env), 0.2), weight=10.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, weight=-1e-4)


@dataclass
class StackEvents:
    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_red: EventTerm | None = EventTerm(common.place_object("red", (0.4, 0.6), (-0.25, -0.1), 0.5 * EDGE))
    place_blue: EventTerm | None = EventTerm(common.place_object("blue", (0.4, 0.6), (0.1, 0.25), 0.5 * EDGE))


@dataclass(kw_only=True)
class Stack(Task):
    """Succeeds when the red cube lies on the blue one, and the hand has let go, at the episode's end."""

    robot: str = "franka_panda"
    action: str = "ik_relative"
    episode_length: float = 8.0
    tolerance: float = 0.015  # metres
    observations: StackObservations = field(default_factory=StackObservations)
    rewards: StackRewards = field(default_factory=StackRewards)
    events: StackEvents = field(default_factory=StackEvents)

    def scene(self) -> Scene:
        colors = {"red": (0.8, 0.15, 0.1, 1.0), "blue": (0.1, 0.25, 0.8, 1.0)}
        cubes = [box(name, (EDGE, EDGE, EDGE), mass=0.1, color=color) for name, color in colors.items()]
        objects, floor = (*cubes, work_bench()), common.floor(-BENCH_HEIGHT)
        return Scene(robots=(arm(self.robot),), objects=objects, terrain=(floor,), physics_dt=self.physics_dt)

    def success(self, env: Environment) -> Tensor:
        return (distance(env) < self.tolerance) & (reach(env) > EDGE)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"distance_m": distance(env)}

    def expert(self, env: Environment) -> Expert:
        to_place = picking.hand_for(lambda env: common.pointing_down(place(env)[:, :3]), held=red)
        grasp = picking.pick(env.world, lambda env: common.pointing_down(red(env)[:, :3]))
        return Expert(env, (*grasp, *picking.put(to_place, height=0.25)))


if __name__ == "__main__":
    env = make(Stack(), num_envs=16, backend="mujoco", seed=0)
    expert = env.expert()
    for _ in range(env.max_episode_steps):
        *_, info = env.step(expert.compute({})["action"])
    end = info["final"]
    print(f"{int(end.success.sum())} of {len(end.success)} stacked, off by {end.metrics['distance_m'].mean():.4f} m")
