"""A robot in an otherwise empty world of an engine, with motion generators on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from orbit_assets.catalogue import robot as catalogue_robot
from orbit_core.actions import ActionTerm, Actuate, MotionGenerator, with_drives_for
from orbit_core.backends import backend_names
from orbit_core.interfaces import Robot, World
from orbit_core.scene import ObjectSpec, Scene, SensorSpec, Shape
from orbit_core.world import simulate

BACKENDS = [name for name in ("mujoco", "bullet") if name in backend_names()]
ENGINES = [*BACKENDS, *(name for name in ("sapien", "warp") if name in backend_names())]
"""For what each engine's own dynamics could spoil."""
SETTINGS = {"sapien": {"temporal_gauss_seidel": False}}
"""With the other solver the force between rigid things jumps by 2 to 3 N rms from step to step."""


@dataclass
class Held:
    """A generator in its world."""

    world: World
    robot: Robot
    generator: MotionGenerator

    def run(self, command: Tensor, steps: int, decimation: int = 4) -> None:
        """Hold a command (n,) or (N, n) over that many physics steps, told anew every ``decimation`` steps."""
        rows = command.expand(self.world.num_envs, -1)
        actuate = Actuate(self.robot, self.generator)
        for _ in range(steps // decimation):
            actuate.compute(self.generator.compute({"command": rows}))
            self.world.step(decimation)

    def hand(self) -> Tensor:
        """(N, 7)"""
        return self.robot.frame_pose(self.robot.spec.end_effector.frame).clone()


def held(
    term: ActionTerm,
    backend: str,
    *,
    name: str = "franka_panda",
    num_envs: int = 2,
    physics_dt: float = 0.002,
    gravity_compensation: bool | None = None,
    objects: tuple[ObjectSpec, ...] = (),
    sensors: tuple[SensorSpec, ...] = (),
    terrain: tuple[Shape, ...] = (),
) -> Held:
    """A robot of the catalogue without anything to touch but ``objects`` and ``terrain``; close its world."""
    spec = replace(catalogue_robot(name), name="robot")
    if gravity_compensation is not None:
        spec = replace(spec, gravity_compensation=gravity_compensation)
    spec = with_drives_for(spec, {"it": term})
    scene = Scene(robots=(spec,), objects=objects, sensors=sensors, terrain=terrain, physics_dt=physics_dt)
    world = simulate(scene, num_envs, backend, settings=SETTINGS.get(backend))
    robot = world.robots["robot"]
    generator = term.build("it", robot)
    generator.enter(world, 4 * physics_dt)
    return Held(world, robot, generator)


def wrench_on_hand(held: Held, force: tuple[float, float, float]) -> None:
    """Push at the end effector's frame with a force in world axes, N."""
    robot = held.robot
    frame = robot.spec.articulation.frame(robot.spec.end_effector.frame)
    link = robot.link_names.index(frame.link)
    center = robot.spec.articulation.links[link].center_of_mass
    from orbit_core.dynamics.transforms import quat_rotate

    pose = robot.link_poses[:, link]
    arm = held.hand()[:, :3] - pose[:, :3] - quat_rotate(pose[:, 3:], torch.tensor(center, dtype=torch.float32))
    push = torch.tensor(force).expand(held.world.num_envs, 3)
    robot.set_wrenches(torch.cat((push, torch.linalg.cross(arm, push)), 1)[:, None], [link])
