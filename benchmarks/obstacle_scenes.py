"""How often a hand arrives among random obstacles, and whether it touches any: `rmpflow`, and plans.

    python benchmarks/obstacle_scenes.py --scenes 200 --plans 100

A Franka, a ball, a box and a capsule somewhere in its workspace, and a goal with the hand straight down. A scene counts
where the arm at home and one posture at the goal have 3 cm to spare. What touches is told by the engine's contacts.
"""

from __future__ import annotations

import argparse
import itertools
import time
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from orbit_assets.catalogue import robot as catalogue_robot
from orbit_core.actions import Actuate, with_drives_for
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.interfaces import PlanningError, World
from orbit_core.scene import Box, Capsule, ContactSensorSpec, ObjectSpec, Pose, Scene, Shape, Sphere, single_link
from orbit_core.sensors import ContactSensor
from orbit_core.world import simulate
from orbit_motion import RmpFlow, RmpFlowConfig
from orbit_motion.full_ik import FullIk
from orbit_motion.planning import JointPlanner, TrajectoryFollower, time_optimal
from orbit_motion.planning.follower import JointTrajectory

SHAPES = (Sphere(0.08), Box((0.05, 0.05, 0.15)), Capsule(0.05, 0.1))
SPARE = 0.03
DECIMATION = 4


class Scenes:
    """As many feasible scenes as asked for, in one world."""

    def __init__(self, count: int, backend: str, seed: int) -> None:
        bodies = [single_link(f"obstacle{i}", Shape(shape), 1.0, np.eye(3)) for i, shape in enumerate(SHAPES)]
        objects = [
            ObjectSpec(name=body.name, articulation=body, fixed_base=True, pose=Pose((2.0, float(i), 1.0)))
            for i, body in enumerate(bodies)
        ]
        term = RmpFlowConfig()
        spec = with_drives_for(replace(catalogue_robot("franka_panda"), name="robot"), {"arm": term})
        touch = ContactSensorSpec(name="touch", entity="robot")
        scene = Scene(robots=(spec,), objects=tuple(objects), sensors=(touch,), physics_dt=0.005)
        self.world: World = simulate(scene, count, backend)
        self.robot = self.world.robots["robot"]
        generator = term.build("arm", self.robot)
        generator.enter(self.world, DECIMATION * self.world.physics_dt)
        assert isinstance(generator, RmpFlow)
        self.generator = generator
        tree = KinematicTree(self.robot.spec.articulation)
        self._solver = FullIk(
            tree, generator.frame, generator.joints, self.robot.position_limits, self.robot.home_positions
        )
        self._random = torch.Generator().manual_seed(seed)
        self.goal = torch.zeros(count, 7)
        self.posture = self.robot.home_positions.repeat(count, 1)
        self._draw(count)

    def _anywhere(self, low: tuple[float, ...], high: tuple[float, ...], count: int) -> Tensor:
        share = torch.rand(count, 3, generator=self._random)
        return torch.tensor(low) + share * (torch.tensor(high) - torch.tensor(low))

    def _draw(self, count: int) -> None:
        left = torch.arange(count)
        things = tuple(self.world.objects.values())
        upright, down = torch.tensor([1.0, 0.0, 0.0, 0.0]), torch.tensor([0.0, 1.0, 0.0, 0.0])
        while len(left):
            for thing in things:
                place = self._anywhere((0.35, -0.45, 0.15), (0.7, 0.45, 0.6), len(left))
                thing.set_root_pose(torch.cat((place, upright.expand(len(left), 4)), 1), left)
            place = self._anywhere((0.35, -0.35, 0.2), (0.65, 0.35, 0.55), len(left))
            self.goal[left] = torch.cat((place, down.expand(len(left), 4)), 1)
            solution = self._solver.solve(self.goal[left], self.robot.home_positions.repeat(len(left), 1))
            self.posture[left[:, None], torch.tensor(self.generator.joints)] = solution.positions
            fine = torch.zeros(count, dtype=torch.bool)
            fine[left] = solution.converged
            for posture in (self.robot.home_positions.repeat(count, 1), self.posture):
                self.robot.set_joint_state(posture)
                fine &= self.generator.clearance() > SPARE
            left = left[~fine[left]]
        self.robot.set_joint_state(self.robot.home_positions.repeat(count, 1), torch.zeros_like(self.posture))

    def touching(self) -> Tensor:
        """(N,) whether anything touches the robot."""
        sensor = self.world.sensors["touch"]
        assert isinstance(sensor, ContactSensor)
        return sensor.forces.norm(dim=-1).sum(1) > 0.0


def reactive(scenes: Scenes, seconds: float) -> str:
    generator, world = scenes.generator, scenes.world
    count = world.num_envs
    command = generator.encode(scenes.goal, torch.ones(count, dtype=torch.bool))
    actuate = Actuate(scenes.robot, generator)
    least, touched = torch.full((count,), torch.inf), torch.zeros(count, dtype=torch.bool)
    for _ in range(round(seconds / (DECIMATION * world.physics_dt))):
        actuate.compute(generator.compute({"command": command}))
        world.step(DECIMATION)
        least, touched = torch.minimum(least, generator.clearance()), touched | scenes.touching()
    missing = (scenes.robot.frame_pose(generator.frame)[:, :3] - scenes.goal[:, :3]).norm(dim=1)
    arrived = (missing < 0.02).float().mean()
    return (
        f"rmpflow: {count} scenes, {100 * arrived:.1f} % arrive within 2 cm in {seconds:g} s, "
        f"{100 * (~touched).float().mean():.1f} % touch nothing, balls at least {1e3 * least.min():.1f} mm free, "
        f"{int((least <= 0.0).sum())} with a ball that touches"
    )


def planned(scenes: Scenes, count: int) -> str:
    """Plans one scene after the other; paths are looked at where the hand has moved by a millimetre or less."""
    robot, joints = scenes.robot, scenes.generator.joints
    planner = JointPlanner(scenes.world, robot, joints)
    robot.set_joint_state(robot.home_positions.repeat(scenes.world.num_envs, 1), torch.zeros_like(scenes.posture))
    speeds = np.array([joint.velocity_limit for joint in robot.joints])[joints]
    least, over, times, motions = np.inf, 0, [], dict[int, JointTrajectory]()
    for env in range(count):
        begin = time.perf_counter()
        try:
            path = planner.plan(scenes.posture[env, joints], env)
        except PlanningError:
            continue
        times.append(time.perf_counter() - begin)
        motions[env] = timed = time_optimal(path, speeds, 5.0, 0.008)
        rates = np.diff(timed.velocities[:-1], axis=0) / 0.008
        over += bool((np.abs(timed.velocities) > 1.001 * speeds).any() or (np.abs(rates) > 5.1).any())
        for points in (path, torch.as_tensor(timed.positions, dtype=path.dtype)):
            # No point of a Franka moves by more than 1.2 m a radian.
            dense = torch.cat([a + torch.linspace(0, 1, 2 + int(1200 * (b - a).abs().sum()))[:, None] * (b - a)
                               for a, b in itertools.pairwise(points)])  # fmt: skip
            least = min(least, float(planner.clearances(dense, env).min()))
    arrived, touched = followed(scenes, motions)
    return (
        f"plans: {len(motions)} of {count} found, {arrived} arrive within 2 cm, {touched} touch something; "
        f"{np.median(times):.2f} s at the median and {max(times):.2f} s at most, "
        f"{1e3 * least:.1f} mm free at every millimetre, {over} beyond a limit"
    )


def followed(scenes: Scenes, motions: dict[int, JointTrajectory]) -> tuple[int, int]:
    """How many arms arrive that are led along their motions by the engine's drives, and how many touch anything."""
    robot, joints, world = scenes.robot, scenes.generator.joints, scenes.world
    node = TrajectoryFollower("follower", robot, joints, 1.0 / (DECIMATION * world.physics_dt))
    node.reset()
    node.load(motions)
    rows = torch.tensor(list(motions))
    touched = torch.zeros(world.num_envs, dtype=torch.bool)
    longest = max(motion.duration for motion in motions.values())
    for _ in range(round((longest + 0.5) / (DECIMATION * world.physics_dt))):
        targets = node.compute({})
        robot.set_position_targets(targets["position_targets"], joints)
        robot.set_velocity_targets(targets["velocity_targets"], joints)
        world.step(DECIMATION)
        touched |= scenes.touching()
    missing = (robot.frame_pose(scenes.generator.frame)[:, :3] - scenes.goal[:, :3]).norm(dim=1)
    return int((missing[rows] < 0.02).sum()), int(touched[rows].sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", default="mujoco")
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--plans", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    with torch.inference_mode():
        scenes = Scenes(arguments.scenes, arguments.backend, arguments.seed)
        print(reactive(scenes, arguments.seconds), flush=True)
        if arguments.plans:
            print(planned(scenes, min(arguments.plans, arguments.scenes)))


if __name__ == "__main__":
    main()
